"""The authors' statements about their release, and the limits by which an import judges measurements."""

from __future__ import annotations

import re
from functools import cache

import msgspec

from prbench.protocol.manifests import read_toml

SYNTHETIC_PREFIX = "synthetic-"


class KnownDataset(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One dataset of the study: its folder, sequences, and means in seconds."""

    folder: str
    train: int
    test: int
    duration: float
    duration_sd: float
    prime_gap: float


class _PelvisToHead(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Range of the median distance from pelvis to head, metres."""

    lowest: float
    highest: float


class _GoalRules(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Largest distances of goals from wrists and gaze, metres, and the share of gazes within theirs."""

    wrist_distance: float
    gaze_distance: float
    gaze_share: float


class _CanonicalRules(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Limits within which a motion counts as canonical already: metres, degrees, share of the sequences."""

    position: float
    yaw_deg: float
    agreeing: float


class _GazeRules(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Tolerances of the lengths of gaze vectors."""

    unit_tolerance: float
    renormalised_tolerance: float


class _SkeletonRules(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Largest spread, metres, with which bones count as one skeleton's."""

    uniform: float


class KnownRelease(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """``benchmarks/prime_and_reach/release.toml``."""

    frame_rates: tuple[float, ...]
    frame_rate_tolerance: float
    agreeing_primes: float
    mean_precision: float
    pelvis_to_head: _PelvisToHead
    goal: _GoalRules
    canonical: _CanonicalRules
    gaze: _GazeRules
    skeleton: _SkeletonRules
    datasets: dict[str, KnownDataset]


@cache
def load_known() -> KnownRelease:
    """Read the constants, once."""
    return read_toml("prbench_benchmarks.prime_and_reach", "release.toml", KnownRelease)


def dataset_of(folder: str) -> str | None:
    """Return the dataset that a folder name means (``HD-EPIC``, ``hd_epic`` …, ``synthetic-adt``), or None."""
    # The prefix is cut off before hyphens go, so that a synthetic copy keeps its own name.
    name = folder.lower()
    prefix = SYNTHETIC_PREFIX if name.startswith(SYNTHETIC_PREFIX) else ""
    wanted = letters(name.removeprefix(prefix))
    for dataset in load_known().datasets:
        if letters(dataset) == wanted:
            return prefix + dataset
    return None


def folder_of(dataset: str) -> str:
    """Return the folder name of a dataset; a dataset that is not the study's keeps its own name."""
    known = load_known().datasets.get(dataset)
    return dataset if known is None else known.folder


def letters(name: str) -> str:
    """Return a name in lower case, letters and digits only: ``HD-EPIC`` and ``hd_epic`` become equal."""
    return re.sub(r"[^a-z0-9]", "", str(name).lower())
