"""Read one dataset of a release: its entries with their arrays, every problem, and what the layout does not state.

A few numbers are kept of each sequence, so that memory does not grow with the motions.
Source: docs/specification/pr-release.md.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float

from prbench.errors import InputFileError, UsageError
from prbench.files.storage import bytes_digest
from prbench.geometry.skeleton import WRISTS, Joint, canonical_frame
from prbench.release import layout
from prbench.release.report import Certainty, Inference, SequenceProblem, count_splits

AS_THE_MOTIONS = "as the motions"
UNKNOWN = "unknown"
POSE_SOURCE = "release"
_SUBSETS = {"train": "train", "training": "train", "test": "test", "testing": "test", "val": "validation",
            "validation": "validation"}  # fmt: skip
# Seconds before the prime at which a sequence begins (Prime and Reach, section 3.2).
_LEAD = 2.0


@dataclass(frozen=True, kw_only=True)
class ImportOptions:
    """Statements of a user about a release.

    Attributes:
        fps: Frame rate, where the release does not tell it.
        field_map: Field of the release by canonical name, where its name is not a known one.
        on_error: Leave out sequences (and datasets) that cannot be read, or fail at the first.
        replace: Replace a table that holds recordings which the new one lacks (:mod:`prbench.sequences.write`).
    """

    fps: float | None = None
    field_map: Mapping[str, str] = field(default_factory=dict)
    on_error: Literal["skip", "fail"] = "skip"
    replace: bool = False


@dataclass(frozen=True, kw_only=True)
class ReleasedSequence:
    """One sequence whose entry and arrays are whole; positions are metres in the frame of its motion.

    Attributes:
        fields: The fields of its entry, by the names that the release gives them.
        gaze: None where there is no usable file.
        further: None where there is none, or the block that belongs to it no longer fits.
        block: What our exporter wrote of it, if it still fits.
        digest: Digest of the bytes of its files.
        pelvis_to_head: Median distance over the frames.
        motion_from_canonical: Pose of the canonical frame of its first frame; exactly the unit matrix where its motion
            is given in it.
        goal_to_wrist: Distance of the goal from the nearer wrist in the last frame.
    """

    fields: Mapping[str, Any]
    index: int
    motion: Path
    gaze: Path | None
    further: Path | None
    block: dict[str, Any] | None
    n_frames: int
    goal: Float[np.ndarray, "3"]
    subset: str
    primed_frame: int
    digest: str
    pelvis_to_head: float
    motion_from_canonical: Float[np.ndarray, "4 4"]
    goal_to_wrist: float
    sequence_id: str
    event_id: str
    recording_id: str
    participant_id: str
    split_group: str


@dataclass
class ReleasedDataset:
    """One dataset of a release, measured; problems and warnings are collected while it is read.

    Attributes:
        files: Arrays by kind (``motions`` …) and number.
        mapping: Field of the release by canonical name.
        unmapped: Fields that stand for no canonical one.
    """

    dataset: str
    folder: Path
    files: dict[str, dict[int, Path]]
    mapping: dict[str, str]
    unmapped: list[str]
    fps: float
    inferences: list[Inference]
    sequences: list[ReleasedSequence] = field(default_factory=list)
    problems: list[SequenceProblem] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def infer(self, name: str, value: str, how_surely: Certainty, evidence: str) -> None:
        """Put down a property that the release does not state."""
        self.inferences.append(Inference(name=name, value=value, how_surely=how_surely, evidence=evidence))

    def note(self, key: str, problem: str, *, left_out: bool = False) -> None:
        """Note a problem of a sequence."""
        self.problems.append(SequenceProblem(key, problem, left_out))

    @property
    def left_out(self) -> dict[str, str]:
        """Maps every sequence that was left out to all its problems."""
        reasons: dict[str, list[str]] = {}
        for problem in self.problems:
            if problem.left_out:
                reasons.setdefault(problem.sequence, []).append(problem.problem)
        return {key: "; ".join(texts) for key, texts in reasons.items()}

    @property
    def goal_frame(self) -> str:
        """The frame of the goals: :data:`AS_THE_MOTIONS` or :data:`UNKNOWN`."""
        return next(each.value for each in self.inferences if each.name == "goal_frame")


def read_release(
    dataset: str, folder: Path, options: ImportOptions, progress: Callable[[str, str], None]
) -> ReleasedDataset:
    """Read and measure every sequence of one dataset.

    Args:
        dataset: Its name.
        folder: Its folder.
        options: Statements of the user.
        progress: Called with the dataset and the step that begins.

    Raises:
        InputFileError: if a file is missing or damaged, a field is missing, no sequence is whole, nothing tells the
            frame rate, or people have an impossible size; with ``on_error="fail"`` for the first sequence that is not
            whole.
        UsageError: if the user names a field that does not exist.
    """
    files = layout.list_files(folder)
    progress(dataset, f"reading {layout.TARGETS}")
    entries = layout.read_targets(folder / layout.TARGETS)
    names = list(dict.fromkeys(name for fields in entries.values() for name in fields))
    mapping = _map_fields(folder / layout.TARGETS, names, options.field_map)
    fps, rate = _frame_rate(folder, list(entries.values()), mapping, options.fps)
    unmapped = [name for name in names if name not in mapping.values()]
    found = ReleasedDataset(dataset, folder, files, mapping, unmapped, fps, inferences=[rate])
    progress(dataset, f"measuring {len(entries)} sequences")
    for key, fields in entries.items():
        _read_sequence(found, key, fields)
    for index in sorted(set(files[layout.MOTIONS]) - {layout.index_of(key) for key in entries}):
        found.note(f"{index:010d}", f"a motion without an entry in {layout.TARGETS}", left_out=True)
    left_out = found.left_out
    if left_out and (options.on_error == "fail" or not found.sequences):
        key, reason = next(iter(left_out.items()))
        more = f" (and {len(left_out) - 1} more sequences)" if len(left_out) > 1 else ""
        raise InputFileError(folder, f"sequence {key}", expected="a complete sequence", found=reason + more)
    _judge(found)
    # Counts that differ from the study's, as those of a later release may; they say nothing about synthetic people.
    known = None if dataset.startswith(layout.SYNTHETIC_PREFIX) else layout.load_known().datasets.get(dataset)
    found.warnings += [
        f"{row.split}: {row.found} sequences, the study has {row.study}."
        for row in count_splits((each.subset for each in found.sequences), known)
        if row.study is not None and row.found != row.study
    ]
    return found


def _map_fields(where: Path, names: list[str], given: Mapping[str, str]) -> dict[str, str]:
    """Return the field of the release by canonical name: the user's choice, else the field with a known name.

    Raises:
        UsageError: if the user names a field that does not exist.
        InputFileError: if two names of a field that is needed are there, or none; lists the names.
    """
    known = layout.load_known()
    for canonical, name in given.items():
        if canonical not in known.fields:
            raise UsageError(f"--field-map: there is no field '{canonical}'; there are: {', '.join(known.fields)}.")
        if name not in names:
            raise UsageError(f"--field-map {canonical}={name}: {where} has the fields {', '.join(names)}.")
    mapping = dict(given)
    for canonical, aliases in known.fields.items():
        if canonical in given:
            continue
        fitting = [name for name in names if layout.letters(name) in aliases and name not in mapping.values()]
        needed = canonical in known.required_fields
        if needed and len(fitting) != 1:
            # Guessing between two goals or two splits would silently give a wrong benchmark.
            several = f"{len(fitting)}: {', '.join(fitting)}"
            raise InputFileError(
                where,
                canonical,
                expected="one field that fits" if fitting else "a field that fits",
                found=several if fitting else f"the fields {', '.join(names)}",
                remedy=f"Say which it is: --field-map {canonical}={fitting[0] if fitting else 'NAME'}",
            )
        if fitting:
            mapping[canonical] = min(fitting, key=lambda name: aliases.index(layout.letters(name)))
    return mapping


def _frame_rate(
    folder: Path, entries: list[dict[str, Any]], mapping: Mapping[str, str], given: float | None
) -> tuple[float, Inference]:
    """Return the frame rate: the user's, else the stated one, else that of which most primes are 2 s after the start.

    Raises:
        InputFileError: if nothing tells it.
    """
    known = layout.load_known()
    stated = {number for entry in entries if (number := _number(entry.get(mapping.get("fps", "")))) is not None}
    primes = [number for entry in entries if (number := _number(entry.get(mapping["primed_frame"]))) is not None]
    mode = Counter(primes).most_common(1)[0][0] if primes else 0.0
    measured = mode / _LEAD
    nearest = min(known.frame_rates, key=lambda rate: abs(measured - rate))
    agree = np.mean(np.abs(np.array(primes) - mode) <= 1) >= known.agreeing_primes if primes else False
    said = f"most frequent primed frame, 2 s after the start: {mode:g}"
    if given is not None:
        return given, Inference(name="fps", value=f"{given:g}", how_surely="certain", evidence=f"given; {said}")
    if len(stated) == 1 and next(iter(stated)) > 0:
        (rate,) = stated
        return rate, Inference(name="fps", value=f"{rate:g}", how_surely="certain", evidence="stated by the entries")
    if not stated and agree and abs(measured - nearest) <= known.frame_rate_tolerance * nearest:
        return nearest, Inference(name="fps", value=f"{nearest:g}", how_surely="assumed", evidence=said)
    raise InputFileError(
        folder,
        "frame rate",
        expected=f"one stated rate, or primed frames 2 s after the start at {known.frame_rates} Hz",
        found=f"the rates {sorted(stated)}" if stated else said,
        remedy="Say what it is: --fps N",
    )


def _read_sequence(found: ReleasedDataset, key: str, fields: Mapping[str, Any]) -> None:
    """Read and measure one sequence; all problems of it are noted, so that a user sees them at once."""
    index = layout.index_of(key)
    if index is None:
        found.note(key, "an entry without a motion: its key holds no number", left_out=True)
        return

    def value(canonical: str) -> Any:
        return fields.get(found.mapping.get(canonical, ""))

    point = value("goal")
    numbers = [_number(part) for part in point] if isinstance(point, list) and len(point) == 3 else [None]
    goal = None if None in numbers else np.array(numbers, dtype=np.float64)
    subset = _SUBSETS.get(str(value("subset")).strip().lower())
    primed = _number(value("primed_frame"))
    for name, expected, read in (
        ("goal", "three finite numbers", goal),
        ("subset", "train or test", subset),
        ("primed_frame", "a number", primed),
    ):
        if read is None:
            text = "nothing" if value(name) is None else repr(value(name))
            shown = text if len(text) <= 60 else f"{text[:57]}…"
            found.note(key, f"{name.replace('_', ' ')}: expected {expected}, found {shown}", left_out=True)
    motion = _read_motion(found, key, index)
    if goal is None or subset is None or primed is None or motion is None:
        return
    joints, motion_from_canonical, content = motion
    n_frames = len(joints)
    if primed != round(primed) or not 0 <= primed < n_frames:
        text = f"primed frame: expected one of the frames (0 to the last), found {primed:g} of {n_frames - 1}"
        found.note(key, text, left_out=True)
        return
    gaze_file, gaze_content = _read_gaze(found, key, index, n_frames)
    further, further_content = found.files[layout.FURTHER].get(index), b""
    if further is not None:
        try:
            further_content = layout.read_further(further, n_frames)[1]
        except InputFileError:
            found.note(key, "further: damaged or of another motion, not used")
            further = None
    block = None
    if further is not None:
        block = layout.convert_block(value("prbench"), fps=found.fps, primed_frame=primed, n_frames=n_frames)
    source = value("source").strip() if isinstance(value("source"), str) else ""
    event = f"{found.dataset}/{index:010d}"
    named = {
        "sequence_id": f"{event}/{POSE_SOURCE}",
        "event_id": event,
        "recording_id": source or f"unknown-{subset}",
        "participant_id": "unknown",
        "split_group": source or f"unknown-{subset}",
    }
    found.sequences.append(
        ReleasedSequence(
            fields=fields,
            index=index,
            motion=found.files[layout.MOTIONS][index],
            gaze=gaze_file,
            further=further,
            block=block,
            n_frames=n_frames,
            goal=goal,
            subset=subset,
            primed_frame=round(primed),
            digest=bytes_digest(content + gaze_content + further_content),
            pelvis_to_head=float(np.median(np.linalg.norm(joints[:, Joint.HEAD] - joints[:, Joint.PELVIS], axis=1))),
            motion_from_canonical=motion_from_canonical,
            goal_to_wrist=float(np.linalg.norm(joints[-1, WRISTS] - goal, axis=1).min()),
            **(named if block is None else {name: block[name] for name in named}),
        )
    )


def _read_motion(found: ReleasedDataset, key: str, index: int) -> tuple[np.ndarray, np.ndarray, bytes] | None:
    """Return the joints of a sequence, the pose of its canonical frame and the file's bytes; None if it is unusable."""
    path = found.files[layout.MOTIONS].get(index)
    if path is None:
        found.note(key, "no file in motions", left_out=True)
        return None
    try:
        joints, content = layout.read_array(path, (22, 3))
        joints = joints.astype(np.float64)
        if len(joints) < 2:
            problem = f"expected 2 frames or more, found {len(joints)}"
        elif not np.isfinite(joints).all():
            problem = "expected finite numbers, found NaN or infinity"
        else:
            rules = layout.load_known()
            pose = canonical_frame(joints)
            # The matrix is a turn about y and a shift, so two entries hold the whole angle.
            yaw = np.degrees(np.arctan2(pose[0, 2], pose[0, 0]))
            near = np.abs(pose[:3, 3]).max() <= rules.canonical_position and abs(yaw) <= rules.canonical_yaw_deg
            return joints, np.eye(4) if near else pose, content
    except InputFileError as error:
        problem = f"expected {error.expected}, found {error.found}"
    except ValueError:
        problem = "its first pose has no heading, hips and shoulders lie on one vertical line"
    found.note(key, f"motion: {problem}", left_out=True)
    return None


