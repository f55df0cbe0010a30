"""Read one dataset of a release: its entries with their arrays, every problem, and what the layout does not state.

A few numbers are kept of each sequence, so that memory does not grow with the motions.
Source: docs/specification/pr-release.md.
"""

from __future__ import annotations

import json
import math
import shlex
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float

from prbench.errors import InputFileError, UsageError, did_you_mean
from prbench.files.bounded import require
from prbench.files.storage import file_digest, text_digest
from prbench.geometry.skeleton import WRISTS, Joint, canonical_frame
from prbench.release import layout
from prbench.release.report import ImportReport
from prbench.shown import quoted

AS_THE_MOTIONS = "as the motions"
UNKNOWN = "unknown"
# Seconds before the prime at which a sequence begins (Prime and Reach, section 3.2).
_LEAD = 2.0
_EXAMPLES = 12  # fields that a message shows
Progress = Callable[[str, str], None]  # is told a dataset and what is done with it


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

    def __post_init__(self) -> None:
        fields = layout.load_known().fields
        for canonical in self.field_map:
            if canonical not in fields:
                known = f"There are: {', '.join(fields)}.{did_you_mean(canonical, fields)}"
                raise UsageError(f"--field-map: there is no field '{quoted(canonical)}'. {known}")


@dataclass(frozen=True)
class ReleasedSequence:
    """One sequence whose entry and arrays are whole; positions are metres in the frame of its motion.

    Attributes:
        fields: The fields of its entry, by the names that the release gives them.
        gaze: None where there is no usable file.
        primed_frame: Counts from 0.
        source: Recording that it comes from; ``unknown-train`` and so on where no field names it.
        digest: Digest of the bytes of its files.
        pelvis_to_head: Median distance over the frames.
        upright: Share of that distance that is vertical.
        motion_from_canonical: Pose of the canonical frame of its first frame; exactly the unit matrix where its motion
            is given in it.
        goal_to_wrist: Distance of the goal from the nearer wrist in the last frame.
        goal_to_gaze: Distance of the goal from the gaze ray at the primed frame; NaN without gaze.
    """

    fields: Mapping[str, Any]
    index: int
    motion: Path
    gaze: Path | None
    n_frames: int
    goal: Float[np.ndarray, "3"]
    subset: str
    primed_frame: int
    source: str
    digest: str
    pelvis_to_head: float
    upright: float
    motion_from_canonical: Float[np.ndarray, "4 4"]
    goal_to_wrist: float
    goal_to_gaze: float


@dataclass
class ReleasedDataset:
    """One dataset of a release, measured; its report grows while it is read.

    Attributes:
        files: Arrays by kind (``motions`` …) and number.
        first_frame: Number that the release gives to the first frame of a motion: 0 or 1.
    """

    folder: Path
    files: dict[str, dict[int, Path]]
    report: ImportReport
    fps: float = 0.0
    first_frame: int = 0
    sequences: list[ReleasedSequence] = field(default_factory=list)

    def value(self, fields: Mapping[str, Any], canonical: str) -> Any:
        """Return the value of a canonical field in an entry; None where it has none."""
        return fields.get(self.report.fields.get(canonical, ""))


