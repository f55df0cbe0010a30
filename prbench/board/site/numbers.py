"""What pages of runs show beyond their scores: spread over recordings, failures, timing of primes, pairs of runs."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import msgspec
import numpy as np

from prbench.board.collect import LeaderboardRow
from prbench.board.comparison import (
    ComparedMetric,
    SequenceScores,
    difference_texts,
    paired_differences,
    sentence,
)
from prbench.board.tables import TableRow
from prbench.geometry.skeleton import Joint, head_forward
from prbench.harness.benchmark import Benchmark
from prbench.harness.intervals import compare
from prbench.harness.results import cases_of_run
from prbench.harness.run_folder.folder import RunFolder
from prbench.harness.run_folder.predictions import Predictions
from prbench.harness.scoring import COLUMNS
from prbench.metrics import MotionBatch
from prbench.metrics.ray_track import ray_distance
from prbench.sequences.table import SequenceTable

# Failures that a page names; scores.parquet holds all.
MOST_FAILURES = 200
_BIN = 0.1  # seconds
_REACH = 2.0  # seconds before and after the recorded prime that have bins of their own


@dataclass(frozen=True, eq=False)
class SiteRun:
    """One run, with its place in each table of a board.

    Attributes:
        key: Name of its page.
        label: Name of the run in sentences and charts.
        folder: The run.
        rows: Its row in each of its tables, by the name of the table.
        scores: Scores of the sequences of each of these.
    """

    key: str
    label: str
    folder: RunFolder
    rows: dict[str, TableRow]
    scores: dict[str, SequenceScores]

    @property
    def first(self) -> LeaderboardRow:
        """The run in its first table."""
        return next(iter(self.rows.values())).entry


class Failure(msgspec.Struct, frozen=True, kw_only=True):
    """A sequence of which at least one rate was lost.

    Attributes:
        sequence_id: Its id.
        lost: Titles of the lost rates.
        moment: ``prime`` or ``event``: when the first of them was lost.
    """

    sequence_id: str
    lost: list[str]
    moment: str


class PrimeTiming(msgspec.Struct, frozen=True, kw_only=True):
    """When the head ray first stays on the goal, beside the recorded prime; one value a sequence.

    Attributes:
        first: Lower end of the first bin, seconds after the recorded prime.
        width: Width of a bin, seconds.
        counts: Sequences in each bin.
        earlier: Sequences whose ray got there before the first bin.
        later: Sequences whose ray got there after the last bin.
        from_the_start: Sequences whose ray is on the goal in the first frame: nothing was turned to.
        never: Sequences whose ray never stays on the goal.
        text: The same in words.
    """

    first: float
    width: float
    counts: list[int]
    earlier: int
    later: int
    from_the_start: int
    never: int
    text: str


def spread_of(scores: SequenceScores, entry: LeaderboardRow) -> dict[str, list[tuple[str, float, int]]]:
    """Return name, mean in printed units and number of sequences of each recording, by id of the metric."""
    spread = {}
    benchmark = entry.benchmark
    for info in benchmark.main_metrics:
        of_recording: dict[str, list[float]] = defaultdict(list)
        for name, value in zip(*scores.get(info.id, ((), ())), strict=True):
            of_recording[entry.table.unit_of(benchmark.recording_key(name))].append(float(value))
        spread[info.id] = [
            (name, round(info.scale * float(np.mean(values)), 4), len(values))
            for name, values in sorted(of_recording.items())
        ]
    return spread


def failures_of(scores: SequenceScores, benchmark: Benchmark) -> list[Failure]:
    """Return the sequences that lost a ranked rate: those with more lost rates first, then the longer distances.

    A rate of several samples is lost where most of them lost it.
    """
    lost: dict[str, list[str]] = defaultdict(list)
    primes: set[str] = set()
    farthest: dict[str, float] = {}
    for info in benchmark.ranked_metrics:
        names, values = scores.get(info.id, ((), np.empty(0)))
        if info.unit == "m" and not farthest:
            farthest = dict(zip(names, values.tolist(), strict=True))
        if info.unit != "rate" or info.higher_is_better is None:
            continue
        failed = values < 0.5 if info.higher_is_better else values > 0.5
        for place in np.flatnonzero(failed):
            lost[names[place]].append(info.title)
        if info.id.startswith("prime_success"):
            primes.update(names[place] for place in np.flatnonzero(failed))
    worst = sorted(lost, key=lambda name: (-len(lost[name]), -farthest.get(name, 0.0), name))
    moments = {True: "prime", False: "event"}
    return [Failure(sequence_id=name, lost=lost[name], moment=moments[name in primes]) for name in worst]


def prime_timing(run: RunFolder, table: SequenceTable) -> PrimeTiming:
    """Measure when the head ray of a run's first sample comes to stay on the goal, of every sequence of a table.

    To stay means ``prime_distance`` for ``prime_duration``, as Prime Success asks (docs/specification/metrics.md), but
    anywhere in the motion.
    """
    _, _, cases = cases_of_run(run, table, same_values=False)
    assert run.protocol is not None  # known rules, or nothing would have been verified
    constants = run.protocol.metrics
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
        for i in range(batch.n_sequences):
            frames = on_target[batch.first[i] : batch.last[i] + 1]
            hold = int(np.ceil(constants.prime_duration * fps[i] - 1e-9)) + 1
            stays = np.convolve(frames, np.ones(min(hold, len(frames))), "valid") >= hold
            if not stays.any():
                continue
            already += bool(stays[0])
            if not stays[0]:
                found.append(float(np.argmax(stays) / fps[i] - prime[i]))
    late = np.array(found)
    edges = np.arange(-round(_REACH / _BIN), round(_REACH / _BIN) + 1) * _BIN
    counts, _ = np.histogram(late, edges)
    never = len(cases) - already - len(late)
    text = f"The ray comes to the goal in {len(late)} of {len(cases)} sequences"
    if len(late):
        text += f", in the median {np.median(late):+.2f} s from the recorded prime"
    text += f"; in {never} it never stays there (no hit), in {already} it is there from the first frame."
    return PrimeTiming(
        first=-_REACH,
        width=_BIN,
        counts=counts.tolist(),
        earlier=int((late < edges[0]).sum()),
        later=int((late > edges[-1]).sum()),
        from_the_start=already,
        never=never,
        text=text,
    )


class PairedMetric(msgspec.Struct, frozen=True, kw_only=True):
    """How two runs differ in one metric on one dataset; the difference is first - second, in printed units.

    Attributes:
        dataset: Name of the dataset.
        title: Title of the metric.
        difference: The difference as printed.
        interval: Its 95 % interval as printed.
        p_value: Corrected after Holm for all that is compared of the two runs, as printed.
        detectable: Smallest difference that would have been found, as printed.
        mean: The difference.
        low: Lower bound; None without one.
        high: Upper bound; None without one.
        better: Which run is better by a supported difference; empty where none is.
        conclusion: ``higher``, ``lower``, ``not supported by the data`` or ``cannot be tested``: of the first run.
        sentence: All of it in words.
    """

    dataset: str
    title: str
    difference: str
    interval: str
    p_value: str
    detectable: str
    mean: float
    low: float | None
    high: float | None
    better: Literal["first", "second", ""]
    conclusion: str
    sentence: str


def compared(
    entries: Mapping[str, LeaderboardRow],
    scores: Mapping[str, tuple[SequenceScores, SequenceScores]],
    names: tuple[str, str],
) -> list[PairedMetric]:
    """Compare two runs on all their common tables, by the rules of ``prbench leaderboard compare``.

    Args:
        entries: Row of the first run on each dataset.
        scores: Scores of both, by the datasets of which both stand in the same table.
        names: Names of the runs in sentences.
    """
    differences = {}
    for dataset, pair in scores.items():
        entry = entries[dataset]
        for info in entry.benchmark.compared_metrics:
            paired = paired_differences(*pair, info, entry.benchmark, entry.table)
            if paired is not None:
                differences[dataset, info] = paired
    told = []
    for (dataset, info), comparison in compare(differences).items():
        row = ComparedMetric(dataset, info, comparison, comparison.conclusion)
        difference, interval, p_value, detectable = difference_texts(row)
        better: Literal["first", "second", ""] = ""
        if row.conclusion in ("higher", "lower"):
            better = "first" if (row.conclusion == "higher") == info.higher_is_better else "second"
        found = comparison.difference
        one = PairedMetric(
            dataset=dataset,
            title=info.title,
            difference=difference,
            interval=interval,
            p_value=p_value,
            detectable=detectable,
            mean=info.scale * found.mean,
            low=None if found.low is None else info.scale * found.low,
            high=None if found.high is None else info.scale * found.high,
            better=better,
            conclusion=row.conclusion,
            sentence=sentence(row, *names),
        )
        told.append(one)
    return told
