"""Read scenes from a table and from the runs that were made on it."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow.compute as pc
from jaxtyping import Float

from prbench.errors import PredictionsError, RunError
from prbench.geometry.skeleton import invert_rigid, transform_points
from prbench.harness.run_folder import DatasetFolder, Predictions, RunFolder, RunRecord, read_scores
from prbench.harness.scoring import recorded_gaze, targets_of
from prbench.metrics import GazeRays, MotionBatch, score
from prbench.protocol.manifests import MetricConstants, load_protocol
from prbench.sequences import DatasetInfo, SequenceChunk, SequenceTable
from prbench.sequences.dataset_info import may_pass_on, notice, require_may_pass_on
from prbench.viewing.replay.scene import METHOD_COLOURS, RECORDED, RECORDED_COLOUR, Goal, Scene, ShownMotion

_READ_AT_ONCE = 256  # sequences whose recorded motion is in memory


@dataclass(frozen=True, eq=False)
class RunMotions:
    """The motions that one run generated for one dataset, and their scores."""

    label: str
    run: RunFolder
    dataset: str
    predictions: Predictions
    sample: int

    @classmethod
    def open(cls, run: RunFolder, dataset: str, *, label: str, sample: int = 0) -> RunMotions:
        """Open the predictions of a dataset.

        Raises:
            RunError: if the run has no predictions yet, is of other datasets, or drew fewer samples.
        """
        folder = run.dataset(dataset).predictions
        # The folder is made before its first part is written.
        if not folder.is_dir() or not any(folder.glob("part-*.parquet")):
            problem = f"{folder}: expected the predictions of a run, found none. Run the same `prbench run` again:"
            raise RunError(f"{problem} it resumes where it was interrupted.")
        if not 0 <= sample < run.record.samples:
            raise RunError(f"{run.path}: expected a sample from 0 to {run.record.samples - 1}, found {sample}.")
        return cls(label, run, dataset, Predictions.open(folder), sample)

    @property
    def files(self) -> DatasetFolder:
        """The run's files of the dataset."""
        return self.run.dataset(self.dataset)

    @property
    def kind(self) -> str:
        """``control`` for motions that are made of recorded ones, else ``method``."""
        return "control" if self.run.record.method.kind == "control" else "method"

    def __contains__(self, sequence_id: str) -> bool:
        return (sequence_id, self.sample) in self.predictions

    def joints(self, sequence_id: str, n_frames: int) -> Float[np.ndarray, "n 22 3"]:
        """Read the motion of a sequence, canonical frame, metres.

        Raises:
            PredictionsError: if it has another length than the recorded one, or holds NaN.
        """
        joints = self.predictions.motions([sequence_id], self.sample).values.astype(np.float64)
        place = f"{self.files.predictions}, {sequence_id}"
        if len(joints) != n_frames:
            raise PredictionsError(f"{place}: expected {n_frames} frames, found {len(joints)}.")
        if not np.isfinite(joints).all():
            raise PredictionsError(f"{place}: expected finite positions, found NaN.")
        return joints

    def gaze(self, sequence_id: str) -> GazeRays | None:
        """Read the gaze that was generated with a motion; None where the run has none."""
        rays = self.predictions.motions([sequence_id], self.sample).gaze
        if rays is None:
            return None
        origin, direction = rays.astype(np.float64).swapaxes(0, 1)
        return GazeRays(origin, direction, np.ones(len(rays), dtype=bool))

    def scores(self, sequence_ids: Sequence[str]) -> Mapping[str, Mapping[str, float]]:
        """Map each sequence id to its metric values; to none for a run that was interrupted before it was scored.

        Raises:
            RunError: if the scores cannot be read.
        """
        # A run that was interrupted has motions without scores; those are shown as not scored.
        found: dict[str, dict[str, float]] = {name: {} for name in sequence_ids}
        if not self.files.scores.is_file():
            return found
        table = read_scores(self.files.scores)
        table = table.filter((pc.field("sample") == self.sample) & pc.field("sequence_id").isin(list(sequence_ids)))
        for row in table.select(["sequence_id", "metric", "value"]).to_pylist():
            found[row["sequence_id"]][row["metric"]] = row["value"]
        return found


def run_labels(paths: Sequence[Path], records: Sequence[RunRecord]) -> list[str]:
    """Return a short label for each run: method and condition, and the folder's name where two would be equal."""
    words = [(record.method.name, record.condition, record.control) for record in records]
    labels = [", ".join(filter(None, parts)) for parts in words]
    named = zip(paths, labels, strict=True)
    return [f"{label} ({path.name})" if labels.count(label) > 1 else label for path, label in named]


