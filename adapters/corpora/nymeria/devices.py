"""Nymeria's devices and the suit's segments that carry them, as ``prbench align`` and the gaze of windows need them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from prbench.alignment.report import Tracks
from prbench.files.bounded import foreign_input, require
from prbench.geometry.skeleton import XSENS_SEGMENTS
from prbench.protocol.manifests import load_manifest
from prbench.readers import RecordingFiles
from prbench.readers.aria_mps import format as mps
from prbench.readers.aria_mps.files import read_near
from prbench.recording import SIDES, PoseStream
from prbench_adapters.corpora.nymeria.clock import offset_from_file
from prbench_adapters.corpora.nymeria.files import OFFSET, SUIT, TRAJECTORY, find_sequences
from prbench_adapters.corpora.nymeria.format import DEVICE_FOLDERS, HEAD_FOLDER, N_SEGMENTS, SUIT_FILE, SUIT_RATE
from prbench_adapters.corpora.nymeria.suit import open_suit

_SEGMENTS = ("Head", "L_Hand", "R_Hand")
_EVERY = 2  # frames; 120 Hz suffice for motions of 0.1 s
_BLOCK = 2400  # frames that are in memory at once
_BESIDE_JUMP = 15  # frames on either side of a jump of the clock that are invalid, so that nothing bridges it


def segment_streams(path: Path) -> dict[str, PoseStream]:
    """Read the segments that carry devices from ``xdata.npz`` in blocks: suit's world and clock, 120 Hz.

    Raises:
        InputFileError: if the file does not hold what its format promises.
    """
    archive, time_us = open_suit(path)
    rows = [XSENS_SEGMENTS.index(name) for name in _SEGMENTS]
    position, rotation = (
        np.concatenate(
            [block.reshape(len(block), N_SEGMENTS, -1)[::_EVERY, rows] for block in archive.blocks(key, _BLOCK)]
        ).astype(np.float64)
        for key in ("segment_tXYZ", "segment_qWXYZ")
    )
    thresholds = load_manifest("nymeria").thresholds
    # Within a piece without jumps of the clock the suit runs at 240 Hz; a time that runs backwards is left out.
    jumps = np.flatnonzero(np.abs(np.diff(time_us) * 1e-6 - 1 / SUIT_RATE) > thresholds["clock_tolerance"]) + 1
    first = np.concatenate([[0], jumps])
    frames = np.arange(0, len(time_us), _EVERY)
    began = first[np.searchsorted(first, frames, side="right") - 1]
    times = time_us[began] * 1e-6 + (frames - began) / SUIT_RATE
    forward = times > np.maximum.accumulate(np.concatenate([[-np.inf], times[:-1]]))
    near = np.searchsorted(jumps, frames - _BESIDE_JUMP) != np.searchsorted(jumps, frames + _BESIDE_JUMP)
    streams = {}
    for index, name in enumerate(_SEGMENTS):
        where, turned = position[forward, index], rotation[forward, index]
        length = np.linalg.norm(turned, axis=1)
        valid = np.isfinite(where).all(axis=1) & (length >= thresholds["smallest_quaternion"]) & ~near[forward]
        require(path, (valid.any(), name, "poses of the segment", "none", "Download the file again."))
        turned = np.where(valid[:, None], turned / np.maximum(length, 1e-9)[:, None], [1.0, 0.0, 0.0, 0.0])
        streams[name] = PoseStream(times[forward], np.where(valid[:, None], where, 0.0), turned, valid)
    return streams


def device_stream(path: Path) -> PoseStream:
    """Read a device's poses, thinned to about 100 Hz: the world of its trajectory, its own clock.

    Raises:
        InputFileError: if the file does not hold what its format promises.
    """
    poses = read_near(path, np.zeros(0, dtype=np.int64), load_manifest("nymeria").thresholds["correlation_rate"])
    pa.default_memory_pool().release_unused()  # half a gigabyte after an hour of poses
    valid = poses.quality >= mps.LEAST_QUALITY
    rotation = poses.rotation / np.linalg.norm(poses.rotation, axis=1, keepdims=True)
    return PoseStream(poses.time_us / 1e6, poses.position, rotation, valid)


def trajectories(found: RecordingFiles) -> dict[str, Path]:
    """Return the poses of glasses and wristbands by their folder, as far as they are there; none without glasses."""
    head = found.path(TRAJECTORY)
    parts_of = () if head is None else head.parts
    paths = {name: Path(*(name if part == HEAD_FOLDER else part for part in parts_of)) for name in DEVICE_FOLDERS}
    return {name: path for name, path in paths.items() if path.is_file()}


@dataclass(frozen=True)
class NymeriaTracks:
    """One sequence (see :class:`prbench.alignment.report.TrackSource`)."""

    found: RecordingFiles

    @foreign_input()
    def read(self) -> Tracks:
        """Read glasses, wristbands and suit.

        Raises:
            InputFileError: if suit or glasses are missing or damaged.
        """
        glasses = device_stream(self.found.require(TRAJECTORY, "recording_head/mps/slam/closed_loop_trajectory.csv"))
        segments = segment_streams(self.found.require(SUIT, f"body/{SUIT_FILE}"))
        paths = trajectories(self.found)
        own = self.found.path(OFFSET)
        offset = None if own is None else offset_from_file(own, self.found.recording_id)
        hands = zip(SIDES, DEVICE_FOLDERS[1:], (segments["L_Hand"], segments["R_Hand"]), strict=True)
        there = [(side, paths[folder], hand) for side, folder, hand in hands if folder in paths]
        wrists = ((side, device_stream(path), hand) for side, path, hand in there)
        missing = sorted(set(SIDES) - {side for side, _, _ in there})
        messages = tuple(f"no trajectory of the {side} wristband" for side in missing)
        known = None if offset is None else offset.seconds
        return Tracks("glasses and the suit's head", glasses, segments["Head"], known, wrists, messages=messages)


def track_sources(root: Path) -> Sequence[NymeriaTracks]:
    """Find the sequences below a folder; what one of them lacks is said when it is read."""
    return [NymeriaTracks(found) for found in find_sequences(root)]
