"""The front of methods that none beats in both score and cost, and its picture."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from prbench.errors import UsageError
from prbench.viewing.pareto import ParetoAxes, ScoredMethod, draw_pareto, pareto_front

AXES = ParetoAxes("A table", "Prime Success (%)", "seconds a motion", higher_is_better=True)


def method(name: str, score: float, cost: float | None) -> ScoredMethod:
    return ScoredMethod(name, score, score - 5, score + 5, cost)


def names(methods, *, higher_is_better: bool = True) -> list[str]:
    return [each.name for each in pareto_front(methods, higher_is_better=higher_is_better)]


def test_the_front_by_hand():
    methods = [
        method("slow and good", 60, 10.0),
        method("quick and poor", 10, 0.1),
        method("slower and worse", 50, 20.0),
        method("as quick and worse", 5, 0.1),
        method("as good and slower", 60, 11.0),
        method("a control", 100, None),
    ]
    assert names(methods) == ["quick and poor", "slow and good"]
    assert names(methods, higher_is_better=False) == ["as quick and worse"]


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("higher", [True, False])
def test_the_front_is_what_no_other_method_dominates(seed, higher):
    generator = np.random.default_rng(seed)
    scores = generator.integers(0, 10, 12)
    costs = generator.integers(1, 6, 12)
    methods = [method(str(i), float(score), float(cost)) for i, (score, cost) in enumerate(zip(scores, costs))]
    sign = 1 if higher else -1
    beaten = set()
    for one, other in itertools.permutations(zip(costs, sign * scores), 2):  # the slow way
        if other[0] <= one[0] and other[1] >= one[1] and other != one:
            beaten.add((one[0], sign * one[1]))
    expected = {(each.cost, each.score) for each in methods} - beaten
    front = pareto_front(methods, higher_is_better=higher)
    assert {(each.cost, each.score) for each in front} == expected
    assert len(front) == len(expected)


def test_the_plot_is_written_as_png_and_svg_the_same_every_time(tmp_path):
    methods = [method("pr", 60, 10.0), method("mdm $x_1$", 10, 0.5), method("scripted", 100, None)]
    for kind in ("png", "svg"):
        for number in (1, 2):
            draw_pareto(methods, AXES, tmp_path / f"{number}.{kind}")
        first, second = ((tmp_path / f"{number}.{kind}").read_bytes() for number in (1, 2))
        assert first == second
    drawn = (tmp_path / "1.svg").read_text()
    for word in ("pr", "scripted", "seconds a motion", "Prime Success (%)", "x_1"):
        assert word in drawn


def test_other_files_and_controls_alone_are_refused(tmp_path):
    with pytest.raises(UsageError, match=r"written as \.png or \.svg"):
        draw_pareto([method("pr", 60, 10.0)], AXES, tmp_path / "plot.pdf")
    with pytest.raises(UsageError, match="none of the methods has a measured cost"):
        draw_pareto([method("scripted", 100, None)], AXES, tmp_path / "plot.png")