def read_scenes(
    table: SequenceTable, sequence_ids: Sequence[str], runs: Sequence[RunMotions], permitted: Collection[str]
) -> Iterator[Scene]:
    """Read sequences with each run's motions of them, in the order given.

    Where the dataset's licence keeps recorded motion (``redistribution``), the recorded motion, its gaze and its goal
    are left out; generated motions stay.

    Args:
        table: Table of the sequences.
        sequence_ids: Ids that the table and every run have.
        runs: Runs that were made on this table.
        permitted: Datasets for which the user has permission to pass recorded motion on.

    Raises:
        RedistributionError: if nothing is left that may be shown.
        PredictionsError: if a motion does not fit its sequence.
    """
    # Recorded motion alone, and controls made of it, are refused where the licence keeps recorded motion.
    if not runs:
        require_may_pass_on(table.info, "the view", permitted)
    for run in runs:
        if run.kind == "control":
            require_may_pass_on(table.info, f"the motions of '{run.label}'", permitted)
    scores = [run.scores(sequence_ids) for run in runs]
    followed = runs[0].run.protocol if runs else table.described_protocol.protocol()
    constants = (followed or load_protocol()).metrics
    chunks: dict[str, SequenceChunk] = {}
    for place, name in enumerate(sequence_ids):
        if place % _READ_AT_ONCE == 0:
            # One row a chunk, because the order asked for need not be that of the table.
            part = frozenset(sequence_ids[place : place + _READ_AT_ONCE])
            chunks = {chunk.sequence_ids[0]: chunk for chunk in table.chunks(ids=part, rows=1)}
        chunk = chunks[name]
        motions = []
        for run, colour, values in zip(runs, METHOD_COLOURS, scores, strict=False):
            joints = run.joints(name, int(chunk.n_frames[0]))
            motions.append(ShownMotion(run.label, colour, joints, values[name], run.gaze(name), run.kind))
        yield scene_of(chunk, table.info, motions, permitted=permitted, constants=constants)


def scene_of(
    chunk: SequenceChunk,
    info: DatasetInfo,
    motions: Sequence[ShownMotion] = (),
    *,
    permitted: Collection[str] = (),
    constants: MetricConstants | None = None,
) -> Scene:
    """Make the scene of one row of a table, with generated motions beside the recorded one.

    Args:
        chunk: The row, with all columns.
        info: Description of its dataset.
        motions: Motions that methods generated for it.
        permitted: See :func:`read_scenes`.
        constants: Numbers of the metrics; None for those of prbench's own protocol.
    """
    constants = constants or load_protocol().metrics
    shown = may_pass_on(info, permitted)
    gaze = recorded_gaze(chunk)
    placed = info.why_not_scored is None  # else the goal's frame is unknown, so that no distance means anything
    scores = {}
    if placed:
        # The recorded motion's own scores are the ceiling that a method is compared with.
        targets = targets_of(chunk, chunk.vectors("goal_location"), gaze)
        motion = MotionBatch(chunk.joints, chunk.offsets)
        scores = {name: float(column.value[0]) for name, column in score(motion, motion, targets, constants).items()}
    eyes = gaze if gaze.valid.any() else None
    recorded = ShownMotion(RECORDED, RECORDED_COLOUR, chunk.joints.astype(np.float64), scores, eyes, "recorded")
    world_from_canonical = chunk.vectors("world_from_canonical").reshape(4, 4)
    goal = None
    if shown and placed:
        sides = zip(chunk.vectors("goal_box_world_min")[0], chunk.vectors("goal_box_world_max")[0], strict=True)
        corners = np.array(list(itertools.product(*sides)), dtype=np.float64)
        place = chunk.vectors("goal_location")[0].astype(np.float64)
        goal = Goal(place, transform_points(invert_rigid(world_from_canonical), corners))
    action, name, hand, split = (chunk.strings(column)[0] for column in ("action", "object_name", "hand", "split"))
    title = f"{action} of {name}, {f'{hand} hand' if hand else 'hand unknown'} ({split})"
    fps, tilt, start = (float(chunk.numbers(name)[0]) for name in ("fps", "head_tilt_deg", "start_time"))
    prime = float(chunk.numbers("prime_time")[0] - chunk.numbers("start_time")[0])
    said = (chunk.sequence_ids[0], info.dataset, title, action, fps, int(chunk.n_frames[0]), prime, tilt)
    shown_motions = (recorded, *motions) if shown else tuple(motions)
    place = (chunk.strings("recording_id")[0], start, world_from_canonical.astype(np.float64))
    return Scene(*said, shown_motions, constants, goal, notice(info, permitted), info, *place)
