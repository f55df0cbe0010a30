"""Training of the gaze network on recorded motions that have gaze."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from prbench.errors import TableError, UsageError
from prbench.geometry.skeleton import Joint, head_forward
from prbench.sequences import SequenceChunk, SequenceTable
from prbench_adapters.pr.gaze.network import (
    KIND,
    GazeConfiguration,
    GazeNetwork,
    History,
    Seen,
    contents,
    on_goal,
    turned,
    turned_back,
)
from prbench_adapters.training import MotionBatch
from prbench_adapters.training.task import TrainingData, TrainingModule
from prbench_adapters.training.weights import origin_of, read_weights

STAGE = "gaze"
_COLUMNS = ("joints", "gaze_origin", "gaze_direction", "gaze_valid", "head_tilt_deg")
_MIRRORED = "#mirrored"
_JITTER = math.radians(0.3)
"""Deviation of the noise on earlier directions in training; in generation these are the network's own."""
_STRANGE = 0.04
"""Share of frames whose history is another motion's. Recorded eyes are where they ought to be, so a network that saw
nothing else would not look at the goal in time once it has strayed; it would rest where it is."""
_DRAWS = 8
"""Directions whose mean is measured in validation."""
_EYE_WEIGHT = 10.0  # of the squared error of the eyes' place, square decimetres, beside nats


@dataclass(frozen=True)
class RecordedGaze:
    """Gaze of one sequence, canonical frame of the table."""

    direction: Float[np.ndarray, "n 3"]
    """Unit vectors; where a sample is not valid, that of the last valid one."""
    valid: Bool[np.ndarray, " n"]
    eye: Float[np.ndarray, "n 3"]
    """The eyes seen from the head joint, metres."""
    head_tilt_deg: float
    usual: Float[np.ndarray, "3"]
    """Mean direction seen from the head, with head-forward as third axis; the first points left."""

    def mirrored(self) -> RecordedGaze:
        """Return the same gaze with left and right exchanged."""
        flip = np.array([-1, 1, 1], dtype=np.float32)
        return RecordedGaze(self.direction * flip, self.valid, self.eye * flip, self.head_tilt_deg, self.usual * flip)


def recorded_gaze(tables: Iterable[object], splits: frozenset[str]) -> dict[str, RecordedGaze]:
    """Read the gaze of all sequences that have some, by sequence id."""
    found: dict[str, RecordedGaze] = {}
    for table in tables:
        if not isinstance(table, SequenceTable):
            continue  # a corpus has no gaze
        present = set(table.scalars()["split"].to_pylist())
        for split in sorted(splits & present):
            for chunk in table.chunks(split=split, columns=_COLUMNS):
                found |= _gaze_of(chunk)
    return found


def _gaze_of(chunk: SequenceChunk) -> dict[str, RecordedGaze]:
    direction = chunk.frames("gaze_direction")
    eye = chunk.frames("gaze_origin") - chunk.joints[:, Joint.HEAD]
    valid = np.asarray(chunk.frames("gaze_valid"), dtype=bool)
    tilt = chunk.numbers("head_tilt_deg")
    axes = tilted_axes(chunk.joints, np.repeat(tilt, chunk.n_frames))
    in_head = np.einsum("fij,fj->fi", axes, np.where(valid[:, None], direction, 0.0))
    found = {}
    for row, name in enumerate(chunk.sequence_ids):
        part = slice(int(chunk.offsets[row]), int(chunk.offsets[row + 1]))
        seen = valid[part]
        if not seen.any():
            continue
        held = np.maximum.accumulate(np.where(seen, np.arange(len(seen)), -1))
        held[held < 0] = np.flatnonzero(seen)[0]
        found[name] = RecordedGaze(
            direction=direction[part][held].astype(np.float32),
            valid=seen,
            eye=eye[part][held].astype(np.float32),
            head_tilt_deg=float(tilt[row]),
            usual=in_head[part].sum(axis=0) / seen.sum(),
        )
    return found


