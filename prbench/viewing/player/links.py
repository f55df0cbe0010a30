"""Which sequences of a run to look at first, and the address of each one's motion."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from urllib.parse import quote

import msgspec
import numpy as np
from jaxtyping import Float

from prbench.harness.run_folder.scores import CodedScores
from prbench.metrics import MAIN_METRICS, MetricInfo
from prbench.sequences import DatasetInfo, SequenceTable

# Name of the page in a run's folder.
PAGE = "motions.html"
# The metrics that say which of two motions is better.
JUDGES = tuple(info for info in MAIN_METRICS if info.compared and info.higher_is_better is not None)


class SequenceScores(msgspec.Struct, frozen=True, kw_only=True):
    """One sequence of a run.

    Attributes:
        dataset: Name of its dataset.
        sequence_id: Id of the sequence.
        scores: Maps ids of the main metrics to its values, means over its motions.
        motion: Address of the moment at which it is primed, relative to the run folder, where `prbench view RUN` writes
            the page; null for motions of a file, which no page shows.
    """

    dataset: str
    sequence_id: str
    scores: dict[str, float]
    motion: str | None


def motion_link(sequence_id: str, time: float, page: str = PAGE) -> str:
    """Return the address of a moment of a sequence in a page.

    Args:
        sequence_id: Id of the sequence.
        time: Seconds after its first frame.
        page: Address of the page.
    """
    return f"{page}#sequence={quote(sequence_id, safe='')}&t={time:.2f}"


def told_rates(scores: Mapping[str, float]) -> str:
    """Return the main rates of a sequence in words; the share of its motions where there were several."""
    words = {0.0: "no", 1.0: "yes"}
    rates = [(info.title, scores[info.id]) for info in JUDGES if info.unit == "rate" and info.id in scores]
    return ", ".join(f"{title} {words.get(value, f'{100 * value:.0f} %')}" for title, value in rates)


def worst_first(runs: Iterable[CodedScores]) -> list[str]:
    """Return the sequences of some runs from the worst to the best.

    A sequence is as bad as the mean of its ranks among the sequences of its run in all main metrics; equals stand in
    the order of their ids.

    Args:
        runs: The scores of each run.
    """
    goodness: dict[str, float] = {}
    for scores in runs:
        for info, values in zip(JUDGES, _means(scores, JUDGES), strict=True):
            better = values if info.higher_is_better else -values
            _, place, counts = np.unique(better, return_inverse=True, return_counts=True)
            # Sequences with the same value share the mean of their ranks.
            ranks = (np.cumsum(counts) - (counts - 1) / 2)[place] / len(values)
            for name, rank in zip(scores.sequence_ids, ranks.tolist(), strict=True):
                goodness[name] = goodness.get(name, 0.0) + rank
    return sorted(goodness, key=lambda name: (round(goodness[name], 9), name))


def _means(scores: CodedScores, metrics: Sequence[MetricInfo]) -> list[Float[np.ndarray, " n"]]:
    """Mean of each metric over the motions of each sequence; NaN where it has no value."""
    found = []
    for info in metrics:
        rows = scores.rows_of(info.id)
        sequence = scores.sequence[rows]
        counts = np.bincount(sequence, minlength=len(scores.sequence_ids))
        sums = np.bincount(sequence, weights=scores.value[rows], minlength=len(counts))
        found.append(np.where(counts > 0, sums / np.maximum(counts, 1), np.nan))
    return found


def sequence_scores(scores: CodedScores, dataset: str, tables: Iterable[Path], *, linked: bool) -> list[SequenceScores]:
    """Return the sequences of a dataset in a run, the worst first, each with the link to its motion.

    Args:
        scores: The run's scores on the dataset.
        dataset: Its name.
        tables: Folders of tables; that of the dataset, if it is among them, tells when a sequence is primed.
        linked: The motions lie in a run folder.
    """
    primes: dict[str, float] = {}
    for folder in tables:
        info = DatasetInfo.read(folder)
        if info.dataset == dataset:
            # Opening it checks the whole table, which whoever made the scores has done.
            rows = SequenceTable(folder, info).scalars(columns=["sequence_id", "prime_time", "start_time"])
            seconds = rows["prime_time"].to_numpy() - rows["start_time"].to_numpy()
            primes = dict(zip(rows["sequence_id"].to_pylist(), seconds.tolist(), strict=True))
    means = dict(zip((info.id for info in MAIN_METRICS), _means(scores, MAIN_METRICS), strict=True))
    place = {name: row for row, name in enumerate(scores.sequence_ids)}
    found = []
    for name in worst_first([scores]):
        values = ((metric, float(column[place[name]])) for metric, column in means.items())
        known = {metric: value for metric, value in values if np.isfinite(value)}
        motion = motion_link(name, primes.get(name, 0.0)) if linked else None
        found.append(SequenceScores(dataset=dataset, sequence_id=name, scores=known, motion=motion))
    return found