def read_release(
    report: ImportReport, folder: Path, options: ImportOptions, progress: Progress, command: str
) -> ReleasedDataset:
    """Read and measure every sequence of one dataset.

    Args:
        report: Report on the dataset, in which everything is put down that is found out.
        folder: Its folder in the release.
        options: Statements of the user.
        progress: Called with the dataset and the step that begins.
        command: The command line of this import, for messages that say how to go on.

    Raises:
        InputFileError: if a file is missing or damaged, a field is missing or not the user's, no sequence is whole,
            nothing tells the frame rate, or people have an impossible size; with ``on_error="fail"`` for the first
            sequence that is not whole.
    """
    found = ReleasedDataset(folder, layout.list_files(folder), report)
    progress(report.dataset, f"reading {layout.TARGETS}")
    entries = layout.read_targets(folder / layout.TARGETS, options.field_map)
    report.fields = _map_fields(folder / layout.TARGETS, entries, options.field_map, command)
    names = {name for fields in entries.values() for name in fields}
    report.fields_kept_in_extra = sorted(names - set(report.fields.values()))
    if "text" not in report.fields:
        others = ", ".join(report.fields_kept_in_extra[:_EXAMPLES])
        report.warnings.append(f"the prompt has no known name: --field-map text=NAME says it (other fields: {others})")
    _tell_frames(found, list(entries.values()), options.fps, command)
    progress(report.dataset, f"measuring {len(entries)} sequences")
    for key, fields in entries.items():
        _read_sequence(found, key, fields)
    for index in sorted(set(found.files[layout.MOTIONS]) - {layout.index_of(key) for key in entries}):
        report.note(f"{index:010d}", f"a motion without an entry in {layout.TARGETS}", left_out=True)
    left_out = report.reasons
    if left_out and (options.on_error == "fail" or not found.sequences):
        key, reason = next(iter(left_out.items()))
        more = f" (and {len(left_out) - 1} more sequences)" if len(left_out) > 1 else ""
        raise InputFileError(folder, f"sequence {key}", expected="a complete sequence", found=reason + more)
    _judge(found)
    return found


def _map_fields(
    where: Path, entries: Mapping[str, Mapping[str, Any]], given: Mapping[str, str], command: str
) -> dict[str, str]:
    """Return the field of the release by canonical name: the user's choice, else the field with a known name.

    Raises:
        InputFileError: if the user names a field that is not there, or if two names of a field that is needed are
            there, or none; shows the fields with a value of each, and the command that says which is which.
    """
    known = layout.load_known()
    values: dict[str, list[Any]] = {}
    for fields in entries.values():
        for name, value in fields.items():
            values.setdefault(name, []).append(value)
    mapping = {canonical: name for canonical, name in given.items() if name in values}
    fitting = {
        canonical: [name for name in values if layout.letters(name) in aliases and name not in mapping.values()]
        for canonical, aliases in known.fields.items()
        if canonical not in given
    }
    # Guessing between two goals or two splits would silently give a wrong benchmark.
    unclear = [name for name in known.required_fields if name in fitting and len(fitting[name]) != 1]
    absent = [canonical for canonical in given if canonical not in mapping and canonical != layout.SEQUENCE]
    if unclear or absent:
        said = [f"{canonical}={name}" for canonical, name in mapping.items()]
        for canonical in (*absent, *unclear):
            # A proposal for the command line only: the user decides.
            free = [name for name in values if name not in mapping.values() and _fits(canonical, values[name])]
            proposed = fitting.get(canonical) or free
            said.append(f"{canonical}={proposed[0] if proposed else 'NAME'}")
        texts = {name: json.dumps(found[0], ensure_ascii=False) for name, found in values.items()}
        shown = [f"{quoted(name, longest=60)} ({quoted(text, longest=40)})" for name, text in texts.items()]
        more = f" and {len(shown) - _EXAMPLES} more" if len(shown) > _EXAMPLES else ""
        first = (*absent, *unclear)[0]
        several = fitting.get(first, [])
        raise InputFileError(
            where,
            " and ".join((*absent, *unclear)),
            expected=f"the field '{given[first]}'" if first in given else "one field of a known name",
            found=f"{len(several)}: {', '.join(several)}" if several else "none",
            remedy=f"The fields, with a value of each: {', '.join(shown[:_EXAMPLES])}{more}. Say which is which:"
            f" {command} {' '.join(f'--field-map {shlex.quote(each)}' for each in said)}",
        )
    for canonical, names in fitting.items():
        if names:
            aliases = known.fields[canonical]
            mapping[canonical] = min(names, key=lambda name: aliases.index(layout.letters(name)))
    return mapping


