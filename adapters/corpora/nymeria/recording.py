"""A Nymeria recording as every reader gives one: body and gaze on one clock, for windows of motion prediction."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from prbench.errors import InputFileError
from prbench.files.bounded import foreign_input
from prbench.files.storage import file_digest, text_digest
from prbench.geometry.skeleton import Joint
from prbench.protocol.manifests import load_manifest
from prbench.readers.aria_mps.files import read_gaze_angles
from prbench.readers.aria_mps.search import NearGaze
from prbench.readers.aria_mps.trajectory import read_near
from prbench.recording.streams import BodyStream, GazeStream, PoseStream, Recording
from prbench_adapters.corpora.nymeria.body import BodyMotion
from prbench_adapters.corpora.nymeria.clock import ClockOffset, offset_by_correlation, offset_from_file
from prbench_adapters.corpora.nymeria.files import OFFSET, SUIT, TRAJECTORY
from prbench_adapters.corpora.nymeria.format import SUIT_FILE
from prbench_adapters.corpora.nymeria.gaze import gaze_file, gaze_in_suit_world, head_from_device
from prbench_adapters.corpora.nymeria.source import NymeriaSource
from prbench_adapters.corpora.nymeria.suit import CleanSuit, clean_suit, read_suit

_NO_TIMES = np.empty(0, dtype=np.int64)


@dataclass(frozen=True)
class SuitRecording:
    """Reads one sequence without its texts; see :class:`prbench_adapters.corpora.nymeria.source.NymeriaSource`."""

    source: NymeriaSource

    @foreign_input()
    def input_digest(self) -> str:
        """Digest of all files of the sequence, and of the gaze beside its trajectory."""
        gaze = self._gaze_file()
        return text_digest(self.source.input_digest(), "" if gaze is None else file_digest(gaze))

    @foreign_input()
    def read(self) -> Recording:
        """Body on the suit's clock, and gaze where trajectory, gaze file and clock allow it.

        Raises:
            InputFileError: if a file does not hold what its format promises.
        """
        manifest = load_manifest("nymeria")
        path = self.source.found.require(SUIT, f"body/{SUIT_FILE}")
        clean = clean_suit(read_suit(path), manifest.thresholds, path=path)
        motion = self.source.body(clean)
        body = _body_stream(motion)
        gaze, message = self._gaze(clean)
        nowhere = PoseStream(body.times[:1], body.joints[:1, Joint.HEAD], np.array([[1.0, 0, 0, 0]]), np.zeros(1, bool))
        identity = self.source.identity
        return Recording(
            dataset=identity.dataset,
            recording_id=identity.recording_id,
            participant_id=identity.participant_id,
            pose_source=motion.pose_source,
            head_tilt_deg=motion.head_tilt_deg,
            span=(float(body.times[0]), float(body.times[-1])),
            gaze=gaze,
            camera=nowhere,
            head=nowhere,
            body=body,
            hands=(),
            objects=(),
            split_group=identity.split_group,
            messages=tuple(text for text in (*motion.messages, message) if text),
        )

    def _gaze_file(self) -> Path | None:
        trajectory = self.source.found.path(TRAJECTORY)
        return None if trajectory is None else gaze_file(trajectory)

    def _gaze(self, clean: CleanSuit) -> tuple[GazeStream, str]:
        """Gaze in the suit's world; without any, why."""
        path = self._gaze_file()
        if path is None:
            return _no_gaze(), "no gaze file beside a trajectory of the glasses"
        thresholds = load_manifest("nymeria").thresholds
        trajectory_path = self.source.found.require(TRAJECTORY, "the glasses' trajectory")
        trajectory = read_near(trajectory_path, NearGaze(_NO_TIMES, thresholds["correlation_rate"]))
        offset, message = self._offset(clean, trajectory.time_us, trajectory.rotation, thresholds)
        if offset is None:
            return _no_gaze(), message
        seconds = trajectory.time_us / 1e6
        mounted, message = head_from_device(clean, offset, seconds, trajectory.rotation)
        if mounted is None:
            return _no_gaze(), message
        angles = read_gaze_angles(path)
        times = angles.time_us / 1e6 + offset.seconds
        directions, valid = gaze_in_suit_world(clean, mounted, times, angles)
        # Nothing of motion prediction needs where gaze comes from.
        return GazeStream(times, np.zeros((len(times), 3)), directions, valid), ""

    def _offset(
        self, clean: CleanSuit, time_us: np.ndarray, rotation: np.ndarray, thresholds: dict[str, float]
    ) -> tuple[ClockOffset | None, str]:
        """The user's own offset, or that at which suit and glasses turn alike; texts are not needed for either."""
        path = self.source.found.path(OFFSET)
        known = None if path is None else offset_from_file(path, self.source.found.recording_id)
        return (known, "") if known is not None else offset_by_correlation(clean, time_us, rotation, thresholds)


def _body_stream(motion: BodyMotion) -> BodyStream:
    """All pieces on one time line; what lies between them is a gap.

    Raises:
        InputFileError: if pieces overlap in time.
    """
    pieces = sorted(motion.pieces, key=lambda piece: piece.start)
    times = np.concatenate([piece.start + np.arange(len(piece.joints)) / piece.rate for piece in pieces])
    if (np.diff(times) <= 0).any():
        raise InputFileError(
            SUIT_FILE,
            "timestamps_us",
            expected="pieces of motion one after the other",
            found="two that overlap in time",
            remedy="Leave the recording out.",
        )
    joints = np.concatenate([piece.joints for piece in pieces]).astype(np.float64)
    return BodyStream(times, joints, np.ones(len(times), dtype=bool))


def _no_gaze() -> GazeStream:
    return GazeStream(np.zeros(1), np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), np.zeros(1, dtype=bool))
