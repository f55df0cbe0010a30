"""GMD: guided motion diffusion, a trajectory of the root towards keyframes and then a body that follows it.

One of the study's compared methods (*Prime and Reach*, table 2; docs/specification/gmd.md). Goals enter at sampling
alone, by gradients through the networks and by imputation; the networks know text only.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import cast

import numpy as np
import torch

from prbench.contract import Condition, ConditionBatch, Cost, Motions
from prbench.geometry.skeleton import N_JOINTS
from prbench_adapters.diffusion import generation
from prbench_adapters.diffusion.goal_frame import smoothed
from prbench_adapters.diffusion.method import SingleModelMethod, own_weights, require_goals_within_reach
from prbench_adapters.diffusion.model import SMOOTHINGS
from prbench_adapters.finishing import FINISHING_OPTIONS, Finishing
from prbench_adapters.gmd.model import GMDModel, decode_absolute
from prbench_adapters.gmd.sampling import (
    Ends,
    GMDSettings,
    GuidedNetwork,
    Keyframes,
    sample_motion,
    sample_trajectory,
    without_jumps,
)

_OPTIONS = ("guidance", "goal-scale", "keyframes", "steps", "text-path", *FINISHING_OPTIONS)
# Sequences in one pass, on a processor and elsewhere; their activations are kept for the gradient.
_LARGEST_PARTS = (16, 64)


class GMD(SingleModelMethod):
    """Brings the pelvis to where the goal pose has it, or with ``keyframes="pose"`` the whole body."""

    name = "gmd"
    conditions = frozenset({Condition.GOAL_POSE})

    def generate(self, batch: ConditionBatch, *, seed: int) -> Motions:  # noqa: ARG002 - each row has its own
        """Sample one motion for each row.

        Raises:
            AdapterError: for a goal that no body can reach, or a sequence that is longer than the model knows.
        """
        require_goals_within_reach(batch, adapter=self.name)
        return self.finishing(generate(self.model, batch, self.settings), batch)


def load(weights: Path | None, *, options: Mapping[str, str], device: str) -> GMD:
    """Entry point ``gmd``.

    Options: ``keyframes`` (root, or pose to impute both given poses), ``guidance`` (2.5), ``goal-scale`` (100, weight
    of the goal's gradient), ``steps`` (of each stage; all of the training's), ``text-path`` (files of the text encoder,
    if the weights need one that has some), and ``FINISHING_OPTIONS``.

    Args:
        weights: File, folder or name of bundled weights; None for ``gmd-small``.
        options: See above.
        device: ``cpu``, ``cuda`` …

    Raises:
        AdapterError: if there is no such device, or there are no such weights.
        InputFileError: if the file is not one of GMD.
        ValueError: for options that are unknown or have impossible values.
    """
    generation.require_known(options, _OPTIONS)
    path = own_weights(GMD.name, weights)
    model = GMDModel.load(path, device, text_path=options.get("text-path"))
    settings = GMDSettings(
        guidance=generation.number(options, "guidance", GMDSettings.guidance),
        goal_scale=generation.number(options, "goal-scale", GMDSettings.goal_scale),
        keyframes=cast("Keyframes", generation.choice(options, "keyframes", ("root", "pose"))),
        steps=generation.whole_number(options, "steps", most=model.configuration.diffusion_steps),
    )
    return GMD(model, path, settings, finishing=Finishing.of(options))


def generate(model: GMDModel, batch: ConditionBatch, settings: GMDSettings) -> Motions:
    """Sample one motion for each row, each from its own noise seed.

    Rows of one padded length share passes; which ones changes a motion by rounding only.

    Raises:
        AdapterError: if a sequence is longer than the model knows.
    """
    generation.require_lengths(batch, model.configuration.max_frames)
    bodies = generation.ModelBodies.of(batch, model.configuration)
    given = bodies.batch
    assert given.initial_joints is not None
    assert given.goal_joints is not None
    assert given.text is not None
    joints = np.zeros((len(batch), int(batch.n_frames.max()), N_JOINTS, 3), dtype=np.float32)
    passes = 0
    largest = _LARGEST_PARTS[model.device.type != "cpu"]
    windows = np.array([model.configuration.window(int(n)) for n in batch.n_frames])
    # Parts of one padded length, which group normalisation sees, and of similar true length.
    parts = []
    for window in np.unique(windows):
        rows = np.flatnonzero(windows == window)
        parts += [rows[part] for part in generation.parts_of_similar_length(batch.n_frames[rows], largest)]
    for rows in parts:
        n_frames = torch.as_tensor(given.n_frames[rows], device=model.device)
        ends = Ends(_tensor(given.initial_joints[rows], model), _tensor(given.goal_joints[rows], model), n_frames)
        noise = generation.SequenceNoise([given.noise_seed[row] for row in rows], given.n_frames[rows], model.device)
        text = model.encode(tuple(given.text[row] for row in rows))
        window = model.configuration.window(int(n_frames.max()))
        trajectory_network, motion_network = (
            GuidedNetwork(network, text, n_frames, window=window, scale=settings.guidance)
            for network in (model.networks.trajectory, model.networks.motion)
        )
        keyframes = ends.root_keyframes()
        trajectory = sample_trajectory(trajectory_network, model.schedule, model.space, keyframes, noise, settings)
        trajectory = without_jumps(trajectory, keyframes, n_frames)
        features = sample_motion(motion_network, model.schedule, model.space, trajectory, ends, noise, settings)
        for _ in range(SMOOTHINGS if model.configuration.smoothed else 0):
            features = smoothed(features, n_frames)
        own = decode_absolute(features).cpu().numpy()
        joints[rows, : own.shape[1]] = own
        passes += trajectory_network.passes + motion_network.passes
    return Motions(bodies.own(joints), batch.n_frames, Cost(passes))


def _tensor(values: np.ndarray, model: GMDModel) -> torch.Tensor:
    return torch.as_tensor(values, dtype=torch.float32, device=model.device)
