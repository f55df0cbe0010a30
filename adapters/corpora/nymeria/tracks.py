"""Nymeria as tracks of three points: poses of head and wrists beside the body; ``prbench build-tracks nymeria``.

Source: docs/specification/three-points.md#from-the-suit-to-tracks.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from prbench.alignment.align import Alignment, align
from prbench.curation.job import RecordingJob
from prbench.engine import Engine
from prbench.errors import UsageError
from prbench.files.bounded import foreign_input, require
from prbench.files.storage import file_digest, require_replaceable, sole_writer, text_digest
from prbench.geometry import skeleton
from prbench.geometry.skeleton import PARENTS, XSENS_SEGMENTS, Joint, rotation_matrices, y_up
from prbench.geometry.timelines import covered
from prbench.protocol.manifests import Manifest, digest_of, load_manifest
from prbench.readers import SYNTHETIC_PREFIX, RecordingFiles
from prbench.readers.aria_mps.files import read_near
from prbench.readers.aria_mps.format import LEAST_QUALITY
from prbench.recording import NO_POSES, PoseStream
from prbench.sequences import parts
from prbench.sequences.sequence import Recording as RecordingRow
from prbench.sequences.sequence import row_batch
from prbench_adapters.corpora.nymeria.devices import trajectories
from prbench_adapters.corpora.nymeria.files import SUIT
from prbench_adapters.corpora.nymeria.format import DEVICE_FOLDERS, SUIT_FILE, SUIT_RATE, Suit
from prbench_adapters.corpora.nymeria.source import CORPUS, NymeriaSource
from prbench_adapters.corpora.nymeria.suit import clean_suit, read_suit, segment_rotation, stretches
from prbench_adapters.corpora.nymeria.synthetic import calibration_rotations
from prbench_adapters.corpora.sources import CorpusOptions, chosen_recordings
from prbench_benchmarks.three_points import table
from prbench_benchmarks.three_points.batch import DEVICES
from prbench_benchmarks.three_points.protocol import load_three_points_protocol

_Y_UP = skeleton.Y_UP_FROM_Z_UP[:3, :3]
_OFFSETS_FROM = 2000  # frames at most, evenly over a recording, behind the median of the offsets
_PARENTS = list(PARENTS[1:])
DeviceKind = Literal["real", "synthetic"]


def segment_from_joint(suit: Suit, *, synthetic: bool) -> Float[np.ndarray, "23 3 3"]:
    """Turn of each joint frame in its segment: in the T-pose all joint frames are level and face forward.

    Args:
        suit: The recording; one without rotations in its T-pose has all segments turned alike there.
        synthetic: The suit is that of synthetic people, whose limbs have frames of their own.
    """
    at_rest = np.tile(np.eye(3), (len(XSENS_SEGMENTS), 1, 1))
    if synthetic:
        at_rest = calibration_rotations()
    elif suit.tpose_rotation is not None:
        at_rest = Rotation.from_quat(suit.tpose_rotation, scalar_first=True).as_matrix()
    forward = _Y_UP @ at_rest[0, :, 0]  # the Pelvis segment's x axis
    facing = Rotation.from_euler("y", np.arctan2(forward[0], forward[2])).as_matrix()
    return at_rest.transpose(0, 2, 1) @ _Y_UP.T @ facing


def joint_rotations(
    suit: Suit, frames: Int[np.ndarray, " n"], from_joint: Float[np.ndarray, "23 3 3"], manifest: Manifest
) -> Float[np.ndarray, "n 22 3 3"]:
    """Return joint frame to world of some frames of a suit, Y up.

    The root turns with the Pelvis segment, although its place is that of L5: both legs hang on the pelvis, and one
    vertebra on L5. Forward kinematics so misses what L5 bends against the pelvis.
    """
    turned = np.empty((len(frames), len(PARENTS), 3, 3))
    for joint, name in enumerate(("Pelvis", *manifest.body.joint_mapping[1:])):
        segment = XSENS_SEGMENTS.index(name)
        quaternions = segment_rotation(suit, segment, manifest)[frames]
        turned[:, joint] = _Y_UP @ rotation_matrices(quaternions) @ from_joint[segment]
    return turned


def cut(joined: Bool[np.ndarray, " n_but_one"], shortest: float, longest: float) -> Iterator[tuple[int, int]]:
    """Yield first frame and end of each track; a stretch that is too long gives equal ones."""
    for first, stop in stretches(joined, shortest):
        borders = np.linspace(first, stop, int(-(-(stop - first) // longest)) + 1).astype(int)
        yield from itertools.pairwise(borders.tolist())


def measured(
    found: RecordingFiles,
    times: Float[np.ndarray, " n"],
    joints: Float[np.ndarray, "n 22 3"],
    turned: Float[np.ndarray, "n 22 3 3"],
    messages: list[str],
) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Move devices to the joints that carry them, and the body into their world, where its head is the glasses'.

    Args:
        found: Files of the recording.
        times: Seconds on the suit's clock.
        joints: Positions in the suit's world, metres, Y up.
        turned: Joint frame to the suit's world.
        messages: Takes up why a wristband is not used.

    Returns:
        Joints and rotations in the devices' world; positions, rotations and validity of the three devices.

    Raises:
        InputFileError: if the glasses cannot be aligned with the suit.
    """
    position = np.zeros((len(times), len(DEVICES), 3))
    rotation = np.tile(np.eye(3), (len(times), len(DEVICES), 1, 1))
    valid = np.zeros((len(times), len(DEVICES)), dtype=bool)
    paths = trajectories(found)
    for place, (joint, name) in enumerate(zip(DEVICES, DEVICE_FOLDERS, strict=True)):
        carrier = PoseStream(times, joints[:, joint], _quaternions(turned[:, [joint]])[:, 0], np.ones(len(times), bool))
        alignment = Alignment(refused="no trajectory")
        device = NO_POSES
        if name in paths:
            poses = read_near(paths[name], np.zeros(0, dtype=np.int64), SUIT_RATE)
            turn = Rotation.from_matrix(_Y_UP) * Rotation.from_quat(poses.rotation, scalar_first=True)
            tracked = (turn.as_quat(scalar_first=True), poses.quality >= LEAST_QUALITY)
            device = PoseStream(poses.time_us / 1e6, y_up(poses.position), *tracked)
            alignment = align(device, carrier)
        if joint is Joint.HEAD:
            expected = "glasses that can be aligned with the suit"
            remedy = "Without them, devices are synthetic alone: --devices synthetic."
            require(found.recording_id, (not alignment.refused, name, expected, alignment.refused, remedy))
        messages += [f"{name}: {said}" for said in (alignment.refused, *alignment.findings) if said]
        if alignment.clock is not None and not alignment.refused:
            at = alignment.clock.to_device(times)
            gap = load_three_points_protocol().tracks.largest_gap
            valid[:, place] = covered(device.times, device.valid, at, max_gap=gap)
            position[:, place], quaternions = alignment.segment_in_world(device).pose_at(at)
            rotation[:, place] = rotation_matrices(quaternions)
    # The body goes where its head is the glasses'.
    moved = rotation[:, 0] @ turned[:, Joint.HEAD].transpose(0, 2, 1)
    joints = np.einsum("nij,nkj->nki", moved, joints - joints[:, [Joint.HEAD]]) + position[:, [0]]
    return joints, moved[:, None] @ turned, (position, rotation, valid)


