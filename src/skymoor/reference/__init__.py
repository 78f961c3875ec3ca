# SPDX-License-Identifier: Apache-2.0
"""Orthophoto and DSM to one grid in local metres."""
