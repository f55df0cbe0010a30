"""``summary.json``: means with their intervals; ``agreement.json``: rates beside those of recorded people."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Float

from prbench.checking.doctor.motion_set import Diagnosis
from prbench.files.bounded import foreign_input
from prbench.files.storage import write_json
from prbench.harness.run_folder.record import SchemaVersion, TableRecord, read_record
from prbench.harness.run_folder.scores import RUN_SCHEMA_VERSION
from prbench.metrics.plausible import OWN_FIRST_FRAME

FILE_NAME = "summary.json"
# Flag of a motion that is the recorded one, beside its MPJPE.
RECORDED_MOTION = "recorded_motion"
# Share of such motions above which a method is not ranked.
_RECORDED_SHARE = 0.01
# Recorded motions that say nothing of a method: in a run of few sequences one is already more than that share.
_BY_ACCIDENT = 1
# Mark of a method that handed in recorded motions.
TWICE_DAGGER = "††"
# Mark of motions that bring gaze, which the study's methods do not generate.
PILCROW = "¶"
# Mark of a method that was given the scene's boxes.
LOZENGE = "◊"
# Mark of motions that are certainly wrong, so that their scores say nothing of the method.
CROSS = "✗"
# Mark of a Prime Success that counts rays which never were elsewhere.
SECTION = "§"
ARRIVAL = "prime_success_arrival"


class MetricSummary(msgspec.Struct, frozen=True, kw_only=True):
    """One metric of one dataset; rates from 0 to 1.

    Attributes:
        metric: Id of the metric, such as ``prime_success``.
        title: Its name as printed.
        unit: ``rate`` (from 0 to 1), ``m``, or the metric's other unit.
        mean: Mean over sequences.
        low: Lower bound of the interval; None where too few recordings allow none.
        high: Upper bound of the interval.
        level: Confidence level of the interval, such as 0.95.
        interval: Name of the estimator of the interval.
        sequences: Number of sequences that it was computed on.
        recordings: Number of recordings that they come from.
        marks: Remarks that a reader of the interval needs: ``few_recordings``, ``one_recording``, ``all_equal``.
        flags: Number of motions that carry each remark.
        detectable: Smallest difference to an unrelated method of the same spread that is found with 80 % power at
            Holm's first step among the main metrics; None where nothing can be found, and for other metrics.
    """

    metric: str
    title: str
    unit: str
    mean: float
    low: float | None
    high: float | None
    level: float
    interval: str
    sequences: int
    recordings: int
    marks: tuple[str, ...]
    flags: dict[str, int]
    detectable: float | None = None


class DatasetSummary(msgspec.Struct, frozen=True, kw_only=True):
    """Scores of a method on one dataset. Holds no time of day, host or path.

    Attributes:
        schema_version: Version of the files of a run folder.
        dataset: Name of the dataset.
        title: Carries the word "synthetic" where the data are.
        synthetic: The people are synthetic: never compare these scores with published ones.
        redistribution: Whether data made from the dataset may be passed on: ``yes``, ``non-commercial`` or ``none``.
        method: Name of the method.
        condition: What it was given.
        control: ``shuffled-goal`` or None.
        split: Split of the table.
        sequences: Number of chosen sequences; ``unsupported`` of them were not scored.
        unsupported: Number of sequences that are longer than the method can generate.
        recordings: Number of recordings that they come from.
        samples: Motions kept of each sequence.
        gaze: The motions bring gaze that the method generated.
        obstacles: The method was given the solid boxes around each sequence.
        length_mismatches: Number of motions whose length is not the recorded one's.
        metrics: Each metric that has a value.
        findings: What is certainly wrong with the motions (docs/doctor.md); empty for sound ones.
    """

    schema_version: SchemaVersion = RUN_SCHEMA_VERSION
    dataset: str
    title: str
    synthetic: bool
    redistribution: str
    method: str
    condition: str
    control: str | None
    split: str
    sequences: int
    unsupported: int
    recordings: int
    samples: int
    gaze: bool = False
    obstacles: bool = False
    length_mismatches: int
    metrics: tuple[MetricSummary, ...]
    findings: tuple[Diagnosis, ...] = ()

    def metric(self, name: str) -> MetricSummary | None:
        """Return one metric, or None if there is no value of it."""
        return next((metric for metric in self.metrics if metric.metric == name), None)

    @property
    def recorded_motions(self) -> int:
        """Number of motions that are the recorded ones, handed in as the method's own."""
        # Any metric may carry the remark; each counts the same motions.
        return max((metric.flags.get(RECORDED_MOTION, 0) for metric in self.metrics), default=0)

    @property
    def hands_in_recordings(self) -> bool:
        """True if there are too many of them for an accident, so that the scores are those of no method."""
        return self.recorded_motions > max(_BY_ACCIDENT, _RECORDED_SHARE * self._motions)

    @property
    def mark(self) -> str:
        """Return the remarks that readers must know about the motions; empty if there are none."""
        causes = ", ".join(f"{found.cause} ({found.kind})" for found in self.findings)
        wrong = [f"{CROSS} the motions are certainly wrong: {causes}; never ranked"] if causes else []
        return "; ".join([*wrong, *self.remarks])

    @property
    def remarks(self) -> list[str]:
        """Return the remarks on sound motions."""
        marks = []
        if self.recorded_motions:
            rank = "; never ranked" if self.hands_in_recordings else ""
            counts = f"{self.recorded_motions} of {self._motions} motions"
            marks.append(f"{TWICE_DAGGER} equals the recorded motion in {counts}{rank}")
        if self.gaze:
            marks.append(f"{PILCROW} gaze generated with the head, beyond the study; never ranked")
        if self.obstacles:
            marks.append(f"{LOZENGE} was given the scene's boxes, which other methods are not; never ranked")
        return marks

    @property
    def symbols(self) -> str:
        """The signs of :attr:`mark`, for the name of the method."""
        return " ".join(sign for sign in (CROSS, TWICE_DAGGER, PILCROW, LOZENGE) if sign in self.mark)

    @property
    def arrival(self) -> str:
        """Words on primes of a ray that was elsewhere before; empty where all primes are."""
        shown = self.metric("prime_success")
        arrival = self.metric(ARRIVAL)
        if shown is None or arrival is None or arrival.mean >= shown.mean:
            return ""
        return f"{SECTION} {100 * arrival.mean:.1f} % where the head ray must have been elsewhere before"

    @property
    def own_first_frame(self) -> str:
        """Words on bodies that were compared with themselves, because nobody gave them a pose; empty for others."""
        judged = self.metric("plausible")
        if judged is None or OWN_FIRST_FRAME not in judged.flags:
            return ""
        return "was given no pose: Plausible compares its bones with its own first frame"

    @property
    def _motions(self) -> int:
        return (self.sequences - self.unsupported) * self.samples

    def write(self, folder: Path) -> None:
        """Write ``summary.json``."""
        write_json(folder / FILE_NAME, msgspec.to_builtins(self))

    @classmethod
    @foreign_input()
    def read(cls, folder: Path) -> DatasetSummary:
        """Read ``summary.json``.

        Raises:
            RunError: if it is missing, damaged or of another version.
        """
        missing = f"{folder}: expected {FILE_NAME}, found none: the run is not finished. Run it again: it resumes."
        return read_record(folder / FILE_NAME, cls, missing=missing)


