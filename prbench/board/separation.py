"""Which methods the data separate, so that ranks and bold print claim no more than a comparison supports.

Source: docs/specification/protocol.md#comparisons.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import combinations

from prbench.board.collect import LeaderboardRow
from prbench.board.comparison import SequenceScores, paired_values, sequence_scores
from prbench.errors import RunError
from prbench.harness.comparisons import PairedValues, compare
from prbench.metrics import MetricInfo

Beaten = Mapping[tuple[int, str], frozenset[int]]
"""Maps a row (by its position) and a metric to the rows that are better there, by a supported difference."""
Separate = Callable[[Sequence[LeaderboardRow], Sequence[MetricInfo]], Beaten]
"""Finds out which of several rows, ranked together, are better than which."""


def separate_by_comparison(rows: Sequence[LeaderboardRow], metrics: Sequence[MetricInfo]) -> Beaten:
    """Compare every pair of rows sequence by sequence, on all metrics, corrected together after Holm.

    Args:
        rows: On the same sequences of one dataset; where a row has ``only``, its other sequences do not count.
        metrics: The metrics that are ranked; those without a better direction are left out.

    Raises:
        RunError: if a row's scores cannot be read.
    """
    if len(rows) < 2:
        return {}
    scores = [_scores(row) for row in rows]
    directed = [info for info in metrics if info.higher_is_better is not None]
    pairs: dict[str, PairedValues] = {}
    for (i, first), (j, second) in combinations(enumerate(scores), 2):
        for info in directed:
            pair = paired_values(first, second, info, rows[0].benchmark)
            if pair is not None:
                pairs[f"{i} {j} {info.id}"] = pair
    directions = {info.id: info.higher_is_better for info in directed}
    better: dict[tuple[int, str], frozenset[int]] = {}
    for name, comparison in compare(pairs).items():
        i, j, metric = name.split(" ")
        if comparison.conclusion not in ("higher", "lower"):
            continue
        first_is_better = (comparison.conclusion == "higher") == directions[metric]
        winner, loser = (int(i), int(j)) if first_is_better else (int(j), int(i))
        better[loser, metric] = better.get((loser, metric), frozenset()) | {winner}
    return better


def _scores(row: LeaderboardRow) -> SequenceScores:
    if row.scores is None:
        raise RunError(
            f"{row.run}: expected the run's scores beside its summary, found none. Run it again: it resumes."
        )
    return sequence_scores(row.scores, row.benchmark, only=row.only)
