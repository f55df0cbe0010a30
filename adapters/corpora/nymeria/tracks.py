"""Nymeria as tracks of three points: poses of head and wrists beside the body; ``prbench build-tracks nymeria``.

Source: docs/specification/three-points.md#from-the-suit-to-tracks.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from prbench.curation.job import RecordingJob
from prbench.engine import Engine
from prbench.errors import UsageError
from prbench.files.bounded import foreign_input
from prbench.files.storage import require_replaceable, sole_writer, text_digest
from prbench.geometry.skeleton import PARENTS, XSENS_SEGMENTS, Y_UP_FROM_Z_UP, forward_kinematics, rotation_matrices
from prbench.protocol.manifests import Manifest, digest_of, load_manifest
from prbench.readers import SYNTHETIC_PREFIX
from prbench.sequences import parts
from prbench.sequences.sequence import Recording as RecordingRow
from prbench.sequences.sequence import row_batch
from prbench_adapters.corpora.nymeria.files import SUIT
from prbench_adapters.corpora.nymeria.format import SUIT_FILE, SUIT_RATE, Suit
from prbench_adapters.corpora.nymeria.source import CORPUS, NymeriaSource
from prbench_adapters.corpora.nymeria.suit import clean_suit, read_suit, segment_rotation
from prbench_adapters.corpora.nymeria.synthetic import calibration_rotations
from prbench_adapters.corpora.sources import CorpusOptions, chosen_recordings
from prbench_benchmarks.three_points import table
from prbench_benchmarks.three_points.batch import DEVICES
from prbench_benchmarks.three_points.protocol import load_three_points_protocol

_Y_UP = Y_UP_FROM_Z_UP[:3, :3]
_OFFSETS_FROM = 2000  # frames at most, evenly over a recording, behind the median of the offsets
DeviceKind = Literal["real", "synthetic"]
Frames = Int[np.ndarray, " n"]


@dataclass(frozen=True)
class Posed:
    """A stretch of the suit at the tracks' rate. World, Y up, metres.

    Attributes:
        times: Seconds on the suit's clock.
        first: Number of the first frame in the suit's file.
        rotations: Joint frame to world; the identity in the T-pose that faces +Z.
    """

    times: Float[np.ndarray, " n"]
    first: int
    joints: Float[np.ndarray, "n 22 3"]
    rotations: Float[np.ndarray, "n 22 3 3"]


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
    suit: Suit, frames: Frames, from_joint: Float[np.ndarray, "23 3 3"], manifest: Manifest
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


def offsets_of(joints: Float[np.ndarray, "n 22 3"], rotations: Float[np.ndarray, "n 22 3 3"]) -> np.ndarray:
    """Return each joint's offset (22, 3) from its parent in the parent's frame, metres: the median over the frames."""
    offsets = np.zeros((len(PARENTS), 3))
    parents = np.array(PARENTS[1:])
    bones = joints[:, 1:] - joints[:, parents]
    offsets[1:] = np.median(np.einsum("njki,njk->nji", rotations[:, parents], bones), axis=0)
    return offsets


@dataclass(frozen=True)
class TrackSource:
    """One sequence of which tracks can be made; picklable, so that other processes can do it.

    Attributes:
        skip_reason: Sequences that are known for bad texts have sound bodies: nothing is left out.
    """

    source: NymeriaSource
    devices: DeviceKind
    fps: float
    skip_reason: None = None
    split: None = None

    @property
    def recording_id(self) -> str:
        """Return its name, which is unique within a build."""
        return self.source.identity.recording_id

    @foreign_input()
    def input_digest(self) -> str:
        """Digest of its files."""
        return self.source.input_digest()

    def without_places(self, message: str) -> str:
        """Return a message without the folders of this machine."""
        return self.source.without_places(message)

    @foreign_input()
    def read(self) -> tuple[RecordingRow, tuple[table.Track, ...]]:
        """Read suit and devices, and cut them into tracks.

        Raises:
            InputFileError: if a file does not hold what its format promises.
        """
        manifest = load_manifest("nymeria")
        path = self.source.found.require(SUIT, f"body/{SUIT_FILE}")
        suit = read_suit(path)
        clean = clean_suit(suit, manifest, path=path)
        identity = self.source.identity
        from_joint = segment_from_joint(suit, synthetic=identity.dataset.startswith(SYNTHETIC_PREFIX))
        stride = round(SUIT_RATE / self.fps)
        stretches = []
        for piece in clean.pieces:
            frames = np.arange(piece.first, piece.stop, stride)
            times = piece.start + np.arange(len(frames)) / self.fps
            turned = joint_rotations(suit, frames, from_joint, manifest)
            stretches.append(Posed(times, piece.first, piece.joints[::stride].astype(np.float64), turned))
        del suit
        joints, turned = (
            np.concatenate([getattr(each, name) for each in stretches]) for name in ("joints", "rotations")
        )
        some = slice(None, None, max(1, len(joints) // _OFFSETS_FROM))
        offsets = offsets_of(joints[some], turned[some])
        tracks = tuple(track for each in stretches for track in self._tracks(each, offsets))
        counts = {"tracks": len(tracks), "frames": sum(track.n_frames for track in tracks)}
        whose = (identity.recording_id, identity.participant_id, identity.split, identity.split_group)
        duration = sum(float(each.times[-1] - each.times[0]) for each in stretches)
        return RecordingRow(*whose, duration, counts, "read", "; ".join(clean.messages)), tracks

    def _tracks(self, posed: Posed, offsets: Float[np.ndarray, "22 3"]) -> Iterator[table.Track]:
        """Cut a stretch into tracks."""
        rules = load_three_points_protocol().tracks
        for first in range(0, len(posed.times), round(rules.longest * self.fps)):
            part = slice(first, first + round(rules.longest * self.fps))
            n = len(posed.times[part])
            if n >= rules.shortest * self.fps:
                everywhere = np.ones((n, len(DEVICES)), dtype=bool)
                yield self._track(posed, part, offsets, everywhere, everywhere)

    def _track(
        self,
        posed: Posed,
        part: slice,
        offsets: Float[np.ndarray, "22 3"],
        valid: Bool[np.ndarray, "n 3"],
        rotation_valid: Bool[np.ndarray, "n 3"],
    ) -> table.Track:
        joints = posed.joints[part]
        turned = posed.rotations[part]
        local = turned.copy()
        parents = np.array(PARENTS[1:])
        local[:, 1:] = turned[:, parents].transpose(0, 1, 3, 2) @ turned[:, 1:]
        kinematic, _ = forward_kinematics(offsets, joints[:, 0], local, PARENTS)
        deviation = float(np.percentile(np.linalg.norm(kinematic - joints, axis=-1), 95))
        identity = self.source.identity
        start = posed.first + part.start * round(SUIT_RATE / self.fps)
        devices = list(DEVICES)
        n = len(joints)
        return table.Track(
            sequence_id=f"{identity.dataset}/{identity.recording_id}/{self.devices}/{start:08d}",
            recording_id=identity.recording_id,
            participant_id=identity.participant_id,
            split=identity.split,
            devices=self.devices,
            fps=self.fps,
            start_time=float(posed.times[part.start]),
            n_frames=n,
            device_position=joints[:, devices].reshape(n, -1),
            device_rotation=_quaternions(turned[:, devices]).reshape(n, -1),
            device_valid=valid,
            rotation_valid=rotation_valid,
            joints=joints.reshape(n, -1),
            rotations=_quaternions(local).reshape(n, -1),
            offsets=offsets.ravel(),
            kinematic_deviation=round(deviation, 6),
        )


def _quaternions(matrices: Float[np.ndarray, "n joints 3 3"]) -> Float[np.ndarray, "n joints 4"]:
    flat = Rotation.from_matrix(matrices.reshape(-1, 3, 3)).as_quat(canonical=True, scalar_first=True)
    return flat.reshape(*matrices.shape[:2], 4)


@dataclass(frozen=True)
class TracksJob(RecordingJob):
    """Reads and cuts one recording."""

    def settings(self, source: TrackSource) -> str:
        """See :class:`RecordingJob`."""
        digests = (load_three_points_protocol().digest, digest_of(load_manifest("nymeria")))
        return text_digest(*digests, source.devices, str(source.fps), *map(str, vars(source.source.identity).values()))

    def make(self, source: TrackSource) -> tuple[RecordingRow, dict[str, pa.RecordBatch]]:
        """See :class:`RecordingJob`."""
        record, tracks = source.read()
        return record, {"tracks": row_batch(tracks, table.TRACKS)}

    def nothing(self, source: Any, record: RecordingRow) -> dict[str, pa.RecordBatch]:  # noqa: ARG002
        """See :class:`RecordingJob`."""
        return {"tracks": row_batch((), table.TRACKS)}


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
    found: Any = chosen_recordings(CORPUS.find(root, wanted), wanted, where=root)
    sources = [
        TrackSource(each, devices, fps) for each in sorted(found, key=lambda each: f"{each.identity.recording_id}/")
    ]
    with sole_writer(out), parts.working_in_parts(out):
        finished = TracksJob(stop_on_error, parts.work_folder(out)).make_all(sources, engine, progress)
        suffix = "-suit" if devices == "synthetic" else ""
        options = {"recordings": recordings, "limit": str(limit or "all")}
        settings = {"dataset": sources[0].source.identity.dataset + suffix, "options": options, "fps": fps}
        return table.write_tracks(out, finished, load_manifest("nymeria"), settings | {"devices": devices})