@dataclass(frozen=True)
class TracksJob(RecordingJob):
    """Reads and cuts one recording."""

    devices: DeviceKind
    fps: float

    def settings(self, source: NymeriaSource) -> str:
        """See :class:`RecordingJob`."""
        digests = (load_three_points_protocol().digest, digest_of(load_manifest("nymeria")))
        # Also those that the corpus does not read.
        read = map(file_digest, trajectories(source.found).values() if self.devices == "real" else ())
        return text_digest(*digests, self.devices, str(self.fps), *map(str, vars(source.identity).values()), *read)

    def nothing(self, source: Any, record: RecordingRow) -> dict[str, pa.RecordBatch]:  # noqa: ARG002
        """See :class:`RecordingJob`."""
        return {"tracks": row_batch((), table.TRACKS)}

    @foreign_input()
    def make(self, source: NymeriaSource) -> tuple[RecordingRow, dict[str, pa.RecordBatch]]:
        """See :class:`RecordingJob`."""
        manifest = load_manifest("nymeria")
        path = source.found.require(SUIT, f"body/{SUIT_FILE}")
        suit = read_suit(path)
        clean = clean_suit(suit, manifest, path=path)
        identity = source.identity
        stride = round(SUIT_RATE / self.fps)
        # Pieces of steady time, each with its own places in the file.
        places = [np.arange(piece.first, piece.stop, stride) for piece in clean.pieces]
        frames = np.concatenate(places)
        since = zip(clean.pieces, places, strict=True)
        times = np.concatenate([piece.start + (place - piece.first) / SUIT_RATE for piece, place in since])
        joints = np.concatenate([piece.joints[::stride] for piece in clean.pieces]).astype(np.float64)
        from_joint = segment_from_joint(suit, synthetic=identity.dataset.startswith(SYNTHETIC_PREFIX))
        turned = joint_rotations(suit, frames, from_joint, manifest)
        del suit
        some = slice(None, None, max(1, len(joints) // _OFFSETS_FROM))
        # Each joint's offset from its parent in the parent's frame, metres: the median over the frames.
        offsets = np.zeros((len(PARENTS), 3))
        bones = joints[some, 1:] - joints[some, _PARENTS]
        offsets[1:] = np.median(np.einsum("njki,njk->nji", turned[some, _PARENTS], bones), axis=0)
        messages = list(clean.messages)
        if self.devices == "real":
            joints, turned, given = measured(source.found, times, joints, turned, messages)
        else:
            devices = list(DEVICES)
            given = (joints[:, devices], turned[:, devices], np.ones((len(times), len(devices)), dtype=bool))
        known = given[2][:, 0]
        joined = np.isclose(np.diff(times), 1.0 / self.fps, atol=1e-4) & known[1:] & known[:-1]
        local = turned.copy()
        local[:, 1:] = turned[:, _PARENTS].transpose(0, 1, 3, 2) @ turned[:, 1:]
        rules = load_three_points_protocol().tracks
        tracks = []
        for first, stop in cut(joined, rules.shortest * self.fps, rules.longest * self.fps):
            part = slice(first, stop)
            kinematic, _ = skeleton.forward_kinematics(offsets, joints[part, 0], local[part], PARENTS)
            apart = np.linalg.norm(kinematic - joints[part], axis=-1)
            n = stop - first
            position, rotation, valid = (each[part] for each in given)
            track = table.Track(
                sequence_id=f"{identity.dataset}/{identity.recording_id}/{self.devices}/{frames[first]:08d}",
                recording_id=identity.recording_id,
                participant_id=identity.participant_id,
                split=identity.split,
                devices=self.devices,
                fps=self.fps,
                start_time=float(times[first]),
                n_frames=n,
                device_position=position.reshape(n, -1),
                device_rotation=_quaternions(rotation).reshape(n, -1),
                device_valid=valid,
                rotation_valid=valid,
                joints=joints[part].reshape(n, -1),
                rotations=_quaternions(local[part]).reshape(n, -1),
                offsets=offsets.ravel(),
                kinematic_deviation=round(float(np.percentile(apart, 95)), 6),
            )
            tracks.append(track)
        counts = {"tracks": len(tracks), "frames": sum(track.n_frames for track in tracks)}
        whose = (identity.recording_id, identity.participant_id, identity.split, identity.split_group)
        record = RecordingRow(*whose, len(times) / self.fps, counts, "read", "; ".join(messages))
        return record, {"tracks": row_batch(tracks, table.TRACKS)}


def _quaternions(matrices: Float[np.ndarray, "n joints 3 3"]) -> Float[np.ndarray, "n joints 4"]:
    flat = Rotation.from_matrix(matrices.reshape(-1, 3, 3)).as_quat(canonical=True, scalar_first=True)
    return flat.reshape(*matrices.shape[:2], 4)


def build_tracks(
    root: Path,
    out: Path,
    *,
    devices: DeviceKind,
    fps: float,
    recordings: str,
    limit: int | None,
    stop_on_error: bool,
    engine: Engine,
    progress: Any,
) -> table.TracksInfo:
    """Build a table of tracks; an interrupted build goes on.

    Args:
        root: The dataset's folder.
        out: Folder of the table; an earlier one there is replaced when everything is ready.
        devices: ``real`` for the measured poses, ``synthetic`` for the suit's own head and hands.
        fps: Frame rate, in frames per second.
        recordings: Glob of recordings.
        limit: Largest number of recordings.
        stop_on_error: Stop at the first recording that cannot be read, rather than leave it out.
        engine: Runs the work, in this process or in several.
        progress: Called after each recording with how many are done, of how many, and its id.

    Raises:
        UsageError: for another frame rate.
        InputFileError: if there is nothing to read.
        StorageError: if ``out`` cannot be written or holds something else.
    """
    rates = load_three_points_protocol().tracks.rates
    if fps not in rates:
        raise UsageError(f"--fps: expected {' or '.join(f'{rate:g}' for rate in rates)}, found {fps:g}.")
    out = out.expanduser().absolute()
    require_replaceable(out, table.FILE_NAME, kind="table of tracks")
    wanted = CorpusOptions(recordings=recordings, limit=limit)
    # Sequences that are known for bad texts have sound bodies: nothing is left out.
    found = chosen_recordings(CORPUS.find(root, wanted), wanted, where=root)
    sources = sorted((replace(each, skip_reason=None) for each in found), key=lambda each: f"{each.recording_id}/")
    with sole_writer(out), parts.working_in_parts(out):
        job = TracksJob(stop_on_error, parts.work_folder(out), devices, fps)
        finished = job.make_all(sources, engine, progress)
        options = {"recordings": recordings, "limit": str(limit or "all")}
        dataset = sources[0].identity.dataset
        return table.write_tracks(out, finished, dataset, options=options, fps=fps, devices=devices)
