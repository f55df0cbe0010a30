"""The authors' statements about their release, the names of its fields, and the limits by which an import judges it."""

from __future__ import annotations

import re
from functools import cache

import msgspec

from prbench.protocol.manifests import read_toml

SYNTHETIC_PREFIX = "synthetic-"


class KnownDataset(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One dataset of the study: its folder, and its sequences of each split."""

    folder: str
    train: int
    test: int


class KnownRelease(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """``benchmarks/prime_and_reach/release.toml``, which explains every number."""

    frame_rates: tuple[float, ...]
    frame_rate_tolerance: float
    agreeing_primes: float
    lowest_pelvis_to_head: float
    highest_pelvis_to_head: float
    goal_to_wrist: float
    goal_to_gaze: float
    gazing_share: float
    canonical_position: float
    canonical_yaw_deg: float
    unit_gaze_tolerance: float
    gaze_tolerance: float
    required_fields: tuple[str, ...]
    fields: dict[str, tuple[str, ...]]
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
