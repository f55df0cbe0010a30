"""The trained networks as trackers of :mod:`prbench_benchmarks.three_points`, and on any device tracks."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch
from jaxtyping import Bool, Float

from prbench.geometry.skeleton import Joint
from prbench.geometry.timelines import interpolate, slerp
from prbench.randomness import named_generator
from prbench_adapters.diffusion.generation import require_known, whole_number
from prbench_adapters.diffusion.method import resolve
from prbench_adapters.diffusion.model import torch_device
from prbench_adapters.three_points.features import joints_under_head, track_values
from prbench_adapters.three_points.training import NETWORKS
from prbench_adapters.training.weights import Weights, read_weights
from prbench_benchmarks.three_points.batch import DEVICES, Bodies, Condition, TrackedBatch

_PIECE = 3600  # frames that are worked on together, so that memory does not grow with a recording


class LearnedTracker:
    """Bodies by a trained network.

    Args:
        name: What tables call it.
        file: The weights that the network came from.
        network: The network, in evaluation mode.
    """

    conditions = frozenset(Condition)

    def __init__(self, name: str, file: Weights, network: Any) -> None:
        self.name, self.weights, self.network = name, file.path, network
        self.provenance = {"weights_sha256": file.digest, "licence": file.metadata.get("licence", "unknown")}
        self.device = next(network.parameters()).device

    def track(self, batch: TrackedBatch, *, seed: int) -> Bodies:
        """See :class:`prbench_benchmarks.three_points.batch.Tracker`."""
        joints = np.full((*batch.position.shape[:2], len(Joint), 3), np.nan)
        for row, key in enumerate(batch.key):
            part = slice(0, batch.n_frames[row])
            devices = (each[row, part] for each in (batch.position, batch.rotation, batch.valid, batch.rotation_valid))
            own = int(named_generator("three-points", seed, key).integers(2**63 - 1))
            times = np.arange(batch.n_frames[row]) / batch.fps
            joints[row, part] = self.estimate(times, *devices, offsets=batch.offsets[row], seed=own)
        return Bodies(joints=joints)

    @torch.no_grad()
    def estimate(
        self,
        times: Float[np.ndarray, " n"],
        position: Float[np.ndarray, "n 3 3"],
        rotation: Float[np.ndarray, "n 3 4"],
        valid: Bool[np.ndarray, "n 3"],
        rotation_valid: Bool[np.ndarray, "n 3"],
        offsets: Float[np.ndarray, "22 3"],
        *,
        seed: int = 0,
    ) -> Float[np.ndarray, "n 22 3"]:
        """Return a body at each time, world, metres; NaN where the head is not known.

        Times at another rate than the network's are brought to that, and bodies back. Where the head is not known, a
        track ends, and another one begins behind.

        Args:
            times: Seconds, at equal steps.
            position: Head, left wrist and right wrist, joint frames; world, Y up, floor at height 0, metres. Any point
                where not valid.
            rotation: World from joint frame, w x y z; any rotation where not valid.
            valid: Devices whose position is known.
            rotation_valid: Devices whose rotation is known, where their position is.
            offsets: Each joint's offset from its parent in the T-pose, metres.
            seed: Seed of networks that draw something.
        """
        shape = self.network.configuration
        query = times[0] + np.arange(round((times[-1] - times[0]) * shape.fps) + 1) / shape.fps
        devices = [position, rotation, valid, valid & rotation_valid]
        if len(query) != len(times):
            turned = [slerp(times, rotation[:, device], query) for device in range(len(DEVICES))]
            # Known on both sides of the moment.
            masks = [interpolate(times, mask.astype(np.float64), query) > 1.0 - 1e-6 for mask in devices[2:]]
            devices = [interpolate(times, position, query), np.stack(turned, axis=1), *masks]
        known = np.flatnonzero(devices[3][:, 0])
        found = np.full((len(query), len(Joint), 3), np.nan)
        bones = torch.from_numpy(offsets.astype(np.float32))
        for run in np.split(known, np.flatnonzero(np.diff(known) > 1) + 1):
            for first in range(0, len(run), _PIECE):
                # A window reaches back into the piece before.
                piece = run[max(first - shape.window, 0) : first + _PIECE]
                rows = track_values(*(each[piece] for each in devices), fps=shape.fps).to(self.device)
                local = self.network.rotations(rows, seed).cpu()
                bodies = joints_under_head(local, bones, torch.from_numpy(devices[0][piece, 0].astype(np.float64)))
                found[run[first : first + _PIECE]] = bodies[-len(run[first : first + _PIECE]) :].numpy()
        if len(query) == len(times):
            return found
        joints = np.full((len(times), len(Joint), 3), np.nan)
        given = valid[:, 0] & rotation_valid[:, 0]
        if known.size:
            joints[given] = interpolate(query[known], found[known], times[given])
        return joints


def load_tracker(name: str, weights: Path | None, *, options: Mapping[str, str], device: str) -> LearnedTracker:
    """Load the network of a method.

    Args:
        name: The method's name.
        weights: File, folder or name of bundled weights; None for those that come with prbench.
        options: ``steps`` of sampling, for bodiffusion.
        device: ``cpu``, ``cuda`` …

    Raises:
        AdapterError: if there is no such device, or no such weights.
        InputFileError: if the file holds no weights of this method.
        ValueError: for options that are unknown or have impossible values.
    """
    require_known(options, ("steps",) if name == "bodiffusion" else ())
    where = torch_device(device)
    path = resolve(weights, f"{name}-small", folder=Path(__file__).parent / "weights")
    file = read_weights(path, kind=name)
    sizes, network_of = NETWORKS[name]
    shape = file.configuration(sizes)
    if "steps" in options:
        steps = whole_number(options, "steps", most=shape.diffusion_steps)
        shape = msgspec.structs.replace(shape, sampling_steps=steps)
    network = network_of(shape)
    file.load_into(network, "network")
    return LearnedTracker(name, file, network.eval().requires_grad_(False).to(where))
