"""Recordings to align: what each dataset can compare, the record of one recording, and what its picture shows."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import msgspec
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from prbench.alignment.align import Alignment, align, relative_motions
from prbench.alignment.clock import LONGEST_GAP, RATE, angular_speed, find_clock
from prbench.alignment.hand_eye import sizes_of_errors, usable
from prbench.curation.job import chosen_ids
from prbench.entry_points import CORPORA, load_built_in
from prbench.errors import PrbenchError, RecordingUnusable
from prbench.geometry.skeleton import Joint
from prbench.geometry.timelines import covered
from prbench.readers import Reader, RecordingFiles, reader_for
from prbench.readers.egoallo import bodies, files, format
from prbench.readers.gimo.hololens import hololens_and_suit
from prbench.recording import PoseStream, Recording

_DISTANCE_RATE = 10.0  # Hz
_TO_HEAD = (Joint.SPINE1, Joint.SPINE2, Joint.SPINE3, Joint.NECK, Joint.HEAD)
_POSITIONS_ALONE = "the body holds positions of joints alone: nothing tells how its head turns"


@dataclass(frozen=True)
class Tracks:
    """What one recording can compare.

    Attributes:
        compared: Names of device and segment, for people.
        device: Poses of the glasses.
        segment: Poses of the segment that carries them.
        offset: Segment's clock minus the glasses' where it is known to half a second; None searches it.
        wrists: Sides, wristbands in the world of the glasses, and segments of the hands; read one after the other.
        one_world: Glasses and segment are in one world and on one clock.
        messages: Sentences about what is missing.
        refused: Reason why the segment's rotations are none.
    """

    compared: str
    device: PoseStream
    segment: PoseStream
    offset: float | None = None
    wrists: Iterable[tuple[str, PoseStream, PoseStream]] = ()
    one_world: bool = False
    messages: tuple[str, ...] = ()
    refused: str = ""


class TrackSource(Protocol):
    """A recording of which tracks can be read; picklable. A corpus offers a function from its root to all of them."""

    @property
    def found(self) -> RecordingFiles:
        """The recording's files."""
        ...

    def read(self) -> Tracks:
        """Read the tracks.

        Raises:
            PrbenchError: saying what is missing or damaged.
        """
        ...


class Distance(msgspec.Struct, frozen=True, kw_only=True):
    """Distance of a device from the joint beside it, both in the world of the glasses: constant if all is well.

    Attributes:
        of: ``left`` or ``right`` wristband to the suit's hand, or ``head``: glasses to the body's head joint.
        mean_cm: Mean distance, centimetres; None where it is not known.
        deviation_cm: Its standard deviation.
        refused: Reason why it is not known.
    """

    of: str
    mean_cm: float | None = None
    deviation_cm: float | None = None
    refused: str = ""


class AlignedRecording(msgspec.Struct, frozen=True, kw_only=True):
    """The report on one recording.

    Attributes:
        recording_id: Id of the recording.
        compared: Names of device and segment.
        alignment: Clock, X and findings, or why they are refused.
        distances: Devices against the joints beside them.
        messages: Sentences about what the recording lacks.
    """

    recording_id: str
    compared: str
    alignment: Alignment
    distances: tuple[Distance, ...] = ()
    messages: tuple[str, ...] = ()


# Maps what a line of the picture shows to its times (seconds, device clock) and values.
Evidence = dict[str, tuple[np.ndarray, np.ndarray]]


def compare(source: TrackSource) -> tuple[AlignedRecording, Evidence]:
    """Align one recording and check distances; whatever cannot be compared is refused with a sentence."""
    try:
        tracks = source.read()
    except PrbenchError as error:
        refused = Alignment(refused=str(error))
        return AlignedRecording(recording_id=source.found.recording_id, compared="nothing", alignment=refused), {}
    found = Alignment(refused=tracks.refused)
    if not tracks.refused:
        found = align(tracks.device, tracks.segment, offset=tracks.offset)
    clock = found.clock
    lines: Evidence = {}
    for name, stream in (("device", tracks.device), ("segment", tracks.segment)):
        signal = angular_speed(stream)
        if signal is not None and clock is not None:
            times = signal[0] + np.flatnonzero(signal[2]) / RATE
            lines[name] = (times if name == "device" else clock.to_device(times), np.rad2deg(signal[1][signal[2]]))
    on_segment = np.arange(tracks.segment.times[0], tracks.segment.times[-1], 1.0 / _DISTANCE_RATE)
    distances = []
    measured: dict[str, list[tuple[PoseStream, np.ndarray]]] = {}
    if tracks.one_world:
        measured["head"] = [(tracks.device, on_segment), (tracks.segment, on_segment)]
    if clock is not None and found.device_from_segment is not None:
        motions, _, _ = relative_motions(tracks.device, tracks.segment, clock)
        motions = motions[usable(motions)[1]]
        sizes = sizes_of_errors(motions, np.array(found.device_from_segment))
        lines |= {name: (motions.times, each) for name, each in zip(("° a motion", "mm a motion"), sizes, strict=True)}
        on_device = clock.to_device(on_segment)
        for side, band, hand in tracks.wrists:
            own = find_clock(band, hand)
            if own is None or own.doubt():
                doubt = "too few poses" if own is None else own.doubt()
                distances.append(Distance(of=side, refused=f"band and hand turn alike by {doubt}"))
                continue
            measured[side] = [(band, own.to_device(on_segment)), (hand, on_segment)]
            measured[side] += [(tracks.device, on_device), (tracks.segment, on_segment)]
    for name, streams in measured.items():
        there = np.all([covered(each.times, each.valid, at, max_gap=LONGEST_GAP) for each, at in streams], axis=0)
        if not there.any():
            continue  # as the clock or the reader has said
        (place, _), (other, _), *glasses_and_head = [each.pose_at(at[there]) for each, at in streams]
        if glasses_and_head:
            # The hand from the suit's world to that of the glasses: T_WD · X · T_OH⁻¹.
            glasses, head = glasses_and_head
            x = found.x_at(streams[2][1][there])
            in_head = Rotation.from_quat(head[1], scalar_first=True).inv().apply(other - head[0])
            on_glasses = np.einsum("nij,nj->ni", x[:, :3, :3], in_head) + x[:, :3, 3]
            other = glasses[0] + Rotation.from_quat(glasses[1], scalar_first=True).apply(on_glasses)
        away = 100.0 * np.linalg.norm(other - place, axis=1)
        lines[name] = (streams[0 if name == "head" else 2][1][there], away)
        distances.append(Distance(of=name, mean_cm=float(away.mean()), deviation_cm=float(away.std())))
    shown = {"compared": tracks.compared, "messages": tracks.messages, "distances": tuple(distances)}
    return AlignedRecording(recording_id=source.found.recording_id, alignment=found, **shown), lines


