"""Consecutive primitives cut out of training motions, and the statistics of their features."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from prbench.errors import UsageError
from prbench_adapters.dart.configuration import HISTORY_FRAMES, DartConfiguration
from prbench_adapters.dart.frames import N_FEATURES, Frames
from prbench_adapters.dart.model import FeatureScaling
from prbench_adapters.kinematics import DART
from prbench_adapters.training import MotionBatch, SequenceDataset, collate

_STD_FLOORS = ((135, 0.01), (9, 0.001), (66, 0.01), (66, 0.001))
"""Floors of positions and rotations, their deltas, joints, theirs: bones that never turn keep their scale (the original
divided 12 such features of a user's data by zero)."""
_ITEMS_AT_ONCE = 64


@dataclass(frozen=True)
class Window:
    """Consecutive primitives of B motions."""

    frames: Frames
    """All of them, in the motions' own worlds with Z up; primitive k has the frames k·F to k·F + H + F."""
    valid: Bool[Tensor, "batch primitives"]
    """True for primitives that lie inside their motion, the step that leads on from their last frame included."""

    def primitive(self, number: int, future_frames: int) -> Frames:
        """Cut out one primitive, in its own frame of reference."""
        start = number * future_frames
        return self.frames.part(start, start + HISTORY_FRAMES + future_frames).canonical()[0]


def window(
    batch: MotionBatch,
    rows: Int[Tensor, " windows"],
    start: Int[Tensor, " windows"],
    primitives: int,
    configuration: DartConfiguration,
) -> Window:
    """Cut primitives out of motions, of which the frame before the first belongs to them.

    Args:
        batch: The motions.
        rows: Which motion each window is cut out of.
        start: First frame of each window, 0 for the frame before the motion's first.
        primitives: How many; those that reach over the end repeat the last frame and are marked.
        configuration: Frames of a primitive.
    """
    # The frame before the first is recorded, too, and gives the first primitive its history.
    motions = torch.cat((batch.previous_joints[:, None], batch.joints), dim=1)
    last = batch.n_frames[rows]  # its index in these
    length = HISTORY_FRAMES + primitives * configuration.future_frames + 1
    wanted = start[:, None] + torch.arange(length, device=motions.device)
    places = torch.minimum(wanted, last[:, None])
    joints = motions[rows[:, None], places]
    # Where the last delta of each primitive leads to: one frame behind the primitive itself.
    numbers = torch.arange(1, primitives + 1, device=motions.device)
    ends = start[:, None] + HISTORY_FRAMES + configuration.future_frames * numbers
    return Window(Frames.of_joints(DART.from_y_up(joints)), ends <= last[:, None])


def drawn_starts(
    n_frames: Int[Tensor, " batch"], primitives: int, configuration: DartConfiguration, generator: torch.Generator
) -> Int[Tensor, " batch"]:
    """A uniformly drawn first frame for each motion, from which the whole window fits where it can."""
    latest = (n_frames - HISTORY_FRAMES - primitives * configuration.future_frames).clamp_min(0)
    drawn = torch.rand(len(n_frames), generator=generator, dtype=torch.float64)
    return (drawn * (latest + 1)).long().clamp_max(latest)


def feature_scaling(data: SequenceDataset, configuration: DartConfiguration) -> FeatureScaling:
    """Mean and floored standard deviation of the features of all primitives, each in its own frame of reference.

    Raises:
        UsageError: if no motion is long enough for a primitive.
    """
    # Sums of squares of a whole corpus lose their last digits in float32.
    total = torch.zeros(N_FEATURES).double()
    squares = torch.zeros(N_FEATURES).double()
    count = 0
    for primitives in primitives_of(data, range(len(data)), configuration):
        features = primitives.pack().flatten(0, 1)
        total += features.double().sum(dim=0)
        squares += features.double().square().sum(dim=0)
        count += len(features)
    if not count:
        raise UsageError(
            f"data.max_frames: a motion primitive takes {configuration.primitive_frames} frames, found no motion in the"
            " training split that has as many. Raise it, or use other tables."
        )
    mean = total / count
    floor = torch.cat([torch.full((n,), value) for n, value in _STD_FLOORS]).double()
    std = (squares / count - mean.square()).clamp_min(0.0).sqrt().maximum(floor)
    return FeatureScaling(mean.float(), std.float())


def primitives_of(
    data: SequenceDataset,
    places: Sequence[int],
    configuration: DartConfiguration,
    device: torch.device | str = "cpu",
) -> Iterator[Frames]:
    """The primitives of some motions, end to end from the first frame, each in its own frame of reference."""
    for first in range(0, len(places), _ITEMS_AT_ONCE):
        items = [data[place] for place in places[first : first + _ITEMS_AT_ONCE]]
        batch = collate(items).to(device)
        primitives = configuration.primitives_for(int(batch.n_frames.max()) + 1)
        rows = torch.arange(len(batch), device=batch.n_frames.device)
        cut = window(batch, rows, torch.zeros_like(rows), primitives, configuration)
        for number in range(primitives):
            inside = cut.valid[:, number]
            if bool(inside.any()):
                frames = cut.primitive(number, configuration.future_frames)
                yield Frames(**{name: value[inside] for name, value in vars(frames).items()})
