"""Checks of a reader on a copy of its dataset, ``prbench datasets check``: the contract, and what people can be.

The streams are measured as builds measure them (:mod:`prbench.curation.stream_checks`) and further; then the files of
one recording are damaged in a copy. Everything is told by the engine of findings that judges methods, too.
"""

from __future__ import annotations

import contextlib
import os
import re
import tempfile
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import msgspec
import numpy as np

from prbench.checking.conformance import findings as verdicts
from prbench.checking.conformance.findings import Check, Finding, Report, check, failed, passed
from prbench.checking.doctor.examinations import OF_A_BODY, diagnose
from prbench.curation import build_dataset
from prbench.curation.options import BuildOptions
from prbench.curation.stream_checks import RATE, examine_streams, gridded
from prbench.errors import InputFileError, PrbenchError
from prbench.files.bounded import copy_file, foreign_input, read_whole
from prbench.geometry.timelines import interpolate
from prbench.limits import FARTHEST_EYES, HARMLESS_SIZE
from prbench.readers import Reader, RecordingFiles, cut_short, reader_for
from prbench.readers.extents import damage
from prbench.readers.found import InputFile
from prbench.recording import Recording, wrists_at
from prbench.sequences.table import why_no_sequences

_LONGEST = 600.0  # seconds from the start of a recording that are measured
_NEEDED = ("title", "how_to_obtain", "licence", "required_files")
_READ = ("manifest", "find", "read")
_Tell = Callable[[Check], None] | None
_Options = tuple[tuple[str, str], ...]
# What is measured of the streams, and what mends it
_MEASURED = {
    "clock": ("one clock: rates, movements that agree", "Times are seconds on one clock; the reader changes the unit."),
    "unit": ("metres: people, objects and ways of human size", "Positions are metres; the reader changes the unit."),
    "axes": ("Y up, left is left, all in one world", "Of the head x is left, y up, z forward; gaze begins in it."),
    "place": ("streams see one place at one place", "Everything is in one world."),
    "still": ("nothing stands still to the last digit", "Mask what was not measured."),
    "objects": ("boxes of plausible size", "A box is in metres, in the object's own frame, near its origin."),
    "events": ("events in the recording, at known objects, where a hand is", "Places of events are in the world."),
    "body": ("22 joints in order, bones that keep their length (the doctor)", "prbench.geometry.skeleton.Joint is it."),
}


@dataclass
class _Subject:
    """A reader and a copy of its dataset, with what the reader has given so far."""

    reader: Reader
    options: BuildOptions
    root: Path
    most: int
    scratch: Path
    files: Mapping[Path, tuple[int, int]]
    found: tuple[RecordingFiles, ...] = ()
    recordings: dict[str, Recording] = field(default_factory=dict)
    told: list[Finding] = field(default_factory=list)


def check_dataset(dataset: str, root: Path, most: int = 3, options: _Options = (), announce: _Tell = None) -> Report:
    """Look at a reader in every respect that the contract names, and at what it reads.

    Args:
        dataset: Name of the dataset.
        root: A copy of it.
        most: Number of recordings to read, the first that are found.
        options: Options of the reader, as name and value, sorted by name.
        announce: Called before each check.

    Raises:
        UsageError: for a dataset without reader, or a reader that cannot be imported.
    """
    started = time.perf_counter()
    root = root.expanduser().resolve()
    with tempfile.TemporaryDirectory(prefix="prbench-check-") as folder:
        chosen = BuildOptions(limit=2, reader=options)
        subject = _Subject(reader_for(dataset, dict(options)), chosen, root, most, Path(folder).resolve(), _state(root))
        findings = tuple(verdicts.examine(subject, CHECKS, announce=announce))
    return Report(dataset, findings, time.perf_counter() - started)


def _state(root: Path) -> dict[Path, tuple[int, int]]:
    """Return size and time of change of every file below a folder."""
    return {path: (path.stat().st_size, path.stat().st_mtime_ns) for path in root.rglob("*") if path.is_file()}


def _verdict(wrong: Collection[str], remedy: str, well: str) -> list[Finding]:
    return [failed(said, remedy) for said in wrong] or [passed(well)]


