"""From a batch of conditions to motions, in two stages."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float, Int

from prbench.contract import ConditionBatch, Cost, Motions
from prbench.errors import AdapterError
from prbench.skeleton import N_JOINTS
from prbench_adapters.diffusion.batching import parts_of_similar_length
from prbench_adapters.diffusion.bones import on_own_bones
from prbench_adapters.diffusion.noise import SequenceNoise
from prbench_adapters.diffusion.skeletons import ModelBodies
from prbench_adapters.gmd.configuration import GMDConfiguration
from prbench_adapters.gmd.features import decode_absolute
from prbench_adapters.gmd.goals import Ends
from prbench_adapters.gmd.model import GMDModel
from prbench_adapters.gmd.stages import GMDSettings, GuidedNetwork, sample_motion, sample_trajectory

_LARGEST_PART = {"cpu": 16}  # sequences in one pass; their activations are kept for the gradient
_LARGEST_PART_ELSEWHERE = 64


def generate(model: GMDModel, batch: ConditionBatch, settings: GMDSettings) -> Motions:
    """Sample one motion for each row, each from its own noise seed.

    Rows of one padded length share passes; which ones changes a motion by rounding only.

    Raises:
        AdapterError: if a sequence is longer than the model knows.
    """
    _require_lengths(batch, model.configuration)
    bodies = ModelBodies.of(batch, model.configuration)
    joints = np.zeros((len(batch), int(batch.n_frames.max()), N_JOINTS, 3), dtype=np.float32)
    passes = 0
    for rows in _parts(batch.n_frames, model):
        own, spent = _sample(model, bodies.batch, rows, settings)
        joints[rows, : own.shape[1]] = own
        passes += spent
    motions = Motions(bodies.own(joints), batch.n_frames, Cost(passes))
    return on_own_bones(motions, batch) if settings.bones == "initial" else motions


def _parts(n_frames: Int[np.ndarray, " batch"], model: GMDModel) -> list[Int[np.ndarray, " _"]]:
    """Row numbers in parts of one padded length, which group normalisation sees, and of similar true length."""
    largest = _LARGEST_PART.get(model.device.type, _LARGEST_PART_ELSEWHERE)
    windows = np.array([model.configuration.window(int(n)) for n in n_frames])
    parts = []
    for window in np.unique(windows):
        rows = np.flatnonzero(windows == window)
        parts += [rows[part] for part in parts_of_similar_length(n_frames[rows], largest)]
    return parts


def _sample(
    model: GMDModel, batch: ConditionBatch, rows: Int[np.ndarray, " _"], settings: GMDSettings
) -> tuple[Float[np.ndarray, "rows frames 22 3"], int]:
    """Joints of some rows, and the network passes that they took."""
    assert batch.initial_joints is not None
    assert batch.goal_joints is not None
    assert batch.text is not None
    n_frames = torch.as_tensor(batch.n_frames[rows], device=model.device)
    ends = Ends(_tensor(batch.initial_joints[rows], model), _tensor(batch.goal_joints[rows], model), n_frames)
    noise = SequenceNoise([batch.noise_seed[row] for row in rows], batch.n_frames[rows], model.device)
    text = model.encode(tuple(batch.text[row] for row in rows))
    window = model.configuration.window(int(n_frames.max()))
    trajectory_network, motion_network = (
        GuidedNetwork(network, text, n_frames, window=window, scale=settings.guidance)
        for network in (model.networks.trajectory, model.networks.motion)
    )
    keyframes = ends.root_keyframes()
    trajectory = sample_trajectory(trajectory_network, model.schedule, model.space, keyframes, noise, settings)
    features = sample_motion(motion_network, model.schedule, model.space, trajectory, ends, noise, settings)
    return decode_absolute(features).cpu().numpy(), trajectory_network.passes + motion_network.passes


def _tensor(values: np.ndarray, model: GMDModel) -> torch.Tensor:
    return torch.as_tensor(values, dtype=torch.float32, device=model.device)


def _require_lengths(batch: ConditionBatch, configuration: GMDConfiguration) -> None:
    longest = int(batch.n_frames.max())
    if longest > configuration.max_frames:
        raise AdapterError(
            f"the model generates at most {configuration.max_frames} frames, and was asked for {longest}."
        )
