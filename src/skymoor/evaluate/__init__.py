# SPDX-License-Identifier: Apache-2.0
"""Comparison of registered cameras with ground truth."""

from skymoor.evaluate.rows import Estimate, EvaluationRow, Truth, evaluate

__all__ = ["Estimate", "EvaluationRow", "Truth", "evaluate"]
