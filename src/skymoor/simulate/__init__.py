# SPDX-License-Identifier: Apache-2.0
"""Whole sites with exact truth: photos from the air and from the ground, an orthophoto and a DSM of another day.

`world.World(SiteOptions(...))` is a site, `site.write_site` writes it. Nothing is imported here, because the help of
the command line shows `options.SiteOptions` and must not load the renderer for that.
"""
