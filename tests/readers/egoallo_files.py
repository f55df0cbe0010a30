"""Small EgoAllo outputs for tests: a standing body above a straight walk of the glasses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from prbench.readers.egoallo.format import EgoAlloOutput
from prbench.readers.egoallo.synthetic import write_outputs, write_smplh_model
from prbench.recording import PoseStream

START_NS = 150_000_000_000
STEP_NS = 33_000_000


def times_ns(first: int, last: int) -> np.ndarray:
    """Device times of some output frames."""
    return START_NS + np.arange(first, last) * STEP_NS


def head_at(time_ns: np.ndarray) -> np.ndarray:
    """Where the glasses are: 1 m/s along x, 1.6 m up (Z)."""
    seconds = (time_ns - START_NS) / 1e9
    return np.column_stack([seconds, np.zeros_like(seconds), np.full_like(seconds, 1.6)])


def walk(seconds: float = 20.0) -> PoseStream:
    """The recording's glasses."""
    times = START_NS / 1e9 + np.arange(int(seconds * 100)) / 100
    rotation = np.tile([1.0, 0, 0, 0], (len(times), 1))
    return PoseStream(times, head_at(np.rint(times * 1e9).astype(np.int64)), rotation, np.ones(len(times), dtype=bool))


def output(first: int = 0, last: int = 12, *, samples: int = 1, root_height: float = 0.9) -> EgoAlloOutput:
    """One window; the root stands below the head at the given height."""
    time_ns, n = times_ns(first, last), last - first
    head = head_at(time_ns)
    identity = np.array([1.0, 0, 0, 0])
    root = np.zeros((samples, n, 7))
    root[..., 0], root[..., 4:] = 1.0, head * (1, 1, 0) + (0, 0, root_height)
    return EgoAlloOutput(
        name=f"20240101-120000_{first}-{last}.npz",
        time_ns=time_ns,
        world_from_cpf=np.hstack([np.tile(identity, (n, 1)), head]).astype(np.float32),
        world_from_root=root.astype(np.float32),
        body_quats=np.tile(identity, (samples, n, 21, 1)).astype(np.float32),
        betas=np.zeros((samples, n, 16), dtype=np.float32),
    )


def write(folder: Path, *outputs: EgoAlloOutput) -> Path:
    """Write windows; the first one's path."""
    write_outputs(outputs, folder)
    return folder / outputs[0].name


def rewrite(path: Path, **changed: Any) -> None:
    """Replace (or, with None, remove) arrays of an output file."""
    with np.load(path) as archive:
        arrays = dict(archive)
    arrays.update({key: value for key, value in changed.items() if value is not None})
    np.savez(path, **{key: value for key, value in arrays.items() if key not in changed or changed[key] is not None})


def model(folder: Path) -> Path:
    """The invented body model as a file."""
    path = folder / "smplh" / "neutral" / "model.npz"
    write_smplh_model(path)
    return path
