"""One sequence of Nymeria as a recording: body and gaze in the world of the suit; ``prbench build-windows nymeria``.

Suit and glasses have worlds of their own, and the suit's drifts. What stays is how the glasses sit on the head: one
rotation, found from how both turn. Gaze then goes from the glasses to the head segment, and with it into the suit's
world (docs/specification/nymeria.md#head-trajectory-and-gaze).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, cast

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from prbench.alignment.align import align
from prbench.errors import UsageError
from prbench.files.bounded import foreign_input, require
from prbench.files.storage import file_digest, text_digest
from prbench.geometry.skeleton import Joint, y_up
from prbench.protocol.manifests import digest_of, load_manifest
from prbench.readers import described_options
from prbench.readers.aria_mps import format as mps
from prbench.readers.aria_mps.files import find_gaze_file, read_gaze_angles
from prbench.recording import BodyStream, GazeStream, PoseStream, Recording
from prbench.sequences.sequence import Recording as RecordingRow
from prbench_adapters.corpora.nymeria.devices import NymeriaTracks
from prbench_adapters.corpora.nymeria.files import TRAJECTORY
from prbench_adapters.corpora.nymeria.format import SUIT_FILE, SUIT_RATE
from prbench_adapters.corpora.nymeria.source import CORPUS, NymeriaSource
from prbench_adapters.corpora.nymeria.suit import CleanSuit
from prbench_adapters.corpora.sources import CorpusOptions, chosen_recordings
from prbench_benchmarks.motion_prediction.joint_sets import SMPL22
from prbench_benchmarks.motion_prediction.protocol import PredictionProtocol
from prbench_benchmarks.motion_prediction.table import Run
from prbench_benchmarks.motion_prediction.windows import JointChoice, WindowsPlan, row_of, runs_of_recording

_LEAST_OVERLAP = 10.0  # s; gaze needs the rotation alone, which short recordings tell


def gaze_in_suit_world(
    clean: CleanSuit, head_from_glasses: Rotation, times: Float[np.ndarray, " n"], angles: mps.GazeAngles
) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
    """Directions of gaze in the suit's world, Y up.

    The head segment is that of the suit's last frame before each sample, so that nothing later is read.

    Args:
        clean: The suit.
        head_from_glasses: Rotation of the glasses in the head segment at each sample.
        times: Times of the samples, seconds on the suit's clock.
        angles: Angles of the samples, in the central pupil frame.

    Returns:
        Unit vectors, +Z where nothing was measured; and where something was.
    """
    with np.errstate(invalid="ignore"):
        widest = np.maximum(np.abs(angles.yaw), np.abs(angles.pitch)) <= mps.WIDEST_GAZE_ANGLE
    head = np.zeros((len(times), 4))
    there = np.zeros(len(times), dtype=bool)
    for piece in clean.pieces:
        frame = np.floor((times - piece.start) * SUIT_RATE + 1e-6).astype(np.int64)
        inside = (frame >= 0) & (frame < piece.stop - piece.first)
        head[inside] = clean.head_rotation[piece.first + frame[inside]]
        there |= inside
    valid = widest & there
    directions = np.tile([0.0, 0.0, 1.0], (len(times), 1))
    if valid.any():
        in_cpf = mps.gaze_directions_cpf(angles.yaw[valid], angles.pitch[valid])
        # The size of the glasses moves the pupils, and turns nothing.
        in_head = head_from_glasses[valid].apply(in_cpf @ mps.device_from_cpf("DVT-S")[:3, :3].T)
        directions[valid] = y_up(Rotation.from_quat(head[valid], scalar_first=True).apply(in_head))
    return directions, valid


@dataclass(frozen=True)
class NymeriaWindows(NymeriaSource):
    """One sequence without its texts (see :class:`prbench_benchmarks.motion_prediction.windows.NativeWindows`)."""

    joint_set: ClassVar[str] = SMPL22.name

    @property
    def settings(self) -> str:
        """See :class:`prbench_benchmarks.motion_prediction.windows.NativeWindows`."""
        options = described_options(self.options)
        return text_digest(digest_of(load_manifest("nymeria")), self.identity.split, *map(str, options.items()))

    @foreign_input()
    def input_digest(self) -> str:
        """Digest of all files of the sequence, and of the gaze beside its trajectory."""
        gaze = self._gaze_file()
        return text_digest(NymeriaSource.input_digest(self), "" if gaze is None else file_digest(gaze))

    @foreign_input()
    def cut(self, protocol: PredictionProtocol) -> tuple[RecordingRow, Iterator[Run]]:
        """Body on the suit's clock, and gaze where trajectory, gaze file and clock allow it, as runs.

        Raises:
            InputFileError: if a file does not hold what its format promises.
        """
        motion = self.suit()
        # All pieces on one time line; what lies between them is a gap.
        pieces = sorted(motion.pieces, key=lambda piece: piece.start)
        times = np.concatenate([piece.start + np.arange(len(piece.joints)) / SUIT_RATE for piece in pieces])
        expected = "pieces of motion one after the other"
        ordered = not (np.diff(times) <= 0).any()
        require(SUIT_FILE, (ordered, "timestamps_us", expected, "two that overlap in time", "Leave the recording out."))
        joints = np.concatenate([piece.joints for piece in pieces]).astype(np.float64)
        body = BodyStream(times, joints, np.ones(len(times), dtype=bool))
        gaze, message = self._gaze(motion)
        nowhere = PoseStream(body.times[:1], body.joints[:1, Joint.HEAD], np.array([[1.0, 0, 0, 0]]), np.zeros(1, bool))
        identity = self.identity
        whose = (identity.dataset, identity.recording_id, identity.participant_id)
        whole = (float(body.times[0]), float(body.times[-1]))
        streams = (gaze, nowhere, nowhere, body)  # neither camera nor head
        messages = tuple(text for text in (*motion.messages, message) if text)
        about = {"hands": (), "objects": (), "split_group": identity.split_group, "messages": messages}
        recording = Recording(*whose, motion.pose_source, motion.head_tilt_deg, whole, *streams, **about)
        row = row_of(recording, identity.split, identity.split_group)
        return row, runs_of_recording(recording, protocol.windows, split=row.split)

    def _gaze_file(self) -> Path | None:
        trajectory = self.found.path(TRAJECTORY)
        return None if trajectory is None else find_gaze_file(trajectory.parent.parent / mps.GAZE_FOLDER)

    def _gaze(self, clean: CleanSuit) -> tuple[GazeStream, str]:
        """Gaze in the suit's world; without any, why."""
        nothing = GazeStream(np.zeros(1), np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), np.zeros(1, dtype=bool))
        found = self.found
        path = self._gaze_file()
        if path is None:
            return nothing, "no gaze file beside a trajectory of the glasses"
        # The user's own offset, or that at which suit and glasses turn alike; texts are not needed for either.
        tracks = NymeriaTracks(found).read()
        mounted = align(tracks.device, tracks.segment, offset=tracks.offset, least_overlap=_LEAST_OVERLAP)
        if mounted.clock is None or mounted.device_from_segment is None:
            return nothing, f"gaze: {mounted.refused}"
        angles = read_gaze_angles(path)
        device_times = angles.time_us / 1e6
        times = mounted.clock.to_segment(device_times)
        head_from_glasses = Rotation.from_matrix(mounted.x_at(device_times)[:, :3, :3]).inv()
        directions, valid = gaze_in_suit_world(clean, head_from_glasses, times, angles)
        # Nothing of motion prediction needs where gaze comes from.
        return GazeStream(times, np.zeros((len(times), 3)), directions, valid), ""