def _fits(canonical: str, values: list[Any]) -> bool:
    """Return True where all values of a field are such as the canonical field has."""
    if canonical == "goal":
        return all(_point(value) is not None for value in values)
    if canonical == "subset":
        return all(isinstance(value, bool) or str(value).strip().lower() in layout.SUBSETS for value in values)
    numbers = [_number(value) for value in values]
    return canonical == "primed_frame" and all(number is not None and number % 1 == 0 for number in numbers)


def _tell_frames(found: ReleasedDataset, entries: list[dict[str, Any]], given: float | None, command: str) -> None:
    """Find out the frame rate, and whether frames count from 0 or 1, from the primed frames.

    A sequence begins 2 s before its prime, so most primed frames tell the rate. The user's rate and a stated one go
    first.

    Raises:
        InputFileError: if nothing tells the rate.
    """
    known = layout.load_known()

    def numbers(canonical: str) -> list[float]:
        values = (_number(found.value(entry, canonical)) for entry in entries)
        return [number for number in values if number is not None]

    rates = set(numbers("fps"))
    primes = np.array(numbers("primed_frame"))
    mode = Counter(primes.tolist()).most_common(1)[0][0] if len(primes) else 0.0
    agreeing = np.mean(np.abs(primes - mode) <= 1) if len(primes) else 0.0
    nearest = min(known.frame_rates, key=lambda rate: abs(mode / _LEAD - rate))
    near = abs(mode / _LEAD - nearest) <= known.frame_rate_tolerance * nearest
    said = f"most frequent primed frame, 2 s after the start: {mode:g}"
    if given is not None:
        found.fps = given
        found.report.infer("fps", f"{given:g}", "certain", f"given; {said}")
    elif len(rates) == 1 and min(rates) > 0:
        found.fps = min(rates)
        found.report.infer("fps", f"{found.fps:g}", "certain", "stated by the entries")
    else:
        expected = f"one stated rate, or primed frames 2 s after the start at {known.frame_rates} Hz"
        measured = f"the rates {sorted(rates)}" if rates else said
        told = not rates and near and agreeing >= known.agreeing_primes
        require(found.folder, (told, "frame rate", expected, measured, f"Say what it is: {command} --fps N"))
        found.fps = nearest
        found.report.infer("fps", f"{nearest:g}", "assumed", said)
    # The prime is at most 2 s after the first frame, so frames that count from 0 cannot be later.
    latest = round(_LEAD * found.fps)
    share = float(np.mean(primes == latest + 1)) if len(primes) else 0.0
    evidence = f"{share:.0%} of the primed frames are {latest + 1}, one after 2 s; {np.sum(primes > latest + 1)} later"
    found.first_frame = int(share >= known.later_primes and bool((primes >= 1).all() and (primes <= latest + 1).all()))
    found.report.infer("first_frame", str(found.first_frame), "assumed", evidence)


