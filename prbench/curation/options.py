"""The options of curation and of a build, all recorded in ``dataset.json``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from prbench.curation.corrections import Corrections, read_corrections
from prbench.curation.mending import Numbers, stream_numbers
from prbench.curation.priming import RAY_ORIGINS
from prbench.datasets import OWN, layout_of
from prbench.errors import UsageError
from prbench.geometry.shapes import import_open3d
from prbench.protocol.manifests import BenchmarkProtocol, Manifest, digest_of, load_manifest, read_own_manifest

# What each option of curation may be.
_CHOICES = {
    "minimum_movement": ("wrist_to_goal", "pelvis_displacement", "object_displacement"),
    "priming": ("rule", "published"),
    "ray_origin": (None, *RAY_ORIGINS),
}


@dataclass(frozen=True)
class CurationOptions:
    """Choices that change which sequences come out.

    Attributes:
        in_hand: Name of one of the manifest's alternative rules; None = the dataset's own.
        ray_origin: ``eye`` or ``camera``; None = the protocol's.
        minimum_movement: Distance that must reach the protocol's minimum: ``wrist_to_goal``, ``pelvis_displacement`` or
            ``object_displacement``.
        priming: Prime times from gaze by the equations, or taken over from what the dataset itself publishes.
        min_confidence: Smallest ``event_confidence`` of a sequence, from 0 to 1; 0 takes every one.
        shift: Seconds that are added to the times of streams, by name (:data:`prbench.curation.mending.STREAMS`).
        scale: Factors on the positions of streams, by name.
    """

    in_hand: str | None = None
    ray_origin: str | None = None
    minimum_movement: str = "wrist_to_goal"
    priming: Literal["rule", "published"] = "rule"
    min_confidence: float = 0.0
    shift: Numbers = ()
    scale: Numbers = ()

    def __post_init__(self) -> None:
        if not 0 <= self.min_confidence <= 1:
            raise UsageError(f"a smallest confidence lies from 0 to 1, found {self.min_confidence:g}.")
        for name, known in _CHOICES.items():
            if getattr(self, name) not in known:
                choices = ", ".join(each for each in known if each)
                raise UsageError(f"unknown {name.replace('_', ' ')} '{getattr(self, name)}'; known ones: {choices}.")

    def require_fits(self, manifest: Manifest) -> None:
        """Refuse, before anything is read, what a dataset does not have.

        Raises:
            UsageError: for an in-hand rule that the manifest does not list, or published priming of a dataset without.
            MissingExtraError: if hands are to be compared with meshes, and Open3D is not installed.
        """
        rule = manifest.in_hand_rule(self.in_hand)
        if rule is not None and rule.target == "surface":
            import_open3d(f"the in-hand rule '{self.in_hand or 'default'}'")
        if self.priming == "published" and not manifest.publishes_priming:
            lacks = f"{manifest.name} publishes no priming of its own, so --priming published is impossible"
            raise UsageError(f"{lacks}; leave the option out: the rule applies the equations to its gaze.")

    def described(self, manifest: Manifest, protocol: BenchmarkProtocol) -> dict[str, str]:
        """Return the choices as text, as ``dataset.json`` holds them."""
        rule = manifest.in_hand_rule(self.in_hand)
        # Named where it is asked for only: tables of the default keep their bytes.
        shortest = protocol.curation.minimum_prime
        chosen = {"minimum_prime": f"{shortest:g}"} if shortest > 0 else {}
        chosen |= {"min_confidence": f"{self.min_confidence:g}"} if self.min_confidence > 0 else {}
        for option in ("shift", "scale"):
            chosen |= {f"{option}.{stream}": f"{number:g}" for stream, number in getattr(self, option)}
        chosen |= {"in_hand_rule": "none" if rule is None else self.in_hand or "default"}
        chosen |= {"in_hand_rule_digest": "" if rule is None else digest_of(rule)}
        chosen |= {"ray_origin": self.ray_origin or protocol.curation.ray_origin, "priming": self.priming}
        # Occlusion was a choice of prbench 0.10; tables keep their bytes.
        return chosen | {"minimum_movement": self.minimum_movement, "occlusion": "off"}


# The dataset's own rule and the protocol's choices.
DEFAULTS = CurationOptions()


@dataclass(frozen=True)
class BuildOptions:
    """Choices about a whole build.

    Attributes:
        curation: Choices that change which sequences come out.
        recordings: Glob over recording ids.
        limit: Only the first so many recordings, by name.
        reader: Options of the dataset's reader as name and value, sorted by name (:mod:`prbench.readers`).
        on_error: ``skip`` reports a recording that cannot be read while the others go on, ``fail`` ends the build.
        protocol: The user's own protocol (:func:`prbench.protocol.own_protocol.read_protocol`); None = prbench's.
        replace: Replace a table that holds recordings which the new one lacks (:mod:`prbench.sequences.write`).
        corrections: A person's corrections of events.
    """

    curation: CurationOptions = DEFAULTS
    recordings: str = "*"
    limit: int | None = None
    reader: tuple[tuple[str, str], ...] = ()
    on_error: Literal["skip", "fail"] = "skip"
    protocol: BenchmarkProtocol | None = None
    replace: bool = False
    corrections: Corrections | None = None

    def manifest_of(self, dataset: str) -> Manifest:
        """Return the manifest that a dataset is built by: of own recordings the user's, where there is one.

        Raises:
            InputFileError: if the user's is none.
        """
        chosen = dict(self.reader).get("manifest") if layout_of(dataset) == OWN else None
        return load_manifest(layout_of(dataset)) if chosen is None else read_own_manifest(Path(chosen).expanduser())

    @property
    def packages(self) -> tuple[str, ...]:
        """Distributions that reading needs beside prbench's own."""
        return ("open3d",) if dict(self.reader).get("meshes") == "true" else ()


# Every recording, curated by the defaults.
NO_OPTIONS = BuildOptions()


def build_options(
    *,
    recordings: str,
    max_recordings: int | None,
    protocol: Path | None,
    option: Mapping[str, str],
    on_error: Literal["skip", "fail"],
    replace: bool,
    corrections: Path | None,
    events_only: bool,
    **curation: Any,
) -> BuildOptions:
    """Make the options of a build from what a command line or a program says.

    Args:
        recordings: Glob over recording ids.
        max_recordings: Only the first so many recordings, by name.
        protocol: File of a protocol of the user's own.
        option: Options of the dataset's reader by name.
        on_error: See :class:`BuildOptions`.
        replace: See :class:`BuildOptions`.
        corrections: File of corrections.
        events_only: List annotated events alone, without any stream.
        curation: Fields of :class:`CurationOptions`; ``shift`` and ``scale`` map streams to texts or numbers.

    Raises:
        UsageError: for an unknown choice.
        InputFileError: if the protocol or the corrections cannot be read.
    """
    from prbench.protocol.own_protocol import read_protocol

    curation |= {name: stream_numbers(curation[name] or {}, name) for name in ("shift", "scale")}
    # Readers load meshes only where a rule asks for the surfaces of objects.
    implied = {"meshes": "true"} if curation["in_hand"] == "surface" else {}
    if events_only:
        implied["events_only"] = "true"
    return BuildOptions(
        curation=CurationOptions(**curation),
        recordings=recordings,
        limit=max_recordings,
        reader=tuple(sorted((implied | dict(option)).items())),
        on_error=on_error,
        protocol=None if protocol is None else read_protocol(protocol),
        replace=replace,
        corrections=None if corrections is None else read_corrections(corrections),
    )
