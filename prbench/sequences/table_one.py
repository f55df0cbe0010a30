"""The study's statistics of a built dataset: Table 1, Table S2 and what Figure S2 draws.

The goal's distance, elevation and azimuth are those of its location as seen from the pelvis of the first frame, in the
canonical frame: azimuth 0 straight ahead and positive to the left, elevation 0 at the height of the pelvis. The page
names the three and defines none of them.
"""

from __future__ import annotations

import contextlib
import tempfile
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from jaxtyping import Float

from prbench.geometry.skeleton import Joint
from prbench.protocol.published import QUANTITIES, Spread
from prbench.sequences.chunk import SequenceChunk
from prbench.sequences.table import SequenceTable

_GAZE_SHIFT_SPAN = (-2.0, 8.0)
"""Seconds before and after the prime time over which the gaze shift is averaged."""
_GAZE_SHIFT_STEP = 0.1
_COLUMNS = ("joints", "goal_location", "gaze_origin", "gaze_direction", "gaze_valid", "fps", "preroll", "split")


_SCALARS = (
    "split",
    "participant_id",
    "pose_source",
    "event_time",
    "start_time",
    *(name for name in QUANTITIES if name != "duration"),
)


@dataclass(frozen=True)
class TableStatistics:
    """Numbers of one built dataset."""

    dataset: str
    sequences: int
    by_split: dict[str, int]
    participants_in_two_splits: int
    """People of whom there are both training and test sequences: the study splits by recording, not by person."""
    pose_sources: tuple[str, ...]
    duration: Float[np.ndarray, " n"]
    prime_gap: Float[np.ndarray, " n"]
    body_movement: Float[np.ndarray, " n"]
    hand_movement: Float[np.ndarray, " n"]
    goal_distance: Float[np.ndarray, " n"]
    goal_elevation_deg: Float[np.ndarray, " n"]
    goal_azimuth_deg: Float[np.ndarray, " n"]
    gaze_shift_times: Float[np.ndarray, " k"]
    """Seconds from the prime time: left edges of bins."""
    gaze_shift_deg: Float[np.ndarray, "k 3"]
    """Quartiles over all sequences of the angle between gaze and goal in each bin; NaN where nothing was measured."""

    def spread(self, quantity: str) -> Spread:
        """Mean and standard deviation of one of the four quantities of Table 1; NaN without sequences."""
        values = getattr(self, quantity)
        if not len(values):
            return Spread(float("nan"), float("nan"))
        return Spread(float(values.mean()), float(values.std()))

    def deviation(self, quantity: str, published: Spread) -> float:
        """(our mean - the published one) in published standard deviations."""
        return (self.spread(quantity).mean - published.mean) / published.sd


def table_statistics(table: SequenceTable) -> TableStatistics:
    """Compute the statistics of a built dataset; rows are streamed.

    A sequence lasts from its first frame to the event: up to one frame less than from 2 s before the prime.
    """
    scalars = table.scalars(columns=_SCALARS)
    splits = scalars["split"].to_pylist()
    goals = [np.zeros((0, 3))]  # a dataset may hold events alone
    with _Angles() as angles:
        for chunk in table.chunks(columns=_COLUMNS):
            goals.append(_goal_from_start(chunk))
            angles.add(_gaze_shift(chunk))
        quartiles = angles.quartiles()
    goal = np.concatenate(goals)
    horizontal = np.hypot(goal[:, 0], goal[:, 2])
    return TableStatistics(
        dataset=table.info.dataset,
        sequences=len(splits),
        by_split={split: splits.count(split) for split in ("train", "validation", "test")},
        participants_in_two_splits=len(_people(scalars, "train") & _people(scalars, "test")),
        pose_sources=tuple(sorted(set(scalars["pose_source"].to_pylist()))),
        duration=(scalars["event_time"].to_numpy() - scalars["start_time"].to_numpy()),
        **{name: scalars[name].to_numpy() for name in QUANTITIES if name != "duration"},
        goal_distance=np.linalg.norm(goal, axis=1),
        goal_elevation_deg=np.rad2deg(np.arctan2(goal[:, 1], horizontal)),
        goal_azimuth_deg=np.rad2deg(np.arctan2(goal[:, 0], goal[:, 2])),
        gaze_shift_times=_bin_times(),
        gaze_shift_deg=quartiles,
    )


