"""Colours that people with any kind of colour vision can tell apart (Okabe and Ito's set, two more of Tol's)."""

from __future__ import annotations

RECORDED = "#303030"
METHODS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#999933", "#882255")
"""In the order in which runs are named; there are no more than can be told apart."""
GAZE = "#e69f00"
GOAL = "#56b4e9"
GOAL_EDGE = "#1b6f9c"
MARK = "#555555"
SURROUNDINGS = "#b8b8b8"


def rgb(colour: str) -> tuple[int, int, int]:
    """Red, green and blue, 0 to 255, of ``#rrggbb``."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
