# SPDX-License-Identifier: Apache-2.0
"""The place: terrain, what stands where, the painted ground, plants, cars and other things outdoors."""
