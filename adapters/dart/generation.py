"""From a batch of conditions to motions: free roll-outs, or roll-outs whose noise is optimised towards a goal."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from prbench.contract import ConditionBatch, Cost, Motions
from prbench.errors import AdapterError
from prbench.skeleton import N_JOINTS, Joint
from prbench_adapters.dart.guidance import GuidedDenoiser, by_ddim, by_ddpm
from prbench_adapters.dart.model import DartModel
from prbench_adapters.dart.optimisation import optimise
from prbench_adapters.dart.rollout import Primitive, first_history, roll_out
from prbench_adapters.dart.settings import DartSettings
from prbench_adapters.diffusion.batching import parts_of_similar_length
from prbench_adapters.diffusion.noise import SequenceNoise
from prbench_adapters.diffusion.noise_optimisation.generation import targets_of
from prbench_adapters.diffusion.skeletons import ModelBodies
from prbench_adapters.kinematics.worlds import DART

_LARGEST_PART = {"cpu": 16}  # sequences rolled out side by side; all their passes are kept for the gradient
_LARGEST_PART_ELSEWHERE = 64
_SHORTEST_ACROSS = 1e-6  # metres between the hips, along the ground


def generate(model: DartModel, batch: ConditionBatch, settings: DartSettings) -> Motions:
    """One motion for each row, each from its own noise seed; its first frame is the initial pose.

    Args:
        model: The frozen model.
        batch: Conditions with an initial state, a text and a goal.
        settings: Of roll-out and optimisation.

    Raises:
        AdapterError: for another frame rate than the model's, or an initial state that is not finite or has no heading.
    """
    _require_frame_rate(batch, model)
    _require_headings(batch)
    bodies = ModelBodies.of(batch, model.configuration)
    joints = np.zeros((len(batch), int(batch.n_frames.max()), N_JOINTS, 3), dtype=np.float32)
    passes = 0
    largest = _LARGEST_PART.get(model.device.type, _LARGEST_PART_ELSEWHERE)
    for rows in parts_of_similar_length(batch.n_frames, largest):
        part = _Part(model, _rows(bodies.batch, rows), settings)
        own = part.motions()
        joints[rows, : own.shape[1]] = own
        passes += part.passes
    return Motions(bodies.own(joints), batch.n_frames, Cost(passes))


class _Part:
    """Sequences of similar length that are generated side by side."""

    def __init__(self, model: DartModel, batch: ConditionBatch, settings: DartSettings) -> None:
        assert batch.text is not None
        self.model, self.batch, self.settings = model, batch, settings
        targets = targets_of(batch, model.device)
        if settings.seeding == "repeat":
            targets = replace(targets, previous_joints=targets.initial_joints)
        self.targets = targets
        self.n_frames = int(batch.n_frames.max())
        self.primitives = model.configuration.primitives_for(self.n_frames + 1)  # the frame before the first counts
        previous, initial = (DART.from_y_up(each) for each in (targets.previous_joints, targets.initial_joints))
        frames, self.placement = first_history(previous, initial)
        self.history = model.scaling.standardised(frames)
        self.denoiser = GuidedDenoiser(model.denoiser, model.text_vectors(batch.text), settings.guidance)
        self.decoded = 0
        self._noise = SequenceNoise(batch.noise_seed, np.ones(len(batch), dtype=np.int64), model.device)

    @property
    def passes(self) -> int:
        """Of denoiser and decoder, summed over sequences; those for gradients alone are not counted."""
        return self.denoiser.passes + self.decoded

    def motions(self) -> Float[np.ndarray, "rows frames 22 3"]:
        if not self.settings.optimised:
            with torch.no_grad():
                return self._joints(self._free()).cpu().numpy()
        start = self.settings.noise_scale * torch.stack([self._draw() for _ in range(self.primitives)])
        lengths = torch.as_tensor(self.batch.n_frames, device=self.model.device)
        found = optimise(self._from_noise, start, self.targets, lengths, self.settings)
        return found.joints.cpu().numpy()

    def _draw(self) -> Float[Tensor, "batch 1 latent"]:
        """The next noise of every sequence, drawn from its own seed: neither batch nor length changes a number."""
        return self._noise.draw(self.model.configuration.latent)

    def _free(self) -> list[Primitive]:
        self.decoded += self.primitives * len(self.batch)
        sample = by_ddpm(self.denoiser, self.model.schedule, self._draw)
        return roll_out(self.model, self.history, self.placement, sample, self.primitives)

    def _from_noise(self, noise: Float[Tensor, "primitives batch 1 latent"]) -> Float[Tensor, "batch frames 22 3"]:
        self.decoded += self.primitives * len(self.batch)
        sample = by_ddim(self.denoiser, self.model.schedule, noise, steps=self.settings.ddim_steps)
        checkpointing = self.settings.checkpointing
        return self._joints(
            roll_out(self.model, self.history, self.placement, sample, self.primitives, checkpointing=checkpointing)
        )

    def _joints(self, primitives: list[Primitive]) -> Float[Tensor, "batch frames 22 3"]:
        """The initial pose and what follows it, cut to the longest sequence; canonical frame.

        The world that is rolled out in is the canonical frame with its axes exchanged, so nothing else has to be
        turned back.
        """
        future = DART.to_y_up(torch.cat([each.joints for each in primitives], dim=1))
        return torch.cat((self.targets.initial_joints[:, None], future), dim=1)[:, : self.n_frames]


def _require_frame_rate(batch: ConditionBatch, model: DartModel) -> None:
    if batch.fps != model.configuration.fps:
        raise AdapterError(
            f"adapter 'dart': expected {model.configuration.fps:g} frames per second, found {batch.fps:g}."
        )


def _rows(batch: ConditionBatch, rows: Int[np.ndarray, " rows"]) -> ConditionBatch:
    """Some rows of a batch, in this order."""
    changed = {}
    for field in fields(batch):
        value = getattr(batch, field.name)
        if isinstance(value, np.ndarray):
            changed[field.name] = value[rows]
        elif isinstance(value, tuple):
            changed[field.name] = tuple(value[row] for row in rows)
    return replace(batch, **changed)


def _require_headings(batch: ConditionBatch) -> None:
    """Refuse initial states that no primitive can start from."""
    for name in ("previous_joints", "initial_joints"):
        joints = getattr(batch, name)
        across = joints[:, Joint.RIGHT_HIP] - joints[:, Joint.LEFT_HIP]
        finite = np.isfinite(joints).all(axis=(1, 2))
        bad = np.flatnonzero(~finite | ~(np.hypot(across[:, 0], across[:, 2]) > _SHORTEST_ACROSS))
        if bad.size:
            row = int(bad[0])
            found = "hips on one vertical line" if finite[row] else "joints that are not finite"
            raise AdapterError(
                f"adapter 'dart', row {row} of the batch (opaque id {batch.opaque_id[row][:12]}), {name}: expected a"
                f" pose whose hips say which way it faces, found {found}. `prbench validate` checks a table."
            )
