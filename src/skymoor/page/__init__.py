# SPDX-License-Identifier: Apache-2.0
"""The page about a finished run: one file that needs no network."""

from skymoor.page.page import report_page

__all__ = ["report_page"]
