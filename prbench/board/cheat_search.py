"""Search for motions that earn more than people without moving like people (``prbench audit --search``).

For each column, differential evolution (Storn and Price 1997, SciPy's) looks for the parameters of
:class:`~prbench.harness.scripted.Body` that earn most. A motion counts if more than half of its sequences are
plausible; one that counts is better than any that does not. For MPJPE recordings that were changed are searched, too;
of those only the sequences count that are not marked as recorded motion.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import differential_evolution

from prbench.engine import Engine
from prbench.errors import UsageError, did_you_mean
from prbench.harness import scripted
from prbench.harness.conditions import ConditionSource
from prbench.harness.planning import open_tables, select
from prbench.harness.recorded_motion import is_recorded_motion
from prbench.harness.run_folder.summary import ARRIVAL
from prbench.harness.scoring import COLUMNS, targets_of
from prbench.harness.scripted import Altered, Body
from prbench.metrics import METRICS, MotionBatch, ScoringTargets, score
from prbench.protocol.manifests import load_protocol

# Called with what is done, all of it, and the name of what was done last.
Progress = Callable[[int, int, str], None]
PLAUSIBLE = "plausible"
REACH = "reach_success"
EVERY_COLUMN = "all"
# The smaller of the leads over people in arrival and in Reach Success.
BOTH = "arrival_and_reach"
_SCORED = {info.id: info for info in METRICS if info.main or info.id == ARRIVAL}
# The columns that can be searched, in the order of boards.
SEARCHED = (BOTH, *(name for name, info in _SCORED.items() if info.ranked))
_LEAST_PLAUSIBLE = 0.5
_POPULATION = 24
_SPREAD = 0.15  # of a parameter's range; how far the first motions lie around the known cheats
_CHANGED = 0.4  # of the parameters
_KNOWN = {Body: tuple(scripted.BODIES.values()), Altered: (Altered(), scripted.SWAYING)}


@dataclass(frozen=True, eq=False)
class Judged:
    """Sequences of one table and how motions on them are judged; canonical frames, metres.

    Attributes:
        start: What a body knows of each sequence.
        fps: Frames per second.
        recorded: The recorded motions.
    """

    start: scripted.ScriptedStart
    fps: float
    recorded: MotionBatch
    targets: ScoringTargets

    def means(self, motion: Body | Altered | None) -> dict[str, float]:
        """Score a motion made for each sequence, or the recorded one.

        Returns:
            Means by metric id; the one of Plausible takes motions that are marked as recorded for implausible.
        """
        made = self.recorded
        if isinstance(motion, Body):
            joints = scripted.body_joints(self.start, made.n_frames, self.fps, motion).astype(np.float32)
            made = MotionBatch.from_padded(joints, made.n_frames)
        elif isinstance(motion, Altered):
            made = MotionBatch(scripted.altered_joints(made, self.fps, motion).astype(np.float32), made.offsets)
        values = score(made, self.recorded, self.targets, load_protocol().metrics, metrics=_SCORED)
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
        start = scripted.ScriptedStart(source.initial_joints, source.goal_location, source.head_tilt_deg)
        ((_, chunk),) = selection.windows(COLUMNS, rows=len(selection))
        recorded = MotionBatch(chunk.joints, chunk.offsets)
        targets = targets_of(chunk, source.goal_location, None)
        found.append(Judged(start, source.fps, recorded, targets))
    return found


@dataclass(frozen=True)
class FoundMotion:
    """The best motion that was found for one column, and what it earns on one table.

    Attributes:
        name: Name in printed tables: what it was found for.
        parameters: Maps each parameter of :class:`~prbench.harness.scripted.Body` or ``Altered`` to its value.
        means: Maps metric ids to means; the one of Plausible takes motions marked as recorded for implausible.
    """

    name: str
    parameters: Mapping[str, float]
    means: Mapping[str, float]


def searched_columns(column: str) -> tuple[str, ...]:
    """Return the columns of a search: all of them for ``all``.

    Raises:
        UsageError: for an unknown one.
    """
    if column not in (EVERY_COLUMN, *SEARCHED):
        known = ", ".join(SEARCHED)
        raise UsageError(f"--search: expected a column ({known}), found '{column}'.{did_you_mean(column, SEARCHED)}")
    return SEARCHED if column == EVERY_COLUMN else (column,)


def mean_of(means: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Return the mean of each number over tables."""
    return {name: float(np.mean([own[name] for own in means])) for name in means[0]}


def search(
    judged: Sequence[Judged], columns: Sequence[str], *, evaluations: int, seed: int, engine: Engine, progress: Progress
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
    wanted = [(column, Body) for column in columns] + [(column, Altered) for column in columns if column == "mpjpe"]
    generations = -(-evaluations // _POPULATION)
    done = itertools.count(1)

    def tried(function: Callable, motions: Iterable) -> list[float]:
        losses = list(engine.map(function, list(motions)))
        progress(next(done), len(wanted) * generations, column)
        return losses

    by_column = []
    for column, family in wanted:
        # The first generation: the known cheats, and motions that differ from them in some parameters.
        generator = np.random.default_rng(seed)
        known = np.array([list(asdict(each).values()) for each in _KNOWN[family]])
        low, high = np.transpose(list(scripted.ranges_of(family).values()))
        first = np.clip(np.resize(known, (_POPULATION, len(low))), low, high)
        spread = generator.normal(0.0, _SPREAD, first.shape) * (generator.random(first.shape) < _CHANGED)
        first[len(known) :] += spread[len(known) :] * (high - low)
        best = differential_evolution(
            _loss,
            list(zip(low, high, strict=True)),
            args=(judged, people, family, column),
            init=np.clip(first, low, high),
            maxiter=generations - 1,
            seed=generator,  # type: ignore[call-arg] - its name before SciPy 1.15 and after
            tol=0,
            polish=False,
            updating="deferred",
            workers=tried,
        )
        motion = _motion(family, best.x)
        name = f"found for {column}" + (", altered recording" if family is Altered else "")
        by_column.append([FoundMotion(name, asdict(motion), own.means(motion)) for own in judged])
    return list(zip(*by_column, strict=True))


def _motion(family: type[Body | Altered], values: np.ndarray) -> Body | Altered:
    """Return the motion of a vector; rounded, so that printed parameters are the ones that were tried."""
    return family(**dict(zip(scripted.ranges_of(family), np.round(values, 4).tolist(), strict=True)))


def _loss(
    values: np.ndarray, judged: Sequence[Judged], people: Mapping[str, float], family: type, column: str
) -> float:
    motion = _motion(family, values)
    means = mean_of([each.means(motion) for each in judged])
    if means[PLAUSIBLE] <= _LEAST_PLAUSIBLE:
        return 100.0 - means[PLAUSIBLE]
    if column == BOTH:
        loss = -min(means[name] - people[name] for name in (ARRIVAL, REACH))
    else:
        loss = -means[column] if _SCORED[column].higher_is_better else means[column]
    # Of motions that earn the same, the more plausible one.
    return loss - 0.01 * means[PLAUSIBLE]
