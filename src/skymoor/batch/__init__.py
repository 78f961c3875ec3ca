# SPDX-License-Identifier: Apache-2.0
"""Many sites, each in a process of its own: on this machine, or on the workers of a Dask cluster."""
