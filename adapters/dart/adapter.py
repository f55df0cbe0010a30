"""DartControl as a method of the benchmark (docs/specification/dart.md; *Prime and Reach*, section 5.3)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import pad

from prbench.contract import Condition, ConditionBatch, Cost, Motions
from prbench.errors import AdapterError
from prbench.geometry.skeleton import N_JOINTS, Joint
from prbench_adapters.dart import rollout
from prbench_adapters.dart.model import OPTIONS, DartModel, DartSettings, dart_settings
from prbench_adapters.diffusion.generation import ModelBodies, SequenceNoise, require_known
from prbench_adapters.diffusion.method import SingleModelMethod, own_weights, require_goals_within_reach
from prbench_adapters.diffusion.optimised_generation import targets_of
from prbench_adapters.kinematics import DART

# Primitives of all sequences side by side, on a processor and elsewhere; all passes are kept for the gradient.
_LARGEST_PARTS = (320, 960)
_SHORTEST_ACROSS = 1e-6  # metres between the hips, along the ground


class DartControl(SingleModelMethod):
    """Starts with the initial pose and velocity, and moves the noise of all primitives until the last frame fits."""

    name = "dart"
    conditions = frozenset({Condition.GOAL_POSE, Condition.GOAL_LOCATION})

    def generate(self, batch: ConditionBatch, *, seed: int) -> Motions:  # noqa: ARG002 - each row has its own
        """Generate one motion for each row.

        Raises:
            AdapterError: for a goal that no body can reach, or an initial state that has no heading.
        """
        require_goals_within_reach(batch, adapter=self.name)
        return self.settings.finishing(generate(self.model, batch, self.settings), batch)


def load(weights: Path | None, *, options: Mapping[str, str], device: str) -> DartControl:
    """Entry point ``dart``.

    Options: ``optimise`` (fast; paper; off for text alone), ``iterations``, ``learning-rate``, ``noise-scale``,
    ``ddim-steps``, ``guidance``, ``hand`` (right, nearest or left), ``bones`` (initial, predicted), ``feet`` (steps,
    predicted), ``text-path`` (files of the text encoder, if the weights need one that has some).

    Args:
        weights: File, folder or name of bundled weights; None for ``dart-small``.
        options: See above.
        device: ``cpu``, ``cuda`` …

    Raises:
        AdapterError: if there is no such device, or there are no such weights.
        InputFileError: if the file is not one of DART.
        ValueError: for options that are unknown or have impossible values.
    """
    require_known(options, OPTIONS)
    path = own_weights(DartControl.name, weights)
    model = DartModel.load(path, device, text_path=options.get("text-path"))
    return DartControl(model, path, dart_settings(options, diffusion_steps=model.configuration.diffusion_steps))


def generate(model: DartModel, batch: ConditionBatch, settings: DartSettings) -> Motions:
    """One motion for each row, each from its own noise seed; its first frame is the initial pose.

    Args:
        model: The frozen model.
        batch: Conditions with an initial state, a text and a goal.
        settings: Settings of roll-out and optimisation.

    Raises:
        AdapterError: for another frame rate than the model's, or an initial state that is not finite or has no heading.
    """
    if batch.fps != model.configuration.fps:
        problem = f"expected {model.configuration.fps:g} frames per second, found {batch.fps:g}."
        raise AdapterError(f"adapter 'dart': {problem}")
    # No primitive can start from an initial state without a heading.
    for name in ("previous_joints", "initial_joints"):
        given = getattr(batch, name)
        across = given[:, Joint.RIGHT_HIP] - given[:, Joint.LEFT_HIP]
        finite = np.isfinite(given).all(axis=(1, 2))
        bad = np.flatnonzero(~finite | ~(np.hypot(across[:, 0], across[:, 2]) > _SHORTEST_ACROSS))
        if bad.size:
            row = int(bad[0])
            found = "hips on one vertical line" if finite[row] else "joints that are not finite"
            refusal = f"adapter 'dart', row {row} of the batch (opaque id {batch.opaque_id[row][:12]}), {name}:"
            refusal += f" expected a pose whose hips say which way it faces, found {found}. `prbench view --data DIR`"
            raise AdapterError(f"{refusal} draws them.")
    bodies = ModelBodies.of(batch, model.configuration)
    joints = np.zeros((len(batch), int(batch.n_frames.max()), N_JOINTS, 3), dtype=np.float32)
    passes = 0
    primitives = _primitives(model, batch)
    for rows in parts_of_similar_cost(primitives, _LARGEST_PARTS[model.device.type != "cpu"]):
        given = vars(bodies.batch)
        part: dict[str, Any] = {name: value[rows] for name, value in given.items() if isinstance(value, np.ndarray)}
        part |= {name: tuple(map(value.__getitem__, rows)) for name, value in given.items() if isinstance(value, tuple)}
        own, spent = _sampled(model, replace(bodies.batch, **part), settings)
        joints[rows, : own.shape[1]] = own
        passes += spent
    return Motions(bodies.own(joints), batch.n_frames, Cost(passes))


def parts_of_similar_cost(primitives: Int[np.ndarray, " batch"], largest: int) -> list[Int[np.ndarray, " _"]]:
    """Row numbers in as few parts as hold about ``largest`` primitives each, longest sequences first.

    A sequence leaves its part when it ends, so lengths in a part may differ; the more of them go side by side, the less
    each costs.
    """
    order = np.argsort(-primitives, kind="stable")
    before = np.cumsum(primitives[order]) - primitives[order]
    total = int(primitives.sum())
    # Each row goes to the part in which its first primitive falls if all primitives are cut into equal stretches.
    part = before * -(-total // largest) // total
    return [order[part == number] for number in np.unique(part)]


def _primitives(model: DartModel, batch: ConditionBatch) -> Int[np.ndarray, " batch"]:
    """Count the primitives that each sequence takes; the frame before its first counts."""
    return np.array([model.configuration.primitives_for(int(n) + 1) for n in batch.n_frames])


def _sampled(
    model: DartModel, batch: ConditionBatch, settings: DartSettings
) -> tuple[Float[np.ndarray, "rows frames 22 3"], int]:
    """Generate sequences side by side, the longest first.

    Returns:
        Joints, canonical frame, metres; passes of denoiser and decoder, summed over sequences, those for gradients
        alone not counted.
    """
    assert batch.text is not None
    targets = targets_of(batch, model.device)
    n_frames = int(batch.n_frames.max())
    primitives = _primitives(model, batch)
    # Longest first, so that the sequences which have a primitive are always the first rows.
    going_on = [int((primitives > number).sum()) for number in range(int(primitives.max()))]
    previous = DART.from_y_up(torch.as_tensor(batch.previous_joints).to(targets.initial_joints))
    initial = DART.from_y_up(targets.initial_joints)
    frames, placement = rollout.first_history(previous, initial)
    history = model.scaling.standardised(frames)
    denoiser = rollout.GuidedDenoiser(model.denoiser, model.text_vectors(batch.text), settings.guidance)
    drawn = SequenceNoise(batch.noise_seed, np.ones(len(batch), dtype=np.int64), model.device)
    decoded = 0

    def draw() -> Float[Tensor, "batch 1 latent"]:
        """Return next noise of every sequence, drawn from its own seed: neither batch nor length changes a number."""
        return drawn.draw(model.configuration.latent)

    def rolled(sample: rollout.SampleLatent) -> Float[Tensor, "batch frames 22 3"]:
        """Return the initial pose and what follows, cut to the longest sequence, zeros behind each end; canonical.

        The world that is rolled out in is the canonical frame with its axes exchanged, so nothing else has to be
        turned back.
        """
        nonlocal decoded
        decoded += sum(going_on)
        keep = partial(rollout.kept, first=initial, finishing=settings.finishing)
        done = rollout.roll_out(model, history, placement, sample, len(going_on), going_on=going_on, keep=keep)
        # Primitives of sequences that have ended have fewer rows; zeros keep the batch rectangular.
        rows = [pad(each.joints, (0, 0) * 3 + (0, len(batch) - len(each.joints))) for each in done]
        return torch.cat((targets.initial_joints[:, None], DART.to_y_up(torch.cat(rows, dim=1))), dim=1)[:, :n_frames]

    def from_noise(noise: Float[Tensor, "primitives batch 1 latent"]) -> Float[Tensor, "batch frames 22 3"]:
        return rolled(rollout.by_ddim(denoiser, model.schedule, noise, steps=settings.ddim_steps))

    if settings.optimised:
        # Small noise: the start lies near the mean of what the model draws.
        start = settings.noise_scale * torch.stack([draw() for _ in going_on])
        lengths = torch.as_tensor(batch.n_frames, device=model.device)
        _, joints = rollout.optimise(from_noise, start, targets, lengths, settings)
    else:
        with torch.no_grad():
            joints = rolled(rollout.by_ddpm(denoiser, model.schedule, draw))
    return joints.cpu().numpy(), denoiser.passes + decoded