def tilted_axes(
    joints: Float[np.ndarray, "*batch 22 3"], head_tilt_deg: float | Float[np.ndarray, "*batch"]
) -> Float[np.ndarray, "*batch 3 3"]:
    """Left, up and head-forward of heads as metrics see them; the tilt is what the network is not told."""
    forward, _ = head_forward(joints.astype(np.float64), head_tilt_deg)
    left = joints[..., Joint.LEFT_SHOULDER, :] - joints[..., Joint.RIGHT_SHOULDER, :]
    left = left - (left * forward).sum(axis=-1, keepdims=True) * forward
    left = left / np.maximum(np.linalg.norm(left, axis=-1, keepdims=True), 1e-9)
    return np.stack((left, np.cross(forward, left), forward), axis=-2)


@dataclass(frozen=True)
class _Truth:
    """Recorded gaze of a batch, on its device; padding holds zeros and is not valid."""

    direction: Float[Tensor, "batch frames 3"]
    valid: Bool[Tensor, "batch frames"]
    eye: Float[Tensor, "batch frames 3"]
    head_tilt_deg: Float[np.ndarray, " batch"]


class GazeTraining(TrainingModule):
    """The network with its loss: the negative log-likelihood of each recorded direction after those before it.

    Args:
        network: In its state before the first step.
        gaze: By sequence id, of the splits train and validation.
        trained_on: Ids of the sequences that are learnt from, mirrored copies too.
        origin: Lines for the card about what the weights build upon.
    """

    def __init__(
        self,
        network: GazeNetwork,
        gaze: Mapping[str, RecordedGaze],
        trained_on: Iterable[str],
        origin: tuple[str, ...] = (),
    ) -> None:
        super().__init__()
        self.network, self.gaze, self.origin = network, gaze, origin
        learnt = [gaze[name] for name in trained_on if name in gaze]
        self.sequences = len(learnt)
        usual = np.mean([one.usual for one in learnt], axis=0)
        self.usual = usual / np.linalg.norm(usual)
        """The usual direction of recorded gaze in the head, the floor that one number per axis reaches."""

    def forward(self, batch: MotionBatch, step: int) -> dict[str, torch.Tensor]:
        """The loss of one batch.

        Returns:
            ``loss``, in nats a frame with the error of the eyes' place; ``nats`` alone. In validation also angles
            between recorded directions and others, degrees, means over frames: ``draw_deg`` (one drawn by the network
            alone), ``mean_deg`` (the mean of eight of them), ``offset_deg`` (the usual direction in the head),
            ``head_deg`` (head-forward) and ``goal_deg`` (always at the goal).
        """
        with torch.autocast(batch.joints.device.type, enabled=False):
            truth = self._truth(batch)
            seen = Seen.of(batch.joints, batch.n_frames, batch.goal_location, batch.fps)
            direction = turned(seen.axes, truth.direction)
            jitter = torch.randn(truth.direction.shape, generator=self.generator(step)) * _JITTER
            noisy = truth.direction + (jitter.to(direction) if step >= 0 else 0.0)
            noisy = noisy / noisy.norm(dim=-1, keepdim=True).clamp_min(1e-6)
            history = _history(seen, noisy)
            if step >= 0:
                strange = torch.rand(truth.valid.shape, generator=self.generator(step)).to(noisy) < _STRANGE
                other = _history(seen, noisy.roll(1, dims=0))
                numbers = torch.where(strange[..., None], other.numbers, history.numbers)
                history = History(numbers, torch.where(strange[..., None], other.last, history.last))
            mixture = self.network(seen, history)
            nats = -mixture.log_density(direction)[truth.valid].mean()
            missed = (self.network.eyes(seen) - seen.head - truth.eye)[truth.valid]
            eyes = (10 * missed).square().sum(dim=-1).mean()
            losses = {"loss": nats + _EYE_WEIGHT * eyes, "nats": nats.detach(), "eyes": eyes.detach()}
        return losses if step >= 0 else losses | self._angles(batch, truth, seen, step)

    def weights(self) -> tuple[dict[str, torch.Tensor], dict[str, str]]:
        """Tensors and header of the network."""
        return contents(self.network)

    def learned_from(self) -> tuple[str, ...]:
        """Return lines for the card: how much gaze was learnt from, and what the weights build upon."""
        return (f"recorded gaze of {self.sequences} sequences", *self.origin)

    def _truth(self, batch: MotionBatch) -> _Truth:
        shape = (len(batch), batch.joints.shape[1])
        direction = np.zeros((*shape, 3), dtype=np.float32)
        valid = np.zeros(shape, dtype=bool)
        eye = np.zeros((*shape, 3), dtype=np.float32)
        tilt = np.zeros(len(batch))
        for row, (name, n_frames) in enumerate(zip(batch.sequence_id, batch.n_frames.tolist(), strict=True)):
            gaze = self.gaze.get(name.removesuffix(_MIRRORED))
            if gaze is None:
                continue  # a sequence whose gaze was lost teaches nothing
            if name.endswith(_MIRRORED):
                gaze = gaze.mirrored()
            direction[row, :n_frames] = gaze.direction
            valid[row, :n_frames] = gaze.valid
            eye[row, :n_frames] = gaze.eye
            tilt[row] = gaze.head_tilt_deg
        device = batch.joints.device
        return _Truth(
            torch.from_numpy(direction).to(device),
            torch.from_numpy(valid).to(device),
            torch.from_numpy(eye).to(device),
            tilt,
        )

    def _angles(self, batch: MotionBatch, truth: _Truth, seen: Seen, step: int) -> dict[str, torch.Tensor]:
        generator = self.generator(step)
        draws = []
        for _ in range(_DRAWS):
            noise = torch.rand(truth.direction.shape, generator=generator).to(truth.direction)
            draws.append(self.network.sampled(seen, noise))
        joints = batch.joints.cpu().numpy()
        axes = tilted_axes(joints, np.broadcast_to(truth.head_tilt_deg[:, None], joints.shape[:2]))
        others = {
            "draw_deg": draws[0],
            "mean_deg": torch.stack(draws).mean(dim=0),
            "offset_deg": torch.from_numpy(self.usual @ axes),
            "head_deg": torch.from_numpy(axes[..., 2, :]),
            "goal_deg": turned_back(seen.axes, seen.goal),
        }
        direction = truth.direction
        return {name: _angle_deg(other, direction)[truth.valid].mean() for name, other in others.items()}