def counted_units(number: int, split: str) -> str:
    """Return a number of independent units in words: participants of merged folds, else recordings.

    Args:
        number: How many there are.
        split: What was run on, such as ``test`` or ``6 folds``.
    """
    unit = "participant" if split.endswith(" folds") else "recording"
    return f"{number} {unit}{'' if number == 1 else 's'}"


@dataclass(frozen=True)
class MeanOverDatasets:
    """The mean of one metric over datasets; rates from 0 to 1.

    Attributes:
        mean: Mean over the datasets, each counting alike.
        low: Lower bound of the 95 % interval; None where a dataset has no interval.
        high: Upper bound of the interval.
    """

    mean: float
    low: float | None
    high: float | None


def share_a_mean(tables: Sequence[TableRecord]) -> bool:
    """Return False where one of several tables has bodies that were estimated from the head, and another has not."""
    return len({table.estimated_bodies for table in tables}) == 1


def means_over_datasets(summaries: Sequence[DatasetSummary]) -> dict[str, MeanOverDatasets]:
    """Return the mean of each metric over datasets.

    Args:
        summaries: Summaries of one method, one a dataset.

    Returns:
        Means by metric id; without those that a dataset lacks, since a mean over the others would look like a better or
        worse method.
    """
    means = {}
    for name in dict.fromkeys(metric.metric for summary in summaries for metric in summary.metrics):
        mean = mean_over_datasets([summary.metric(name) for summary in summaries])
        if mean is not None:
            means[name] = mean
    return means


def mean_over_datasets(metrics: Sequence[MetricSummary | None]) -> MeanOverDatasets | None:
    """Return the mean of one metric over datasets, or None if one of them lacks it.

    Args:
        metrics: One metric of one method, an entry a dataset.
    """
    values = np.array([metric.mean for metric in metrics if metric is not None])
    if len(values) < len(metrics):
        return None
    bounds = [(metric.low, metric.high) for metric in metrics if metric is not None]
    lows = [low for low, _ in bounds if low is not None]
    highs = [high for _, high in bounds if high is not None]
    if min(len(lows), len(highs)) < len(values):
        return MeanOverDatasets(float(values.mean()), None, None)
    low, high = bounds_of_mean(values, np.array(lows), np.array(highs))
    return MeanOverDatasets(float(values.mean()), float(low), float(high))


