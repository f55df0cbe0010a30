"""Sequences of a release before their arrays are read: each entry with its files, both checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from prbench.errors import InputFileError
from prbench.release.block import require_frames, scan_header
from prbench.release.entries import Entries, Entry
from prbench.release.layout import DatasetFiles
from prbench.release.report import Problem
from prbench.release.values import Goal, parse_goal, parse_number, parse_subset


@dataclass(frozen=True)
class Candidate:
    """One sequence with its files; its entry is checked, its arrays are known by their headers only."""

    index: int
    entry: Entry
    motion: Path
    gaze: Path | None
    further: Path | None
    n_frames: int
    goal: Goal
    subset: str
    primed: float
    """The value as the release writes it: a frame counted from 0 or from 1, or seconds."""


@dataclass
class Found:
    """All candidates of a dataset and all problems, collected while the files are searched."""

    candidates: list[Candidate] = field(default_factory=list)
    problems: list[Problem] = field(default_factory=list)

    def report(self, key: str, message: str, *, left_out: bool = True) -> None:
        """Note a problem of a sequence."""
        self.problems.append(Problem(key, message, left_out))

    @property
    def left_out(self) -> dict[str, str]:
        """Maps every sequence that was left out to all its problems."""
        reasons: dict[str, list[str]] = {}
        for problem in self.problems:
            if problem.left_out:
                reasons.setdefault(problem.key, []).append(problem.message)
        return {key: "; ".join(texts) for key, texts in reasons.items()}


def find_candidates(entries: Entries, files: DatasetFiles, mapping: Mapping[str, str]) -> Found:
    """Match entries with files and check both; every problem of every sequence is collected.

    Args:
        entries: Entries of ``target_information.json``.
        files: Arrays by number.
        mapping: Maps canonical names to fields of the release.
    """
    found = Found()
    numbers = _numbers(entries, files, found)
    for entry in entries.entries:
        index = numbers.get(entry.key)
        if index is None:
            found.report(entry.key, "an entry without a motion: its key holds no number")
            continue
        candidate = _candidate(entry, index, files, mapping, found)
        if candidate is not None:
            found.candidates.append(candidate)
    for index in sorted(set(files.motions) - set(numbers.values())):
        found.report(f"{index:010d}", "a motion without an entry in target_information.json")
    return found


def _numbers(entries: Entries, files: DatasetFiles, found: Found) -> dict[str, int]:
    """Map keys to numbers; keys without a number get the remaining files in order, if there are as many."""
    numbers = {entry.key: entry.index for entry in entries.entries if entry.index is not None}
    unnumbered = [entry.key for entry in entries.entries if entry.index is None]
    free = sorted(set(files.motions) - set(numbers.values()))
    # Only where they pair up without remainder; otherwise nothing says which file is whose.
    if len(unnumbered) == len(free):
        numbers |= dict(zip(unnumbered, free))
        for key in unnumbered:
            found.report(key, "a key without a number: matched with the files by order", left_out=False)
    return numbers


def _candidate(
    entry: Entry, index: int, files: DatasetFiles, mapping: Mapping[str, str], found: Found
) -> Candidate | None:
    # All checks run, so that a user sees every problem of a sequence at once; whether one was fatal shows afterwards.
    before = len(found.left_out)
    n_frames = _length_of_motion(entry.key, files.motions.get(index), found)
    goal, subset, primed = _targets(entry, mapping, found)
    gaze = _gaze_file(entry.key, files.gazes.get(index), n_frames, found)
    if len(found.left_out) > before or goal is None or subset is None or primed is None or n_frames is None:
        return None
    further = files.further.get(index)
    return Candidate(index, entry, files.motions[index], gaze, further, n_frames, goal, subset, primed)


def _length_of_motion(key: str, path: Path | None, found: Found) -> int | None:
    if path is None:
        found.report(key, "no file in motions")
        return None
    try:
        n_frames = require_frames(path, scan_header(path), (22, 3))
    except InputFileError as error:
        found.report(key, _expectation(error, "motion"))
        return None
    if n_frames < 2:
        found.report(key, f"motion: expected 2 frames or more, found {n_frames}")
    return n_frames


def _gaze_file(key: str, path: Path | None, n_frames: int | None, found: Found) -> Path | None:
    """Return the gaze file if it is usable with a motion of this length; one frame more or less is tolerated."""
    if path is None:
        found.report(key, "no file in gazes: no gaze", left_out=False)
        return None
    try:
        rows = require_frames(path, scan_header(path), (3,))
    except InputFileError as error:
        found.report(key, f"{_expectation(error, 'gaze')}: no gaze", left_out=False)
        return None
    if n_frames is None or rows == n_frames:
        return path
    # Whether a sequence includes its event frame is not stated; gaze and motion may have been cut differently.
    if abs(rows - n_frames) == 1:
        found.report(key, f"gaze: one frame {'more' if rows > n_frames else 'less'} than the motion", left_out=False)
        return path
    found.report(key, f"gaze: expected {n_frames} frames like the motion, found {rows}: no gaze", left_out=False)
    return None


def _targets(entry: Entry, mapping: Mapping[str, str], found: Found) -> tuple[Goal | None, str | None, float | None]:
    def value(canonical: str) -> Any:
        return entry.fields.get(mapping[canonical])

    goal = parse_goal(value("goal"))
    if goal is None:
        found.report(entry.key, f"goal: expected three finite numbers, found {_shown(value('goal'))}")
    subset = parse_subset(value("subset"), mapping["subset"])
    if subset is None:
        found.report(entry.key, f"subset: expected train or test, found {_shown(value('subset'))}")
    primed = parse_number(value("primed_frame"))
    if primed is None:
        found.report(entry.key, f"primed frame: expected a number, found {_shown(value('primed_frame'))}")
    return goal, subset, primed


def _expectation(error: InputFileError, name: str) -> str:
    return f"{name}: expected {error.expected}, found {error.found}"


def _shown(value: Any) -> str:
    text = "nothing" if value is None else repr(value)
    return text if len(text) <= 60 else f"{text[:57]}…"
