# SPDX-License-Identifier: Apache-2.0
"""Libraries and learned networks that several stages use."""