@check("manifest", "reader and manifest say what the dataset is, and what using it asks for")
def _manifest(subject: _Subject) -> list[Finding]:
    manifest = subject.options.manifest_of(subject.reader.dataset)
    wrong = [f"{name} is empty." for name in _NEEDED if not getattr(manifest, name)]
    numbers = {**manifest.rates_hz, **manifest.thresholds}
    wrong += [f"{name} is {number:g}." for name, number in numbers.items() if not 0 < number < np.inf]
    # What nobody else may use needs no citation.
    wrong += ["citation is no BibTeX."] * ("@" not in manifest.citation and manifest.redistribution != "none")
    wrong += ["the reader is no frozen data class."] * (not type(subject.reader).__dataclass_params__.frozen)  # type: ignore[attr-defined]
    return _verdict(wrong, "Complete it: exports and citations take it from there.", f"licence: {manifest.licence}.")


@check("find", "recordings are listed, also from above and from inside", needs=("manifest",))
def _find(subject: _Subject) -> list[Finding]:
    with foreign_input(subject.root):
        subject.found = tuple(subject.reader.find(subject.root))
    ids = {each.recording_id for each in subject.found}
    wrong = []
    for place, least in ((subject.root.parent, ids), (subject.found[0].folder, {subject.found[0].recording_id})):
        with contextlib.suppress(InputFileError), foreign_input(place):  # it may refuse such places
            there = {each.recording_id for each in subject.reader.find(place)}
            wrong += [f"find() does not list {name} when it is given {place}." for name in sorted(least - there)[:1]]
    return _verdict(wrong, "Name a recording by its own files, not by what is searched.", f"{len(ids)} recordings.")


@check("read", "recordings are read: finite, masked, in order of time, rotations of length 1", needs=_READ[:2])
def _read(subject: _Subject) -> list[Finding]:
    manifest = subject.options.manifest_of(subject.reader.dataset)
    usable = [each for each in subject.found if not (each.skip_reason or manifest.why_bad(each.recording_id))]
    subject.found = tuple(usable[: subject.most])
    wrong = []
    for found in subject.found:
        with foreign_input(found.folder):
            read = subject.recordings[found.recording_id] = subject.reader.read(found)
        if (read.dataset, read.recording_id) != (found.dataset, found.recording_id):
            wrong.append(f"{found.recording_id}: is read as {read.dataset}, {read.recording_id}.")
        for kind, certain, evidence, remedy in _examined(read):
            outcome = verdicts.Outcome.FAILED if certain else verdicts.Outcome.WARNING
            subject.told.append(Finding(kind, outcome, f"{found.recording_id}: {evidence}", remedy))
    return _verdict(wrong, "Take both from what find() lists.", f"{len(subject.recordings)} recordings.")


@check("repeatable", "the same files give the same recording, in another process and folder, too", needs=_READ)
def _repeatable(subject: _Subject) -> list[Finding]:
    work = (subject.reader.dataset, subject.options.reader, subject.found)
    with ProcessPoolExecutor(1, get_context("spawn"), initializer=os.chdir, initargs=(subject.scratch,)) as pool:
        others = zip(_digests(*work), pool.submit(_digests, *work).result(), strict=True)
    reads = zip(subject.recordings, map(_digest, subject.recordings.values()), others, strict=True)
    wrong = [f"{name}: other values when it is read again." for name, first, both in reads if {*both} != {first}]
    return _verdict(wrong, "Draw nothing, sort sets, use the paths of find().", "read three times, by two processes.")


def _digests(dataset: str, options: _Options, found: Collection[RecordingFiles]) -> list[bytes]:
    return [_digest(reader_for(dataset, dict(options)).read(each)) for each in found]


def _digest(recording: Recording) -> bytes:
    return msgspec.json.encode(recording, enc_hook=lambda array: array.tobytes(), order="deterministic")


