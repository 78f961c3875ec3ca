# SPDX-License-Identifier: Apache-2.0
"""Makes the pictures of the documentation from a finished run: make gallery, or make gallery RUN=result."""