@dataclass(frozen=True)
class ReadTracks:
    """A recording of any reader: its glasses against the head of its body, which share clock and world."""

    reader: Reader
    found: RecordingFiles

    def read(self) -> Tracks:
        """See :class:`TrackSource`."""
        if self.reader.dataset == "gimo":
            return Tracks("HoloLens and the suit's head", *hololens_and_suit(self.found.folder))
        recording = self.reader.read(self.found)
        if not recording.head.valid.any():
            raise RecordingUnusable(f"the reader of {recording.dataset} gives no poses of glasses.")
        body = recording.body
        if body is None or not body.valid.any():
            raise RecordingUnusable(f"no body to compare with the glasses. {'; '.join(recording.messages)}".strip())
        outputs = [file.path for file in self.found.files if file.role.startswith(files.OUTPUT_ROLE)]
        turned = np.tile([1.0, 0.0, 0.0, 0.0], (len(body.times), 1))
        what: dict[str, Any] = {"compared": "glasses and the body's head joint", "refused": _POSITIONS_ALONE}
        if outputs and recording.pose_source == "egoallo":
            turned = egoallo_heads([bodies.read_output(path) for path in outputs], recording)
            what = {"compared": "glasses and EgoAllo's head joint", "offset": 0.0}
        segment = PoseStream(body.times, body.joints[:, Joint.HEAD], turned, body.valid)
        return Tracks(device=recording.head, segment=segment, one_world=True, messages=recording.messages, **what)


def egoallo_heads(outputs: list[format.EgoAlloOutput], recording: Recording) -> Float[np.ndarray, "n 4"]:
    """Return the rotation of EgoAllo's head joint in the recording's world, w x y z, at the times of its body.

    Raises:
        RecordingUnusable: if the windows hold other frames than the body.
    """
    outputs = sorted(outputs, key=lambda window: (int(window.time_ns[0]), window.name))
    time_ns = np.concatenate([window.time_ns for window in outputs])
    order = np.argsort(time_ns, kind="stable")
    turned: Any = Rotation.from_quat(np.concatenate([w.world_from_root[0, :, :4] for w in outputs]), scalar_first=True)
    for joint in _TO_HEAD:
        local = np.concatenate([window.body_quats[0, :, joint - 1] for window in outputs])
        turned = turned * Rotation.from_quat(local, scalar_first=True)
    kept = order[np.diff(time_ns[order], prepend=time_ns.min() - 2 * format.SAME_FRAME_NS) > format.SAME_FRAME_NS]
    if recording.body is None or len(kept) != len(recording.body.times):
        raise RecordingUnusable(f"{recording.recording_id}: EgoAllo's windows do not join into the recording's body.")
    return (Rotation.from_matrix(recording.world_from_source[:3, :3]) * turned[kept]).as_quat(scalar_first=True)


def chosen_tracks(
    dataset: str, root: Path, recordings: str, limit: int | None, options: Iterable[tuple[str, str]]
) -> list[TrackSource]:
    """Return the recordings of a dataset that the user chose, by name.

    Raises:
        UsageError: for a dataset that nothing reads, and for options that its reader lacks.
        InputFileError: if there is no recording, or none matches.
    """
    if dataset == "nymeria" and not options:
        found = load_built_in(CORPORA, "align")(root)
    else:
        reader = reader_for(dataset, dict(options))
        sources = [ReadTracks(reader, files) for files in reader.find(root)]
        # GIMO's segments share the files of their sequence, for which its first one stands.
        first = {each.found.folder: each for each in reversed(sources)}
        found = list(first.values()) if reader.dataset == "gimo" else sources
    by_name = {source.found.recording_id: source for source in found}
    return [by_name[name] for name in chosen_ids(sorted(by_name), recordings, limit, where=root)]
