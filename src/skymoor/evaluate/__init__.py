# SPDX-License-Identifier: Apache-2.0
"""Compare placed cameras with the truth."""

from skymoor.evaluate.rows import Estimate, EvaluationRow, Truth, evaluate

__all__ = ["Estimate", "EvaluationRow", "Truth", "evaluate"]