def _read_gaze(found: ReleasedDataset, key: str, index: int, n_frames: int) -> tuple[Path | None, bytes]:
    """Return the file of a sequence's gaze and its bytes; None where it is missing or wrong, which costs the gaze."""
    path = found.files[layout.GAZES].get(index)
    if path is None:
        found.note(key, "no file in gazes: no gaze")
        return None, b""
    try:
        gaze, content = layout.read_array(path, (3,))
    except InputFileError as error:
        found.note(key, f"gaze: expected {error.expected}, found {error.found}: no gaze")
        return None, b""
    if len(gaze) != n_frames:
        found.note(key, f"gaze: expected {n_frames} frames like the motion, found {len(gaze)}: no gaze")
        return None, b""
    if not clean_gaze(gaze, n_frames)[1].any():
        found.note(key, "gaze: no frame has a unit vector")
    return path, content


def _judge(found: ReleasedDataset) -> None:
    """Check that people have the size of people in metres, and tell the frames of motions and goals.

    Raises:
        InputFileError: if they have not that size, or another unit is stated.
    """
    rules = layout.load_known()
    units = {str(each.fields.get(found.mapping.get("units", ""), "")).strip().lower() for each in found.sequences}
    stated = units.pop() if len(units) == 1 else ""
    size = float(np.median([each.pelvis_to_head for each in found.sequences]))
    # Bodies differ by some per cent, units by factors of ten: the distance from pelvis to head tells them apart.
    if not rules.lowest_pelvis_to_head <= size <= rules.highest_pelvis_to_head or stated in ("cm", "mm"):
        raise InputFileError(
            found.folder,
            "motions",
            expected=f"a median distance from pelvis to head of {rules.lowest_pelvis_to_head:g} to"
            f" {rules.highest_pelvis_to_head:g} m",
            found=f"{size:.3g}" + (f", stated as '{stated}'" if stated else ""),
            remedy="Turn positions and goals into metres, and check the joint order: 22 joints in the order of"
            " HumanML3D, y up.",
        )
    is_stated = stated in ("m", "metre", "metres", "meter", "meters")
    evidence = f"median distance from pelvis to head: {size:.3g}"
    found.infer("units", "metres", "certain" if is_stated else "likely", evidence)

    blocks = [each.block for each in found.sequences if each.block is not None]
    # An entry without a block was written or changed by somebody else; then measurements count.
    if len(blocks) == len(found.sequences):
        evidence = "stated by the prbench block of every entry"
        frames = sorted({block["motion_frame"] for block in blocks})
        found.infer("motion_frame", " and ".join(frames), "certain", evidence)
        known = all(block["goal_frame"] != UNKNOWN for block in blocks)
        found.infer("goal_frame", AS_THE_MOTIONS if known else UNKNOWN, "certain" if known else "unknown", evidence)
        return
    share = float(np.mean([(each.motion_from_canonical == np.eye(4)).all() for each in found.sequences]))
    evidence = f"frame 0 stands over the origin, faces +z, lowest joint at 0 in {share:.1%} of the sequences"
    frame = {1.0: "canonical", 0.0: "world (canonicalised here)"}.get(share, "canonical and world")
    found.infer("motion_frame", frame, "certain", evidence)
    distance = float(np.median([each.goal_to_wrist for each in found.sequences]))
    evidence = f"median distance of goal and nearer wrist in the last frame: {distance:.2f} m"
    if distance < rules.goal_to_wrist:
        found.infer("goal_frame", AS_THE_MOTIONS, "likely", evidence)
    else:
        found.infer("goal_frame", UNKNOWN, "unknown", f"{evidence}; not below {rules.goal_to_wrist:g} m")


def clean_gaze(gaze: np.ndarray | None, n_frames: int) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
    """Return unit directions and their validity.

    NaN, zero and lengths far from 1 are invalid; lengths near 1 are made exact.
    """
    rules = layout.load_known()
    directions = np.full((n_frames, 3), np.nan) if gaze is None else gaze.astype(np.float64)
    length = np.linalg.norm(directions, axis=1)
    valid = np.abs(length - 1) <= rules.gaze_tolerance
    unit = np.abs(length - 1) <= rules.unit_gaze_tolerance
    scale = np.where(valid & ~unit, length, 1.0)[:, None]
    return np.where(valid[:, None], directions / scale, [0.0, 0.0, 1.0]), valid


def _number(value: Any) -> float | None:
    """Return a finite number, None for anything else; in Python True is an int, in a release it is no number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None
