"""The trained networks as predictors of :mod:`prbench_benchmarks.motion_prediction`: observed frames in, K futures out.

Each sample draws its noise from a seed that depends on the run's seed, the window's key and the sample's number alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path

import msgspec
import numpy as np
import torch
from jaxtyping import Float

from prbench.errors import AdapterError, UsageError
from prbench_adapters.diffusion.generation import choice, number, require_known, whole_number
from prbench_adapters.diffusion.method import bundled_names, bundled_weights, resolve
from prbench_adapters.diffusion.model import torch_device
from prbench_adapters.prediction.coefficient_diffusion import held
from prbench_adapters.prediction.records import RECORDS, DiffusionRecord, PredictorNetwork, SeenWindows, network_of
from prbench_adapters.prediction.recurrent import DLow
from prbench_adapters.training.weights import read_weights
from prbench_benchmarks.motion_prediction.batch import Condition, Futures, ObservedBatch, sample_generator
from prbench_benchmarks.motion_prediction.joint_sets import invert_each, rotations_alone, transform_each

_MOST_TOGETHER = 512  # Samples that go through a network together: more take more memory and hardly less time.
_PRECISIONS = {"float32": torch.float32, "float64": torch.float64}
_SAME_TIME = 1e-6  # seconds


class LearnedPredictor:
    """Draws futures with a trained network, one for each condition that there are weights for.

    Args:
        name: What tables call it.
        loaded: The networks, in evaluation mode.
    """

    def __init__(self, name: str, loaded: Sequence[tuple[Path, SeenWindows, PredictorNetwork]]) -> None:
        self.name = name
        self._loaded = {seen.condition: (path, seen, network) for path, seen, network in loaded}
        self.conditions = frozenset(self._loaded)
        self.one_design = any(isinstance(network, DLow) for *_, network in loaded)

    def weights_for(self, condition: Condition) -> Path:
        """Return the weights file in use under a condition."""
        return self._loaded[condition][0]

    def predict(self, batch: ObservedBatch, *, n_samples: int, seed: int) -> Futures:
        """See :class:`prbench_benchmarks.motion_prediction.batch.Predictor`.

        Windows of another rate than the network's are interpolated in time to its own, and its futures back, where both
        last as long.

        Raises:
            UsageError: for another number of samples than DLow's K, which are one design.
            AdapterError: for other joints or another duration than the network was trained on, and for windows without
                any measured gaze.
        """
        path, seen, network = self._loaded[batch.condition]
        if batch.joint_names != seen.joints.names:
            raise AdapterError(
                f"{self.name}: {path.name} was trained on the {seen.n_joints} joints of {seen.joint_set}, these"
                f" windows have {len(batch.joint_names)} others. Choose weights that were trained on such windows."
            )
        expected = (seen.observed / seen.fps, seen.predicted / seen.fps)
        found = (batch.shape[1] / batch.fps, batch.n_future / batch.fps)
        # Half a frame of the slower rate: 10 frames at 20 and 15 at 30 a second last half a second both.
        if max(abs(a - b) for a, b in zip(expected, found, strict=True)) > 0.5 / min(batch.fps, seen.fps):
            raise AdapterError(
                f"{self.name}: {path.name} sees {expected[0]:g} s and predicts {expected[1]:g} s, these windows"
                f" have {found[0]:g} s and {found[1]:g} s. Choose weights that were trained on such windows."
            )
        if isinstance(network, DLow) and n_samples != network.configuration.n_samples:
            wanted = network.configuration.n_samples
            raise UsageError(
                f"{self.name}: its {wanted} samples are one design, of which fewer are no part; expected {wanted}"
                f" samples, found {n_samples}. Ask for {wanted}, or train one with"
                f" --set model.n_samples={n_samples}."
            )
        frames = np.tile(np.eye(4), (len(batch), 1, 1))
        if seen.frame == "last-pose":
            frames = seen.joints.last_pose_frame(batch.observed_joints[:, -1])
        observed = self._observed(batch, seen, invert_each(frames))
        weight = next(network.parameters())
        together = max(_MOST_TOGETHER // n_samples, 1)
        parts = []
        for first in range(0, len(observed), together):
            seeds = []
            for key in batch.key[first : first + together]:
                generators = (sample_generator(seed, key, k) for k in range(n_samples))
                seeds.append([int(each.integers(2**63 - 1)) for each in generators])
            shown = torch.from_numpy(observed[first : first + together]).to(weight)
            parts.append(network.predict(shown, seeds).double().cpu().numpy())
        joints = np.concatenate(parts)[:, :, :, : seen.n_joints]
        if batch.fps != seen.fps:
            last = np.broadcast_to(observed[:, None, -1:, : seen.n_joints], (*joints.shape[:2], 1, *joints.shape[3:]))
            # A quicker rate than the network's begins between the last observed frame and the first predicted one.
            whole = np.concatenate([last, joints], axis=2).swapaxes(1, 2)
            own_times = np.arange(seen.predicted + 1) / seen.fps
            joints = _at_times(whole, own_times, np.arange(1, batch.n_future + 1) / batch.fps).swapaxes(1, 2)
        return Futures(joints=transform_each(frames, joints).astype(np.float32))

    def _observed(
        self, batch: ObservedBatch, seen: SeenWindows, own_from_batch: Float[np.ndarray, "batch 4 4"]
    ) -> Float[np.ndarray, "batch observed nodes 3"]:
        """Return the observed nodes in the network's frame and at its rate; never a direction of a later frame."""
        # The last observed frame is at 0 at either rate.
        times = np.arange(1 - batch.shape[1], 1) / batch.fps
        own_times = np.arange(1 - seen.observed, 1) / seen.fps
        joints = transform_each(own_from_batch, batch.observed_joints)
        if batch.fps != seen.fps:
            joints = _at_times(joints, times, own_times)
        if batch.gaze is None or batch.gaze_valid is None:
            return joints
        turned = transform_each(rotations_alone(own_from_batch), batch.gaze)[:, :, None]
        try:
            measured = held(torch.from_numpy(turned), torch.from_numpy(batch.gaze_valid.copy())).numpy()
        except ValueError as error:
            remedy = "Choose windows with measured gaze, or another condition."
            raise AdapterError(f"{self.name}: {error}. {remedy}") from error
        latest = np.searchsorted(times, own_times + _SAME_TIME, side="right") - 1
        return np.concatenate([joints, measured[:, np.maximum(latest, 0)]], axis=2)


