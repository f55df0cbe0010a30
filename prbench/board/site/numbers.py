"""What pages of runs show beyond their scores: spread over recordings, lost rates, timing of primes, pairs of runs."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from prbench.board.collect import LeaderboardRow
from prbench.board.comparison import ComparedMetric, SequenceScores, difference_texts, paired_differences, sentence
from prbench.board.export import BoardRow
from prbench.geometry.skeleton import Joint, head_forward
from prbench.harness.benchmark import Benchmark
from prbench.harness.intervals import ClusteredValues, compare_families
from prbench.harness.results import cases_of_run
from prbench.harness.run_folder.folder import RunFolder
from prbench.harness.run_folder.predictions import Predictions
from prbench.harness.scoring import COLUMNS
from prbench.metrics import MetricInfo, MotionBatch
from prbench.metrics.ray_track import ray_distance
from prbench.sequences.table import SequenceTable

_EDGES = np.arange(-20, 21) / 10  # of the bins of prime timing, seconds after the recorded prime


@dataclass(frozen=True, eq=False)
class SiteRow:
    """A run in one table of a board.

    Attributes:
        told: The run as JSON of the board has it.
        scores: Scores of its sequences.
        worst: Its sequences from the worst to the best.
    """

    entry: LeaderboardRow
    told: BoardRow
    scores: SequenceScores
    worst: list[str]


@dataclass(frozen=True, eq=False)
class SiteRun:
    """One run.

    Attributes:
        key: Name of its page.
        label: Its name in sentences and charts.
        folder: The run.
        rows: Its place in each of its tables, by the name of the table.
    """

    key: str
    label: str
    folder: RunFolder
    rows: dict[str, SiteRow]


def spread_of(scores: SequenceScores, benchmark: Benchmark) -> dict[str, list[tuple[str, float, int]]]:
    """Return name, mean in printed units and number of sequences of each recording, by id of the metric."""
    spread = {}
    for info in benchmark.main_metrics:
        _, units, values = scores.get(info.id, ((), (), ()))
        of_unit: dict[str, list[float]] = defaultdict(list)
        for unit, value in zip(units, values, strict=True):
            of_unit[str(unit)].append(float(value))
        spread[info.id] = [
            (unit, round(info.scale * float(np.mean(own)), 4), len(own)) for unit, own in sorted(of_unit.items())
        ]
    return spread


def failures_of(row: SiteRow) -> list[dict[str, Any]]:
    """Return the sequences that lost a ranked rate, the worst first; of several samples most have to lose it.

    Each has ``sequence_id``, ``lost`` (titles of the rates) and ``moment``, at which the first of them was lost.
    """
    lost: dict[str, list[str]] = defaultdict(list)
    for info in row.entry.benchmark.ranked_metrics:
        if info.id in row.scores and info.unit == "rate" and info.higher_is_better is not None:
            names, _, values = row.scores[info.id]
            for place in np.flatnonzero(values < 0.5 if info.higher_is_better else values > 0.5):
                lost[names[place]].append(info.title)
    worst = [name for name in row.worst if name in lost]
    moments = ["prime" if "Prime Success" in lost[name] else "event" for name in worst]
    return [{"sequence_id": name, "lost": lost[name], "moment": each} for name, each in zip(worst, moments)]


def prime_timing(run: RunFolder, table: SequenceTable) -> dict[str, Any]:
    """Measure when the head ray of a run's first sample comes to stay on the goal, beside the recorded prime.

    To stay means ``prime_distance`` for ``prime_duration``, as Prime Success asks (docs/specification/metrics.md), but
    anywhere in the motion. A ray that is there in the first frame has not come, and is counted by itself.

    Returns:
        ``edges`` of bins, seconds after the recorded prime; ``counts`` of sequences, before the first edge first and
        after the last one last; ``never`` (no hit), ``already`` (there from the first frame), and the ``text``.
    """
    assert run.protocol is not None  # known rules, or nothing would have been verified
    constants = run.protocol.metrics
    _, _, cases = cases_of_run(run, table, same_values=False)
    predictions = Predictions.open(run.dataset(table.info.dataset).predictions)
    found: list[float] = []
    already = 0
    for _, chunk in cases.windows(COLUMNS, rows=256):
        motions = predictions.motions(chunk.sequence_ids, 0)
        batch = MotionBatch(motions.values, motions.offsets)
        of_row = np.repeat(np.arange(batch.n_sequences), batch.n_frames)
        joints = batch.values.astype(np.float64)
        forward, degenerate = head_forward(joints, chunk.numbers("head_tilt_deg")[of_row])
        distance = ray_distance(joints[:, Joint.HEAD], forward, chunk.vectors("goal_location")[of_row])
        on_target = ~degenerate & (distance <= constants.prime_distance + constants.threshold_tolerance)
        fps = chunk.numbers("fps")
        prime = chunk.numbers("prime_time") - chunk.numbers("start_time")
        for i, (first, last) in enumerate(zip(batch.first, batch.last, strict=True)):
            # The frame itself and the K frames after it, as in Prime Success.
            hold = min(int(np.ceil(constants.prime_duration * fps[i] - 1e-9)) + 1, last - first + 1)
            stays = np.convolve(on_target[first : last + 1], np.ones(hold), "valid") > hold - 0.5
            if stays[0]:
                already += 1
            elif stays.any():
                found.append(float(np.argmax(stays) / fps[i] - prime[i]))
    counts, _ = np.histogram(found, np.concatenate([[-np.inf], _EDGES, [np.inf]]))
    never = len(cases) - already - len(found)
    text = f"The ray comes to the goal in {len(found)} of {len(cases)} sequences"
    text += f", in the median {np.median(found):+.2f} s after the recorded prime" if found else ""
    text += f"; in {never} it never stays there (no hit), in {already} it is there from the first frame."
    return {"edges": _EDGES.tolist(), "counts": counts.tolist(), "never": never, "already": already, "text": text}


def compared(first: SiteRun, others: Sequence[SiteRun], datasets: Mapping[str, str]) -> dict[str, list[dict[str, Any]]]:
    """Compare a run with others on all tables that both stand in, by the rules of ``prbench leaderboard compare``.

    Args:
        first: The first run.
        others: The runs that it is compared with.
        datasets: Maps names of tables to their datasets.

    Returns:
        For each other run's key one entry for each dataset and metric: numbers of the difference first - second in
        printed units, the same as printed, which run is ``better`` by a supported difference, if one is, and all of it
        as a ``sentence``.
    """
    differences: dict[str, dict[tuple[str, MetricInfo], ClusteredValues]] = {other.key: {} for other in others}
    for other in others:
        for name in (name for name in first.rows if name in other.rows):
            for info in first.rows[name].entry.benchmark.compared_metrics:
                paired = paired_differences(first.rows[name].scores, other.rows[name].scores, info)
                # The first table of a dataset holds all sequences, another one those that every method generated.
                if paired is not None:
                    differences[other.key].setdefault((datasets[name], info), paired)
    labels = {other.key: other.label for other in others}
    told: dict[str, list[dict[str, Any]]] = {}
    for key, metrics in compare_families(differences).items():
        told[key] = []
        for (dataset, info), comparison in metrics.items():
            row = ComparedMetric(dataset, info, comparison, comparison.conclusion)
            better = ""
            if row.conclusion in ("higher", "lower"):
                better = "first" if (row.conclusion == "higher") == info.higher_is_better else "second"
            found = comparison.difference
            numbers = [None if each is None else info.scale * each for each in (found.mean, found.low, found.high)]
            one = {"dataset": dataset, "title": info.title, "printed": difference_texts(row), "numbers": numbers}
            one |= {"better": better, "conclusion": row.conclusion}
            told[key].append(one | {"sentence": sentence(row, first.label, labels[key])})
    return told