def bounds_of_mean(
    means: Float[np.ndarray, "datasets *sets"],
    lows: Float[np.ndarray, "datasets *sets"],
    highs: Float[np.ndarray, "datasets *sets"],
) -> tuple[np.ndarray | np.floating, np.ndarray | np.floating]:
    """Return the 95 % interval of the mean over datasets from the intervals of the datasets.

    Their errors are independent, so the distances from mean to bound are added as squares, downwards and upwards by
    themselves ("square and add", Zou and Donner 2008). That keeps the intervals' skewness, and datasets at 0 % and
    100 % add the width that their intervals have.

    Args:
        means: Mean of each dataset.
        lows: Lower bounds of their intervals.
        highs: Upper bounds.

    Returns:
        Lower and upper bound, without the axis of datasets.
    """
    mean = means.mean(axis=0)
    down = np.sqrt(((means - lows) ** 2).sum(axis=0)) / len(means)
    up = np.sqrt(((highs - means) ** 2).sum(axis=0)) / len(means)
    return mean - down, mean + up


class RateAgreement(msgspec.Struct, frozen=True, kw_only=True):
    """One rate: the method's success beside that of recorded people on the same sequences.

    Attributes:
        metric: Id of the metric.
        title: Its name as printed.
        phi: Phi coefficient, from -1 to 1; null where one side has a single outcome.
        low: Lower bound of its 95 % interval; null where the data allow none.
        high: Upper bound of the interval.
        sequences: Number of sequences.
        recordings: Number of recordings that they come from.
        people: Share of the sequences on which recorded people succeed.
        remark: Why there is no coefficient or no interval; empty if there are both.
    """

    metric: str
    title: str
    phi: float | None
    low: float | None
    high: float | None
    sequences: int
    recordings: int
    people: float
    remark: str


class BinRate(msgspec.Struct, frozen=True, kw_only=True):
    """One rate on the sequences whose goal lies in one bin.

    Attributes:
        metric: Id of the metric.
        title: Its name as printed.
        by: ``bearing`` (degrees), ``distance`` or ``height`` (metres).
        begin: Lower end of the bin, included.
        end: Upper end, excluded; null for the last bin.
        sequences: Number of sequences in it.
        recordings: Number of recordings that they come from.
        mean: The method's rate; null without sequences.
        low: Lower bound of its 95 % interval; null where the data allow none.
        high: Upper bound of the interval.
        people: The rate of recorded people on the same sequences; null without sequences.
    """

    metric: str
    title: str
    by: str
    begin: float
    end: float | None
    sequences: int
    recordings: int
    mean: float | None
    low: float | None
    high: float | None
    people: float | None


class SceneOfPeople(msgspec.Struct, frozen=True, kw_only=True):
    """How the recorded people of some sequences keep out of the boxes around them (docs/specification/scene.md).

    Attributes:
        penetration: Share of frames with a joint deeper than the limit in a box, mean over sequences.
        depth: Largest depth of a joint in a box, mean over sequences, metres.
        boxes: Number of boxes that stand in the recordings.
        solid: Number of them that are obstacles.
    """

    penetration: float
    depth: float
    boxes: int
    solid: int


AGREEMENT_FILE = "agreement.json"


class DatasetAgreement(msgspec.Struct, frozen=True, kw_only=True):
    """All rates of one method on one dataset.

    Attributes:
        dataset: Name of the dataset.
        rates: Agreement with recorded people, one entry a rate.
        breakdown: Rates by the goal's place, by metric, quantity and bin.
        scene: How recorded people keep out of the scene's boxes; None where the table knows of none.
    """

    dataset: str
    rates: tuple[RateAgreement, ...]
    breakdown: tuple[BinRate, ...]
    scene: SceneOfPeople | None = None

    def write(self, folder: Path) -> None:
        """Write ``agreement.json``."""
        write_json(folder / AGREEMENT_FILE, msgspec.to_builtins(self))

    @classmethod
    @foreign_input()
    def read(cls, folder: Path) -> DatasetAgreement:
        """Read ``agreement.json``.

        Raises:
            RunError: if it is missing or damaged.
        """
        path = folder / AGREEMENT_FILE
        missing = f"{path}: expected the agreement with recorded people, found no file. Score the motions again."
        return read_record(path, cls, missing=missing)