def load_predictor(name: str, weights: Path | None, *, options: Mapping[str, str], device: str) -> LearnedPredictor:
    """Load the networks of a method.

    Options: ``precision`` (float32, float64); of GazeMoDiff and HumanMAC also ``steps`` of sampling, which must divide
    those of the training, and ``guidance``.

    Args:
        name: The method's name.
        weights: File, folder or name of bundled weights; None for those that come with prbench, ``<method>-small-…``,
            one for each condition.
        options: See above.
        device: ``cpu``, ``cuda`` …

    Raises:
        AdapterError: if there is no such device, or no such weights.
        InputFileError: if a file holds no weights of this method.
        ValueError: for options that are unknown or have impossible values.
    """
    is_diffusion = RECORDS[name] is DiffusionRecord
    require_known(options, ("precision", "steps", "guidance") if is_diffusion else ("precision",))
    precision = _PRECISIONS[choice(options, "precision", tuple(_PRECISIONS))]
    where = torch_device(device)
    folder = Path(str(files("prbench_adapters"))) / "prediction" / "weights"
    if weights is not None:
        paths = [resolve(weights, name, folder=folder)]
    else:
        paths = [bundled_weights(each, folder) for each in bundled_names(folder) if each.startswith(f"{name}-small")]
    if not paths:
        why = f"(`prbench train --method {name} --config small --data WINDOWS… --out DIR`) and give --weights."
        raise AdapterError(f"{name}: no weights come with this version of prbench. Train some {why}")
    loaded = []
    for path in paths:
        file = read_weights(path, kind=name)
        record = file.configuration(RECORDS[name])
        if is_diffusion:  # the number of sampling steps and guidance change no tensor
            network = record.network
            steps = whole_number(options, "steps", most=network.diffusion_steps) or network.sampling_steps
            guidance = number(options, "guidance", network.guidance)
            network = msgspec.structs.replace(network, sampling_steps=steps, guidance=guidance)
            record = msgspec.structs.replace(record, network=network)
        loaded.append((path, record.windows, network_of(file, record).to(where, precision)))
    return LearnedPredictor(name, loaded)


def _at_times(
    values: Float[np.ndarray, "batch frames *shape"],
    times: Float[np.ndarray, " frames"],
    wanted: Float[np.ndarray, " others"],
) -> Float[np.ndarray, "batch others *shape"]:
    """Values at other times, interpolated linearly, and before the first or after the last one extrapolated."""
    right = np.clip(np.searchsorted(times, wanted - _SAME_TIME), 1, len(times) - 1)
    share = (wanted - times[right - 1]) / (times[right] - times[right - 1])
    share = share.reshape(1, -1, *(1,) * (values.ndim - 2))
    return values[:, right - 1] * (1.0 - share) + values[:, right] * share
