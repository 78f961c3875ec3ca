# SPDX-License-Identifier: Apache-2.0
"""skymoor in QGIS: a Processing provider that runs the skymoor command in its own environment."""


def classFactory(iface):  # noqa: N802 - the name that QGIS asks for
    """The plugin."""
    from .plugin import SkymoorPlugin

    return SkymoorPlugin(iface)
