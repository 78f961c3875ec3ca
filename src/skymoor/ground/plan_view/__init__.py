# SPDX-License-Identifier: Apache-2.0
"""Ground components in plan view: walls on height steps, free space outside buildings, ground on the orthophoto."""

from skymoor.ground.plan_view.ground_colour import ColourMap, colour_map
from skymoor.ground.plan_view.score import PlanScores
from skymoor.ground.plan_view.search import PlanHypothesis, PlanSearchOptions, search_plan
from skymoor.ground.plan_view.target import PlanTarget, plan_target
from skymoor.ground.plan_view.template import PlanModel, plan_model

__all__ = [
    "ColourMap",
    "PlanHypothesis",
    "PlanModel",
    "PlanScores",
    "PlanSearchOptions",
    "PlanTarget",
    "colour_map",
    "plan_model",
    "plan_target",
    "search_plan",
]
