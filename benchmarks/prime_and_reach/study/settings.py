"""How the study's figures are drawn (``benchmarks/prime_and_reach/study.toml``); nothing here decides a score."""

from __future__ import annotations

from functools import cache

import msgspec

from prbench.protocol.manifests import read_toml


class SweepSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Figure S3."""

    windows: tuple[float, ...]
    """Seconds, one curve each."""
    largest_distance: float
    """End of the axis, metres."""
    distance_step: float
    """Metres."""


class BreakdownSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Figure 4: edges between the groups."""

    distance_edges: tuple[float, ...]
    """Metres on the floor."""
    bearing_edges: tuple[float, ...]
    """Degrees."""
    height_edges: tuple[float, ...]
    """Metres above the floor."""
    gap_edges: tuple[float, ...]
    """Seconds."""


class StudySettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The whole file."""

    figure_s3: SweepSettings
    figure_4: BreakdownSettings


@cache
def load_study_settings() -> StudySettings:
    """Read the settings that come with prbench."""
    return read_toml("prbench_benchmarks.prime_and_reach", "study.toml", StudySettings)
