# SPDX-License-Identifier: Apache-2.0
"""The report about a finished run: one HTML file that needs no network, its images, and figures for notebooks."""
