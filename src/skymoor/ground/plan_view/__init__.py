# SPDX-License-Identifier: Apache-2.0
"""Ground components in plan view: their walls on height steps, their free space outside buildings."""

from skymoor.ground.plan_view.score import PlanScores
from skymoor.ground.plan_view.search import PlanHypothesis, PlanSearchOptions, search_plan
from skymoor.ground.plan_view.target import PlanTarget, plan_target
from skymoor.ground.plan_view.template import PlanModel, plan_model

__all__ = [
    "PlanHypothesis",
    "PlanModel",
    "PlanScores",
    "PlanSearchOptions",
    "PlanTarget",
    "plan_model",
    "plan_target",
    "search_plan",
]
