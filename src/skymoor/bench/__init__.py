# SPDX-License-Identifier: Apache-2.0
"""Published data sets of image pairs on the user's disk, and how well the search and the matcher do on them."""

from skymoor.bench.measure import Row, measure
from skymoor.bench.method import Answer, Method, search_and_match, similarity_from
from skymoor.bench.report import KindRow, bench_record, by_kind, code_of
from skymoor.bench.srif import LEFT_OUT, Pair, find_pairs, label_error_px

__all__ = [
    "LEFT_OUT",
    "Answer",
    "KindRow",
    "Method",
    "Pair",
    "Row",
    "bench_record",
    "by_kind",
    "code_of",
    "find_pairs",
    "label_error_px",
    "measure",
    "search_and_match",
    "similarity_from",
]
