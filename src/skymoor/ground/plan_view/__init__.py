# SPDX-License-Identifier: Apache-2.0
"""Ground components in plan view: walls on height steps, free space outside buildings, ground on the orthophoto."""

from skymoor.ground.plan_view.figure import plan_figure
from skymoor.ground.plan_view.ground_colour import ColourMap, colour_map
from skymoor.ground.plan_view.on_map import MapTarget, OnMapHypotheses, OnMapOptions, map_target, search_on_map
from skymoor.ground.plan_view.score import PlanScores, ScoreOptions
from skymoor.ground.plan_view.search import PlanHypothesis, PlanSearchOptions, search_plan
from skymoor.ground.plan_view.target import PlanTarget, plan_target
from skymoor.ground.plan_view.template import PlanModel, plan_model

__all__ = [
    "ColourMap",
    "MapTarget",
    "OnMapHypotheses",
    "OnMapOptions",
    "PlanHypothesis",
    "PlanModel",
    "PlanScores",
    "PlanSearchOptions",
    "PlanTarget",
    "ScoreOptions",
    "colour_map",
    "map_target",
    "plan_figure",
    "plan_model",
    "plan_target",
    "search_on_map",
    "search_plan",
]
