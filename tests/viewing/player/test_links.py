"""Which sequences are the worst, and the addresses of their motions."""

from __future__ import annotations

from typing import Any
from urllib.parse import parse_qs

import pyarrow as pa

from prbench.harness.run_folder.scores import SCORES, CodedScores
from prbench.viewing.player.links import motion_link, sequence_scores, told_rates, worst_first


def scores(**values: dict[str, Any]) -> CodedScores:
    rows = [
        {"sequence_id": name, "dataset": "d", "sample": sample, "metric": metric, "value": value, "flag": None}
        for name, metrics in values.items()
        for metric, samples in metrics.items()
        for sample, value in enumerate(samples if isinstance(samples, list) else [samples])
    ]
    return CodedScores.of([pa.Table.from_pylist(rows, schema=SCORES)])


def test_the_worst_sequence_has_the_lowest_mean_rank_whatever_is_better():
    found = scores(
        a={"prime_success": 1.0, "location_error": 0.0},
        b={"prime_success": 0.0, "location_error": 1.0},
        c={"prime_success": 0.0, "location_error": 0.0},
    )
    assert worst_first([found]) == ["b", "c", "a"]


def test_equals_stand_by_their_ids_and_metrics_without_a_better_do_not_count():
    assert worst_first([scores(b={"prime_success": 1.0}, a={"prime_success": 1.0, "largest_jerk": 9.0})]) == ["a", "b"]


def test_several_runs_and_several_motions_count_by_their_means():
    one = scores(a={"prime_success": [1.0, 0.0]}, b={"prime_success": [0.0, 0.0]}, c={"prime_success": [1.0, 1.0]})
    assert worst_first([one]) == ["b", "a", "c"]
    other = scores(a={"prime_success": 0.0}, b={"prime_success": 1.0}, c={"prime_success": 1.0})
    assert worst_first([other]) == ["a", "b", "c"]
    assert worst_first([one, other]) == ["a", "b", "c"]
    (row, *_) = sequence_scores(one, "d", (), linked=False)
    assert (row.sequence_id, row.scores["prime_success"], row.motion) == ("b", 0.0, None)
    assert told_rates({"prime_success": 0.5, "reach_success": 1.0}) == "Prime Success 50 %, Reach Success yes"


def test_a_link_names_any_id_and_moment():
    name = "adt/a b/1&t=9/pick#é/7"
    page, _, said = motion_link(name, 3.254, "file:///x/motions.html").partition("#")
    assert page == "file:///x/motions.html"
    assert parse_qs(said) == {"sequence": [name], "t": ["3.25"]}
