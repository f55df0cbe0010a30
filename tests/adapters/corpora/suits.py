"""Small suit recordings made by hand, and synthetic trees of both datasets that are made once a run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from prbench.geometry.skeleton import XSENS_SEGMENTS
from prbench.protocol.manifests import load_manifest
from prbench_adapters.corpora.nymeria.format import Suit
from prbench_adapters.corpora.synthetic import synthesize_corpus_tree
from tests.fakes import STANDING
from tests.shared import made_once

THRESHOLDS = load_manifest("nymeria").thresholds
START_US = 5_000_000
SEED = 5


def corpus_tree(layout: str) -> Path:
    """Three sequences of Nymeria, the last one without trajectory, or two recordings of HumanML3D."""
    count = 3 if layout == "nymeria" else 2
    return made_once(f"corpus-{layout}", lambda path: synthesize_corpus_tree(layout, path, recordings=count, seed=SEED))


def walking_suit(n: int = 1200, *, speed: float = 0.8) -> Suit:
    """A standing body that glides along +X of the suit's world at a constant speed, facing where it goes."""
    mapping = load_manifest("nymeria").body.joint_mapping
    body = np.zeros((len(XSENS_SEGMENTS), 3))
    for joint, segment in enumerate(mapping):
        body[XSENS_SEGMENTS.index(segment)] = STANDING[joint]
    body[0] = STANDING[[1, 2]].mean(axis=0)
    native = np.stack([body[:, 2], body[:, 0], body[:, 1]], axis=-1)  # forward, left, up
    ticks = np.arange(n)
    position = np.repeat(native[None], n, axis=0)
    position[..., 0] += (speed * ticks / 240.0)[:, None]
    rotation = np.tile([1.0, 0.0, 0.0, 0.0], (n, len(XSENS_SEGMENTS), 1))
    return Suit(START_US + np.rint(ticks * 1e6 / 240).astype(np.int64), position, rotation, native)


def write_arrays(path: Path, suit: Suit, **changed: np.ndarray | None) -> Path:
    """Write a suit as ``xdata.npz``; ``None`` leaves an array out."""
    n = len(suit.time_us)
    arrays: dict[str, np.ndarray | None] = {
        "timestamps_us": suit.time_us,
        "frameRate": np.array([240]),
        "frameCount": np.array([n]),
        "segment_tXYZ": suit.position.reshape(n, -1),
        "segment_qWXYZ": suit.rotation.reshape(n, -1),
        "tpose_segment_tXYZ": None if suit.tpose is None else suit.tpose.ravel(),
    }
    kept: dict[str, Any] = {key: value for key, value in (arrays | changed).items() if value is not None}
    np.savez(path, **kept)
    return path