def _read_sequence(found: ReleasedDataset, key: str, fields: Mapping[str, Any]) -> None:
    """Read and measure one sequence; all problems of it are noted, so that a user sees them at once."""
    index = layout.index_of(key)
    if index is None:
        found.report.note(key, "an entry without a motion: its key holds no number", left_out=True)
        return
    goal = _point(found.value(fields, "goal"))
    subset = _subset(found.report.fields["subset"], found.value(fields, "subset"))
    primed = _number(found.value(fields, "primed_frame"))
    for name, expected, read in (
        ("goal", "three finite numbers", goal),
        ("subset", "train or test", subset),
        ("primed_frame", "a number", primed),
    ):
        if read is None:
            value = found.value(fields, name)
            shown = "nothing" if value is None else quoted(repr(value), longest=60)
            found.report.note(key, f"{name.replace('_', ' ')}: expected {expected}, found {shown}", left_out=True)
    motion = _read_motion(found, key, index)
    if goal is None or subset is None or primed is None or motion is None:
        return
    joints, motion_from_canonical = motion
    n_frames = len(joints)
    frame = primed - found.first_frame
    if frame != round(frame) or not 0 <= frame < n_frames:
        last = n_frames - 1 + found.first_frame
        text = f"primed frame: expected one of {found.first_frame} to {last}, found {primed:g}"
        found.report.note(key, text, left_out=True)
        return
    files = [found.files[layout.MOTIONS][index]]
    gaze = _read_gaze(found, key, index, n_frames)
    if gaze is not None:
        files.append(found.files[layout.GAZES][index])
    directions, valid = clean_gaze(gaze, n_frames)
    distance = math.nan
    if valid[round(frame)]:
        to_goal = goal - joints[round(frame), Joint.HEAD]
        along = max(float(to_goal @ directions[round(frame)]), 0.0)
        distance = float(np.linalg.norm(to_goal - along * directions[round(frame)]))
    trunk = joints[:, Joint.HEAD] - joints[:, Joint.PELVIS]
    size = float(np.median(np.linalg.norm(trunk, axis=1)))
    upright = float(np.median(trunk[:, 1])) / size if size else 0.0
    to_wrist = float(np.linalg.norm(joints[-1, WRISTS] - goal, axis=1).min())
    stated = found.value(fields, "source")
    source = (stated.strip() if isinstance(stated, str) else "") or f"unknown-{subset}"
    content = (fields, index, files[0], None if gaze is None else files[1], n_frames, goal, subset, round(frame))
    measured = (size, upright, motion_from_canonical, to_wrist, distance)
    found.sequences.append(ReleasedSequence(*content, source, text_digest(*map(file_digest, files)), *measured))


def _read_array(found: ReleasedDataset, kind: str, index: int, per_frame: tuple[int, ...]) -> np.ndarray | str:
    """Return an array of a sequence, or what is wrong with it."""
    path = found.files[kind].get(index)
    if path is None:
        return f"no file in {kind}"
    try:
        return layout.read_array(path, per_frame)
    except InputFileError as error:
        return f"expected {error.expected}, found {error.found}"


