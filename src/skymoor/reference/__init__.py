# SPDX-License-Identifier: Apache-2.0
"""The reference: orthophoto and DSM, resampled to one grid in local metres."""
