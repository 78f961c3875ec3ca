# SPDX-License-Identifier: Apache-2.0
"""A question to a person where a component was refused: what is shown, how it is asked, and what the answer means."""