def _read_motion(found: ReleasedDataset, key: str, index: int) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the joints of a sequence and the pose of its canonical frame; None if it is unusable."""
    joints = _read_array(found, layout.MOTIONS, index, (22, 3))
    if isinstance(joints, str):
        problem = joints
    elif len(joints) < 2:
        problem = f"expected 2 frames or more, found {len(joints)}"
    elif not np.isfinite(joints).all():
        problem = "expected finite numbers, found NaN or infinity"
    else:
        rules = layout.load_known()
        try:
            pose = canonical_frame(joints.astype(np.float64))
            # The matrix is a turn about y and a shift, so two entries hold the whole angle.
            yaw = np.degrees(np.arctan2(pose[0, 2], pose[0, 0]))
            near = np.abs(pose[:3, 3]).max() <= rules.canonical_position and abs(yaw) <= rules.canonical_yaw_deg
            return joints.astype(np.float64), np.eye(4) if near else pose
        except ValueError:
            problem = "its first pose has no heading, hips and shoulders lie on one vertical line"
    found.report.note(key, f"motion: {problem}", left_out=True)
    return None


def _read_gaze(found: ReleasedDataset, key: str, index: int, n_frames: int) -> np.ndarray | None:
    """Return the gaze of a sequence; None where its file is missing or wrong, which costs the gaze."""
    gaze = _read_array(found, layout.GAZES, index, (3,))
    if isinstance(gaze, np.ndarray) and len(gaze) == n_frames:
        if not clean_gaze(gaze, n_frames)[1].any():
            found.report.note(key, "gaze: no frame has a unit vector")
        return gaze
    problem = gaze if isinstance(gaze, str) else f"expected {n_frames} frames like the motion, found {len(gaze)}"
    found.report.note(key, f"gaze: {problem}: no gaze")
    return None


def _judge(found: ReleasedDataset) -> None:
    """Check that people have the size of people in metres and stand along y, and tell the frames of motions and goals.

    Raises:
        InputFileError: if they have not that size, or lie.
    """
    rules = layout.load_known()
    size = float(np.median([each.pelvis_to_head for each in found.sequences]))
    upright = float(np.median([each.upright for each in found.sequences]))
    span = f"{rules.lowest_pelvis_to_head:g} to {rules.highest_pelvis_to_head:g} m"
    remedy = "Turn positions and goals into metres, y up, and check that the 22 joints are in HumanML3D's order."
    require(
        found.folder,
        # Bodies differ by some per cent, units by factors of ten: the distance from pelvis to head tells them apart.
        (rules.lowest_pelvis_to_head <= size <= rules.highest_pelvis_to_head, "motions",
         f"a median distance from pelvis to head of {span}", f"{size:.3g}", remedy),
        (upright >= rules.lowest_upright, "motions", "heads above pelvises, along y",
         f"{upright:.0%} of the distance from pelvis to head along y", remedy),
    )  # fmt: skip
    found.report.infer("units", "metres", "likely", f"median distance from pelvis to head: {size:.3g}")
    share = float(np.mean([(each.motion_from_canonical == np.eye(4)).all() for each in found.sequences]))
    evidence = f"frame 0 stands over the origin, faces +z, lowest joint at 0 in {share:.1%} of the sequences"
    frame = {1.0: "canonical", 0.0: "world (canonicalised here)"}.get(share, "canonical and world")
    found.report.infer("motion_frame", frame, "certain", evidence)
    distance = float(np.median([each.goal_to_wrist for each in found.sequences]))
    looks = np.array([each.goal_to_gaze for each in found.sequences if math.isfinite(each.goal_to_gaze)])
    towards = float(np.mean(looks <= rules.goal_to_gaze)) if len(looks) else 0.0
    by_gaze = f"at the primed frame the ray passes within {rules.goal_to_gaze:g} m of the goal in {towards:.0%}"
    for name, agrees, evidence in (
        ("goal_frame", distance < rules.goal_to_wrist,
         f"median distance of goal and nearer wrist in the last frame: {distance:.2f} m, of {rules.goal_to_wrist:g} m"),
        ("gaze_frame", towards >= 0.5, by_gaze),
    ):  # fmt: skip
        value = AS_THE_MOTIONS if agrees else UNKNOWN
        found.report.infer(name, value, "likely" if agrees else "unknown", evidence)
    if len(looks) and towards < 0.5:
        found.report.warnings.append(f"gaze: {by_gaze} of the sequences; check axes, primed frames and frame rate.")


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


def _point(value: Any) -> np.ndarray | None:
    """Return three finite numbers, from a list (perhaps in a list) or by the names of the axes; else None."""
    if isinstance(value, list) and len(value) == 1:
        value = value[0]
    if not isinstance(value, dict | list) or not layout.is_point(value):
        return None
    parts = value if isinstance(value, list) else [value[name] for name in sorted(value, key=str.lower)]
    numbers = [_number(part) for part in parts]
    return None if None in numbers else np.array(numbers, dtype=np.float64)


def _subset(name: str, value: Any) -> str | None:
    """Return the subset that a value means; a truth value means what its field is named after (``is_train``)."""
    if value in (True, False):
        words = [word for word in ("train", "test") if word in layout.letters(name)]
        if len(words) != 1:
            return None
        return words[0] if value else {"train": "test", "test": "train"}[words[0]]
    return layout.SUBSETS.get(str(value).strip().lower())


def _number(value: Any) -> float | None:
    """Return a finite number, None for anything else; in Python True is an int, in a release it is no number."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return None
    try:
        number = float(value)
    except (OverflowError, ValueError):
        return None
    return number if math.isfinite(number) else None