def _examined(recording: Recording) -> Iterator[tuple[str, bool, str, str]]:
    """Yield check, certainty, what was found, and what to change; a fault that explains others comes alone."""
    streams = examine_streams(recording)
    for each in streams:
        yield each.kind.replace("stuck", "still"), each.certain, each.evidence, f"{each.cause} Change it in the reader."
    if any(each.certain for each in streams):
        return
    for kind, measure, value, low, high in _measures(recording):
        if not low <= value <= high:
            yield kind, True, f"{measure} is {value:.3g}, expected {low:g} to {high:g}.", _MEASURED[kind][1]
            return
    if recording.body is not None and recording.body.valid.any():
        times = recording.body.times[recording.body.valid]
        grid = np.arange(times[0], min(times[-1], times[0] + _LONGEST), 0.05)
        joints = interpolate(times, recording.body.joints[recording.body.valid], grid)
        for each in diagnose([joints], None, fps=20, examinations=OF_A_BODY):
            yield "body", each.certain, f"{each.kind}: {each.evidence}.", f"Cause: {each.cause}. {each.remedy}"


def _measures(recording: Recording) -> Iterator[tuple[str, str, float, float, float]]:
    """Yield the check, the measure, its value, and people's least and largest."""
    start, end = recording.span
    for name, stream in {"gaze": recording.gaze, "head": recording.head, "body": recording.body}.items():
        if stream is not None and len(stream.times) > 1:
            yield "clock", f"{name}: samples a second", 1 / np.median(np.diff(stream.times)), 1, 2500
    streams = gridded(recording, np.arange(start, max(start + 1, min(end, start + _LONGEST)), 1 / RATE))
    if streams.head is not None and streams.head[1].any():
        points, known = streams.head
        if recording.gaze.valid.any():
            eyes = interpolate(streams.grid[known], points[known], recording.gaze.times[recording.gaze.valid])
            apart = np.median(np.linalg.norm(recording.gaze.origin[recording.gaze.valid] - eyes, axis=1))
            yield "axes", "gaze: the distance of its origin from the head (m)", apart, 0, FARTHEST_EYES
        if streams.local is not None and streams.local[1].any():  # eyes turn by less, also to what lies at the side
            ahead = np.quantile(streams.local[0][streams.local[1], 2], 0.1)
            yield "axes", "gaze: its cosine to where the head faces, exceeded nine times in ten,", ahead, 0.5, 1.01
        if streams.facing is not None:
            level = streams.facing.apply((0.0, 0.0, 1.0)) * (1, 0, 1)
            walked = np.diff(points, axis=0) * (RATE, 0, RATE)
            walks = (np.linalg.norm(walked, axis=1) > 0.5) & known[1:] & known[:-1]
            ahead = (walked * level[1:]).sum(axis=1)[walks]
            if len(ahead) > 3 * RATE:
                yield "axes", "head: its speed along its z axis while it walks (m/s)", np.median(ahead), -0.25, 8
            if len(streams.hands) == 2:
                apart = (streams.hands["left"][0] - streams.hands["right"][0]) * np.cross((0, 1, 0), level)
                apart = apart.sum(axis=1)[streams.hands["left"][1] & streams.hands["right"][1]]
                yield "axes", "hands: the left one left of the right one by (m)", np.median([0.0, *apart]), -0.05, 2
    for track in (each for each in recording.objects if each.movable):
        edge = float((track.box_max - track.box_min).max())
        middle = float(np.linalg.norm(track.box_min + track.box_max)) / 2
        yield "objects", f"{track.object_id}: the longest edge of its box (m)", edge, 0, 3
        yield "objects", f"{track.object_id}: its box from its origin (m)", middle, 0, max(0.5, edge)
    ids = {track.object_id for track in recording.objects}
    distances = [0.0]
    for event in recording.annotated_events:
        yield "events", f"{event.native_key}: its time (s)", event.event_time, start - 1, end + 1
        yield "events", f"'{event.object_id}' among the objects", not ids or event.object_id in ids, 1, 1
        if event.box_min is not None and event.box_max is not None:
            yield "events", f"{event.native_key}: an edge of its box", np.max(event.box_max - event.box_min), 0, 3
        wrists = wrists_at(recording.hands, recording.body, event.event_time).values()
        if event.location is not None and wrists:
            distances.append(min(float(np.linalg.norm(place - event.location)) for place, _ in wrists))
    yield "events", "the distance of their places from the nearer wrist (m)", np.median(distances), 0, 1


