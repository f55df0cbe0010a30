"""Search for motions that earn more than people without moving like people (``prbench audit --search``).

For each column, differential evolution (Storn and Price 1997, SciPy's) looks for the parameters of
:class:`~prbench.harness.scripted.Body` that earn most. A motion counts if more than half of its sequences are
plausible; one that counts is better than any that does not. For MPJPE recordings that were changed are searched, too;
of those only the sequences count that are not marked as recorded motion.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import differential_evolution

from prbench.engine import Engine
from prbench.errors import UsageError, did_you_mean
from prbench.harness.conditions import ConditionSource
from prbench.harness.planning import open_tables, select
from prbench.harness.recorded_motion import is_recorded_motion
from prbench.harness.run_folder.summary import ARRIVAL
from prbench.harness.scoring import COLUMNS, targets_of
from prbench.harness.scripted import (
    BODIES,
    SWAYING,
    Altered,
    Body,
    ScriptedStart,
    altered_joints,
    body_joints,
    ranges_of,
)
from prbench.metrics import METRICS, MotionBatch, ScoringTargets, score
from prbench.protocol.manifests import MetricConstants, load_protocol

PLAUSIBLE = "plausible"
REACH = "reach_success"
# The smaller of the leads over people in arrival and in Reach Success.
BOTH = "arrival_and_reach"
_SCORED = {info.id: info for info in METRICS if info.main or info.id == ARRIVAL}
# The columns that can be searched, in the order of boards.
SEARCHED = (BOTH, *(name for name, info in _SCORED.items() if info.ranked))
_LEAST_PLAUSIBLE = 0.5
_POPULATION = 24
_SPREAD = 0.15  # of a parameter's range; how far the first motions lie around the known cheats
_KNOWN: Mapping[type, Sequence[Body | Altered]] = {Body: tuple(BODIES.values()), Altered: (Altered(), SWAYING)}


@dataclass(frozen=True, eq=False)
class Judged:
    """Sequences of one table and how motions on them are judged; canonical frames, metres.

    Attributes:
        start: What a body knows of each sequence.
        fps: Frames per second.
        recorded: The recorded motions.
    """

    start: ScriptedStart
    fps: float
    recorded: MotionBatch
    targets: ScoringTargets
    constants: MetricConstants

    def means(self, motion: Body | Altered | None) -> dict[str, float]:
        """Score a motion made for each sequence, or the recorded one.

        Returns:
            Means by metric id; the one of Plausible takes motions that are marked as recorded for implausible.
        """
        made = self.recorded
        if isinstance(motion, Body):
            joints = body_joints(self.start, made.n_frames, self.fps, motion).astype(np.float32)
            made = MotionBatch.from_padded(joints, made.n_frames)
        elif isinstance(motion, Altered):
            made = MotionBatch(altered_joints(made, self.fps, motion).astype(np.float32), made.offsets)
        values = score(made, self.recorded, self.targets, self.constants, metrics=_SCORED)
        means = {name: float(column.value.mean()) for name, column in values.items()}
        if isinstance(motion, Altered):
            marked = is_recorded_motion(made, self.recorded)
            means[PLAUSIBLE] = float((values[PLAUSIBLE].value * ~marked).mean())
        return means


def judged_tables(folders: Sequence[Path], *, split: str, limit: int | None) -> list[Judged]:
    """Read the sequences of some tables; see :func:`prbench.harness.planning.select`."""
    found = []
    for table in open_tables(folders):
        selection = select(table, split=split, limit=limit)
        source = ConditionSource.read(selection)
        start = ScriptedStart(source.initial_joints, source.goal_location, source.head_tilt_deg)
        ((_, chunk),) = selection.windows(COLUMNS, rows=len(selection))
        recorded = MotionBatch(chunk.joints, chunk.offsets)
        targets = targets_of(chunk, source.goal_location, None)
        found.append(Judged(start, source.fps, recorded, targets, load_protocol().metrics))
    return found


@dataclass(frozen=True)
class FoundMotion:
    """The best motion that was found for one column, and what it earns on one table.

    Attributes:
        column: Metric id, or ``arrival_and_reach``.
        family: ``body``, made from first pose and goal, or ``altered``, a recording that was changed.
        parameters: Maps each parameter of :class:`~prbench.harness.scripted.Body` or ``Altered`` to its value.
        means: Maps metric ids to means; the one of Plausible takes motions marked as recorded for implausible.
    """

    column: str
    family: str
    parameters: Mapping[str, float]
    means: Mapping[str, float]

    @property
    def name(self) -> str:
        """Name in printed tables."""
        return f"found for {self.column}" + (", altered" if self.family == "altered" else "")


def searched_columns(column: str | None) -> tuple[str, ...]:
    """Return the columns of a search; all of them for None.

    Raises:
        UsageError: for an unknown one.
    """
    if column is None:
        return SEARCHED
    if column not in SEARCHED:
        known = ", ".join(SEARCHED)
        raise UsageError(f"--search: expected a column ({known}), found '{column}'.{did_you_mean(column, SEARCHED)}")
    return (column,)


def mean_of(means: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Return the mean of each number over tables."""
    return {name: float(np.mean([own[name] for own in means])) for name in means[0]}


