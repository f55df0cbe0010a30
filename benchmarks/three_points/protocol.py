"""The rules of the benchmark as frozen data classes, read once from its ``protocol.toml``."""

from __future__ import annotations

from functools import cache

import msgspec

from prbench.protocol.manifests import digest_of, read_toml


class TrackRules(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How recordings are cut into tracks: frame rates in frames per second, the rest in seconds."""

    rates: tuple[float, ...]
    shortest: float
    longest: float
    largest_gap: float


class ThreePointsProtocol(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One version of the benchmark's rules; ``joints`` holds the names of the joints of each partial error."""

    version: int
    conditions: tuple[str, ...]
    tracks: TrackRules
    joints: dict[str, tuple[str, ...]]

    @property
    def digest(self) -> str:
        """SHA-256 of the values; equal rules have equal digests, however the file is laid out."""
        return digest_of(self)


@cache
def load_three_points_protocol() -> ThreePointsProtocol:
    """Return the protocol of the benchmark."""
    return read_toml("prbench_benchmarks.three_points", "protocol.toml", ThreePointsProtocol)