def build(model: Mapping[str, Any], data: TrainingData, initial: Path | None) -> GazeTraining:
    """Make the network in its state before the first step.

    Args:
        model: Keys of :class:`GazeConfiguration`.
        data: The training split, tables with gaze.
        initial: Weights to start from.

    Raises:
        UsageError: if the table does not describe such a network, or sequences would be cut.
        InputFileError: if the initial weights do not fit it.
        TableError: if no training sequence has gaze.
    """
    try:
        configuration = msgspec.convert(dict(model), GazeConfiguration)
    except msgspec.ValidationError as error:
        raise UsageError(
            f"[model]: {error}. --stage gaze needs a configuration of a gaze network; `--config gaze` is one."
        ) from error
    if data.fps != configuration.fps:
        raise UsageError(
            f"frames per second of the tables: the gaze network expects {configuration.fps:g}, found {data.fps:g}."
            " Change one of the two."
        )
    gaze = recorded_gaze(data.train.tables, frozenset(("train", "validation")))
    if not any(name in gaze for name in data.train.sequence_ids):
        raise TableError("expected training sequences with gaze, found none. Build the tables from recordings with it.")
    longest = max(len(one.valid) for one in gaze.values())
    if longest > data.max_frames:
        raise UsageError(
            f"data.max_frames: expected at least the {longest} frames of the longest sequence, found {data.max_frames}."
            " Gaze is learnt from whole sequences."
        )
    network = GazeNetwork(configuration)
    start = None
    if initial is not None:
        start = read_weights(initial, kind=KIND)
        start.require_same(configuration, apart_from=frozenset())
        start.load_into(network, "network")
    return GazeTraining(network, gaze, data.train.sequence_ids, origin_of(start))


def _history(seen: Seen, directions: Float[Tensor, "batch frames 3"]) -> History:
    return History.of(seen, directions, on_goal(turned(seen.axes, directions), seen.goal), 0)


def _angle_deg(
    one: Float[Tensor, "batch frames 3"], other: Float[Tensor, "batch frames 3"]
) -> Float[Tensor, "batch frames"]:
    sine = torch.linalg.cross(one, other.to(one)).norm(dim=-1)
    return torch.rad2deg(torch.atan2(sine, (one * other.to(one)).sum(dim=-1)))