def plan_windows(
    dataset: str,
    root: Path,
    *,
    joints: JointChoice | None,
    recordings: str,
    limit: int | None,
    reader: tuple[tuple[str, str], ...],
) -> WindowsPlan:
    """See :func:`prbench_benchmarks.motion_prediction.windows.plan_windows`; Nymeria's joints are the 22.

    Raises:
        UsageError: as there, and for native joints.
        InputFileError: as there.
    """
    if joints == "native":
        remedy = "leave the option out."
        raise UsageError(f"--joints native: no study of prediction published joints of {dataset}; {remedy}")
    wanted = CorpusOptions(source=reader, recordings=recordings)
    chosen = cast(list[NymeriaSource], chosen_recordings(CORPUS.find(root, wanted), wanted, where=root))
    chosen = sorted(chosen, key=lambda each: f"{each.identity.recording_id}/")[:limit]
    options = {"joints": SMPL22.name, "recordings": recordings, "limit": str(limit or "all")}
    options |= {f"reader.{name}": text for name, text in described_options(chosen[0].options).items()}
    # Sequences that are known for bad texts have sound bodies: nothing is left out.
    windows = tuple(NymeriaWindows(**{**vars(each), "skip_reason": None}) for each in chosen)
    return WindowsPlan(chosen[0].identity.dataset, windows, options)