def _people(scalars: pa.Table, split: str) -> set[str]:
    return set(scalars.filter(pc.field("split") == split)["participant_id"].to_pylist())


def _goal_from_start(chunk: SequenceChunk) -> Float[np.ndarray, "b 3"]:
    return chunk.vectors("goal_location") - chunk.joints[chunk.offsets[:-1], Joint.PELVIS]


def _gaze_shift(chunk: SequenceChunk) -> Float[np.ndarray, "m 2"]:
    """Time from the prime, and angle between gaze and goal in degrees, of every frame with valid gaze."""
    row = np.repeat(np.arange(len(chunk)), chunk.n_frames)
    frame = np.arange(len(row)) - chunk.offsets[row]
    time = frame / chunk.numbers("fps")[row] - chunk.numbers("preroll")[row]
    towards = chunk.vectors("goal_location")[row] - chunk.frames("gaze_origin")
    length = np.maximum(np.linalg.norm(towards, axis=1), 1e-9)
    cosine = np.einsum("nk,nk->n", towards, chunk.frames("gaze_direction")) / length
    angle = np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0)))
    # Invalid samples hold a filler direction that must not enter the quartiles.
    return np.column_stack([time, angle])[chunk.frames("gaze_valid")]


def _bin_times() -> Float[np.ndarray, " bins"]:
    first, last = _GAZE_SHIFT_SPAN
    return np.round(np.arange(first, last, _GAZE_SHIFT_STEP), 6)


class _Angles(contextlib.ExitStack):
    """Angles of all frames, kept in a temporary file for each bin of time: a table may hold millions of frames."""

    def __init__(self) -> None:
        super().__init__()
        self._files = [self.enter_context(tempfile.TemporaryFile()) for _ in _bin_times()]  # noqa: SIM115 - closed at exit

    def add(self, samples: Float[np.ndarray, "m 2"]) -> None:
        """Take up times from the prime and angles."""
        # 1e-6 of a bin: frame times such as 0.30000000000000004 s stay in the bin that they begin.
        bins = np.floor((samples[:, 0] - _GAZE_SHIFT_SPAN[0]) / _GAZE_SHIFT_STEP + 1e-6).astype(int)
        order = np.argsort(bins, kind="stable")
        edges = np.searchsorted(bins[order], np.arange(len(self._files) + 1))
        angles = samples[order, 1]
        for index, file in enumerate(self._files):
            angles[edges[index] : edges[index + 1]].tofile(file)

    def quartiles(self) -> Float[np.ndarray, "bins 3"]:
        """Return the quartiles of each bin; NaN where nothing was measured."""
        found = np.full((len(self._files), 3), np.nan)
        for index, file in enumerate(self._files):
            file.seek(0)
            inside = np.fromfile(file)
            if len(inside):
                found[index] = np.quantile(inside, (0.25, 0.5, 0.75))
        return found


def body_movement(joints: np.ndarray) -> float:
    """Largest 3-D distance of the pelvis from frame 0, metres; joints (n, 22, 3)."""
    pelvis = joints[:, Joint.PELVIS]
    return float(np.linalg.norm(pelvis - pelvis[0], axis=1).max())


def hand_movement(joints: np.ndarray, wrist: int) -> float:
    """Largest displacement of one wrist relative to the pelvis (translation removed, heading not), metres."""
    relative = joints[:, wrist] - joints[:, Joint.PELVIS]
    return float(np.linalg.norm(relative - relative[0], axis=1).max())
