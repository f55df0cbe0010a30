"""What the authors say of their release, and the numbers by which an import judges what it finds."""

from __future__ import annotations

from functools import cache

import msgspec

from prbench.manifests import read_toml

SYNTHETIC_PREFIX = "synthetic-"


class KnownDataset(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One dataset of the study: its folder, sequences, and means in seconds."""

    folder: str
    train: int
    test: int
    duration: float
    duration_sd: float
    prime_gap: float


class PelvisToHead(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Range of the median distance, metres."""

    lowest: float
    highest: float


class GoalRules(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How close goals must be to wrists and gaze, metres."""

    wrist_distance: float
    gaze_distance: float
    gaze_share: float


class CanonicalRules(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """When a motion counts as canonical already."""

    position: float
    yaw_deg: float
    agreeing: float


class GazeRules(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Lengths of gaze vectors."""

    unit_tolerance: float
    renormalised_tolerance: float


class SkeletonRules(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """When bones count as uniform, metres."""

    uniform: float


class KnownRelease(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """``benchmarks/prime_and_reach/release.toml``."""

    frame_rates: tuple[float, ...]
    frame_rate_tolerance: float
    agreeing_primes: float
    mean_precision: float
    pelvis_to_head: PelvisToHead
    goal: GoalRules
    canonical: CanonicalRules
    gaze: GazeRules
    skeleton: SkeletonRules
    datasets: dict[str, KnownDataset]


@cache
def load_known() -> KnownRelease:
    """The constants, read once."""
    return read_toml("prbench_benchmarks.prime_and_reach", "release.toml", KnownRelease)


def dataset_of(folder: str) -> str | None:
    """The dataset that a folder name means (``HD-EPIC``, ``hd_epic`` …, ``synthetic-adt``), or None."""
    name = folder.lower()
    prefix = SYNTHETIC_PREFIX if name.startswith(SYNTHETIC_PREFIX) else ""
    wanted = _letters(name.removeprefix(prefix))
    for dataset in load_known().datasets:
        if _letters(dataset) == wanted:
            return prefix + dataset
    return None


def folder_of(dataset: str) -> str:
    """The name of a dataset's folder in the layout; that of a dataset which the study lacks is its own."""
    known = load_known().datasets.get(dataset)
    return dataset if known is None else known.folder


def _letters(name: str) -> str:
    return "".join(letter for letter in name.lower() if letter.isalnum())
