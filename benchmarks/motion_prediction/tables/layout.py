"""Tables 1, 2 and 3 of the study on any table of windows, the printed numbers beside the measured ones."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from prbench.datasets import SYNTHETIC_PREFIX
from prbench.harness.intervals import Comparison, Estimate, compare
from prbench_benchmarks.motion_prediction.published_numbers import (
    PUBLISHED_DATASETS,
    TABLES,
    PublishedScore,
    TableRow,
    load_tables,
    published_scores,
)
from prbench_benchmarks.motion_prediction.references import GROUND_TRUTH, TRUNCATION_FLOOR
from prbench_benchmarks.motion_prediction.scoring import Scores
from prbench_benchmarks.motion_prediction.table import WindowsInfo
from prbench_benchmarks.motion_prediction.tables.estimates import estimates, paired

_ORDERED_BY = "ade"
_REFERENCES = (GROUND_TRUTH, TRUNCATION_FLOOR)


@dataclass(frozen=True)
class Line:
    """One row of a table."""

    row: TableRow
    measured: Mapping[str, Estimate]
    """Every score by name, those that the study does not print among them; empty where nothing was measured."""
    published: Mapping[str, Mapping[str, PublishedScore]]
    """By dataset and metric; empty where the study does not have the row."""
    missing: str
    """Why it was not measured; empty if it was."""


@dataclass(frozen=True)
class Step:
    """Two rows next to one another in the order by ADE."""

    better: str
    worse: str
    comparison: Comparison
    """ADE of the worse row minus that of the better one, metres; corrected for the steps of the table."""


@dataclass(frozen=True)
class Table:
    """One table of the study."""

    number: str
    title: str
    section: str
    lines: tuple[Line, ...]
    order: tuple[Step, ...]


@dataclass(frozen=True)
class PredictionLayout:
    """All three tables on one table of windows."""

    dataset: str
    joint_set: str
    n_joints: int
    estimated_bodies: bool
    """The bodies are estimates that may carry later head motion: no mean with captured ones."""
    split: str
    n_windows: int
    n_recordings: int
    n_participants: int
    n_samples: int
    tables: tuple[Table, ...]

    @property
    def comparable(self) -> str:
        """The dataset whose printed numbers are of the same recordings; empty if there is none."""
        return self.dataset if self.dataset in PUBLISHED_DATASETS else ""

    @property
    def shown_datasets(self) -> tuple[str, ...]:
        """Datasets whose printed numbers stand beside the measured ones."""
        layout = self.dataset.removeprefix(SYNTHETIC_PREFIX)
        return (layout,) if layout in PUBLISHED_DATASETS else PUBLISHED_DATASETS


def lay_out(
    info: WindowsInfo,
    n_joints: int,
    split: str,
    n_samples: int,
    scores: Mapping[str, Scores],
    missing: Mapping[str, str],
) -> PredictionLayout:
    """Put the scores of rows into the study's tables.

    Args:
        info: Of the table of windows.
        n_joints: Joints of a pose.
        split: Which windows were scored, in words.
        n_samples: K of methods that draw samples.
        scores: By the name of a row (``published_numbers.TableRow.name``), all of the same windows.
        missing: Why a row has no scores.

    Raises:
        UsageError: if two rows were scored on different windows.
    """
    known = next(iter(scores.values()), Scores())
    return PredictionLayout(
        dataset=info.dataset,
        joint_set=info.joint_set,
        n_joints=n_joints,
        estimated_bodies=info.estimated_bodies,
        split=split,
        n_windows=len(known),
        n_recordings=len(set(known.columns.get("recording_id", ()))),
        n_participants=len(set(known.columns.get("participant_id", ()))),
        n_samples=n_samples,
        tables=tuple(_table(number, scores, missing) for number in TABLES),
    )


def _table(number: str, scores: Mapping[str, Scores], missing: Mapping[str, str]) -> Table:
    known = load_tables()
    lines = tuple(_line(number, row, scores.get(row.name), missing.get(row.name, "")) for row in known.of(number))
    return Table(number, known.titles[number], known.sections[number], lines, _order(lines, scores))


def _line(number: str, row: TableRow, scores: Scores | None, missing: str) -> Line:
    measured = {} if scores is None else estimates(scores)
    published = {name: published_scores(number, row, name) for name in PUBLISHED_DATASETS}
    published = {name: values for name, values in published.items() if values}
    return Line(row, measured, published, missing)


def _order(lines: Sequence[Line], scores: Mapping[str, Scores]) -> tuple[Step, ...]:
    """Measured methods from the smallest ADE on, each compared with the next one; references are no methods."""
    methods = [line for line in lines if line.measured and line.row.method not in _REFERENCES]
    methods.sort(key=lambda line: line.measured[_ORDERED_BY].mean)
    pairs = list(itertools.pairwise(methods))
    found = compare(
        {one.row.name: paired(scores[other.row.name], scores[one.row.name])[_ORDERED_BY] for one, other in pairs}
    )
    return tuple(Step(one.row.label, other.row.label, found[one.row.name]) for one, other in pairs)


def per_joint(distance: float, n_joints: int) -> float:
    """A distance over the flattened pose as a root mean square over the joints, so that joint sets can be compared."""
    return distance / float(np.sqrt(n_joints))