@dataclass(frozen=True, eq=False)
class _Trial:
    """What differential evolution minimises; picklable, for workers."""

    judged: Sequence[Judged]
    people: Mapping[str, float]
    family: type[Body | Altered]
    column: str

    def motion(self, values: np.ndarray) -> Body | Altered:
        """Return the motion of a vector; rounded, so that printed parameters are the ones that were tried."""
        named = zip(ranges_of(self.family), values.tolist(), strict=True)
        return self.family(**{name: round(value, 4) for name, value in named})

    def __call__(self, values: np.ndarray) -> float:
        motion = self.motion(values)
        means = mean_of([each.means(motion) for each in self.judged])
        if means[PLAUSIBLE] <= _LEAST_PLAUSIBLE:
            return 100.0 - means[PLAUSIBLE]
        if self.column == BOTH:
            loss = -min(means[name] - self.people[name] for name in (ARRIVAL, REACH))
        else:
            loss = -means[self.column] if _SCORED[self.column].higher_is_better else means[self.column]
        # Of motions that earn the same, the more plausible one.
        return loss - 0.01 * means[PLAUSIBLE]


def search(
    judged: Sequence[Judged],
    columns: Sequence[str],
    *,
    evaluations: int,
    seed: int,
    engine: Engine,
    progress: Callable[[int, int, str], None],
) -> list[tuple[FoundMotion, ...]]:
    """Look for the motions that earn most on all of some tables, each of which counts alike.

    Args:
        judged: The tables.
        columns: Some of :data:`SEARCHED`.
        evaluations: Motions tried for each column, rounded up to whole generations of 24.
        seed: Seed of the search; the same one finds the same motions, whatever the engine.
        engine: Engine that tries the motions.
        progress: Called with the generations done, all of them, and the column.

    Returns:
        For each table the best body of each column, and the best changed recording for MPJPE.
    """
    people = mean_of([each.means(None) for each in judged])
    families = [(column, Body) for column in columns] + [(column, Altered) for column in columns if column == "mpjpe"]
    generations = -(-evaluations // _POPULATION)
    by_table: list[list[FoundMotion]] = [[] for _ in judged]
    for place, (column, family) in enumerate(families):
        trial = _Trial(judged, people, family, column)
        ranges = list(ranges_of(family).values())
        low, high = np.transpose(ranges)
        # The first generation: the known cheats, and motions that differ from them in some parameters.
        generator = np.random.default_rng(seed)
        known = np.array([list(asdict(each).values()) for each in _KNOWN[family]])
        first = known[np.arange(_POPULATION) % len(known)]
        changed = (generator.random(first.shape) < 0.4) * (np.arange(_POPULATION) >= len(known))[:, None]
        first = np.clip(first, low, high) + changed * generator.normal(0.0, _SPREAD, first.shape) * (high - low)
        shown = itertools.count(place * generations + 1)

        def tried(function: Callable, motions: Iterable, column: str = column, shown: Iterator[int] = shown) -> list:
            losses = list(engine.map(function, list(motions)))
            progress(next(shown), len(families) * generations, column)
            return losses

        best = differential_evolution(
            trial,
            ranges,
            init=np.clip(first, low, high),
            maxiter=generations - 1,
            mutation=(0.4, 0.9),
            recombination=0.6,
            seed=generator,
            tol=0,
            polish=False,
            updating="deferred",
            workers=tried,
        )
        motion = trial.motion(best.x)
        for own, found in zip(judged, by_table, strict=True):
            found.append(FoundMotion(column, family.__name__.lower(), asdict(motion), own.means(motion)))
    return [tuple(found) for found in by_table]
