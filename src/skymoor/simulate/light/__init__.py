# SPDX-License-Identifier: Apache-2.0
"""Light: textured triangles under a sun and a sky, and the cameras that look at them."""
