# SPDX-License-Identifier: Apache-2.0
"""References by address: the part of an orthophoto and of its DSM that a site needs, copied to this machine."""
