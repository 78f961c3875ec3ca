# SPDX-License-Identifier: Apache-2.0
"""The method as pages of plain calls, and what a run is given."""