@check("build", "a build of two recordings gives sequences", needs=(*_READ, *_MEASURED))
def _build(subject: _Subject) -> list[Finding]:
    info = build_dataset(subject.reader.dataset, subject.root, subject.scratch / "table", options=subject.options).info
    if info.counts.sequences:
        return [passed(f"{info.counts.sequences} sequences of {info.counts.events} events.")]
    return [verdicts.warning(f"no sequences. {why_no_sequences(info)}", "`prbench explain` tells about one event.")]


@check("damage", "a cut or empty file is refused with its name, and hides no recording", needs=_READ)
def _damage(subject: _Subject) -> list[Finding]:
    found = min(subject.found, key=lambda each: sum(file.size for file in each.files))
    inside = {file.path for file in found.files if 0 < subject.files.get(file.path, (0, 0))[0] <= HARMLESS_SIZE}
    copy = subject.scratch / "copy"
    for path in subject.files:
        target = copy / path.relative_to(subject.root)
        target.parent.mkdir(parents=True, exist_ok=True)
        (copy_file if path in inside else os.symlink)(path, target)  # a reader may distrust links to what it reads
    # Of a thousand frames, a file each, one is damaged, and of all kinds a dozen at most.
    kinds = {re.sub(r"\d+", "", f"{each.role}{each.path.suffix}"): each for each in found.files if each.path in inside}
    wrong = []
    for file in list(kinds.values())[:12]:
        target = copy / file.path.relative_to(subject.root)
        content = read_whole(target)
        half = content[: len(content) // 2]
        for how, damaged in (("cut", half[: half.rfind(b",")]), ("emptied", b"")):
            target.write_bytes(damaged)
            said = _with_damage(subject, found, copy, replace(file, path=target, size=len(content)))
            wrong += [f"{file.path.name}, {how}: {said}."] * bool(said)
        target.write_bytes(content)
    remedy = "Let find() open no data, and check what read() takes (prbench.readers.files), behind @foreign_input()."
    return _verdict(wrong, remedy, f"{len(kinds)} files of {found.recording_id}, cut and emptied in a copy.")


def _with_damage(subject: _Subject, found: RecordingFiles, copy: Path, file: InputFile) -> str:
    """Return what is wrong with how a reader takes a damaged file; empty if nothing is."""
    whole = subject.recordings[found.recording_id]
    looked_at = file.size <= 65536  # by find(), which may look into lists of recordings and descriptions
    try:
        there = {each.recording_id: each for each in subject.reader.find(copy)}
        if not subject.recordings.keys() <= there.keys():
            return "" if looked_at and damage(file) else "find() lists recordings no more"
        looked_at = True
        read = subject.reader.read(there[found.recording_id])
        noticed = read.remarks != whole.remarks or damage(file) or cut_short(there[found.recording_id], read)
        return "" if noticed or _digest(read) == _digest(whole) else "passes for whole, with other values"
    except PrbenchError as error:  # others than of input: streams share no instant any more, for example
        named = not isinstance(error, InputFileError) or (looked_at and file.path.name in str(error))
        return "" if named else f"the message does not name it, or is find()'s: {error}"
    except Exception as error:
        return f"ends in {type(error).__name__}: {error}"


@check("untouched", "nothing is written into the dataset's folder")
def _untouched(subject: _Subject) -> list[Finding]:
    changed = {path for path, _ in _state(subject.root).items() ^ subject.files.items()}
    wrong = [f"{path.relative_to(subject.root)} was written, changed or removed." for path in sorted(changed)[:3]]
    return _verdict(wrong, "Keep what you compute in memory.", f"{len(subject.files)} files as they were.")


def _told(subject: _Subject, kind: str) -> list[Finding]:
    return [each for each in subject.told if each.check == kind] or [passed("nothing in what was read.")]


_STREAMS = [Check(kind, said[0], partial(_told, kind=kind), needs=_READ) for kind, said in _MEASURED.items()]
CHECKS = (_manifest, _find, _read, _repeatable, *_STREAMS, _build, _damage, _untouched)
