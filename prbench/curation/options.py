"""The options of curation and of a build, all recorded in ``dataset.json``.

Among them is the minimum-movement filter (*Prime and Reach*, section B.1) with its alternatives.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import msgspec
import numpy as np

from prbench.curation.clipping import Clip
from prbench.curation.events import Decision, PickPutEvent, Place
from prbench.curation.priming import RAY_ORIGINS, OcclusionMode
from prbench.errors import UsageError
from prbench.geometry.shapes import import_open3d
from prbench.geometry.skeleton import WRISTS
from prbench.protocol.manifests import BenchmarkProtocol, CurationConstants, InHandRule, Manifest, digest_of
from prbench.sequences.table import body_movement

_PrimingSource = Literal["rule", "published"]


def wrist_to_goal(clip: Clip, _event: PickPutEvent, place: Place) -> float | None:
    """Distance of the nearer wrist of the first frame to the goal: the protocol's reading of the paper."""
    return float(np.linalg.norm(clip.joints[0, WRISTS] - place.location, axis=1).min())


def pelvis_displacement(clip: Clip, _event: PickPutEvent, _place: Place) -> float | None:
    """Largest distance of the pelvis from where it was in the first frame."""
    return body_movement(clip.joints)


def object_displacement(_clip: Clip, event: PickPutEvent, _place: Place) -> float | None:
    """Largest distance of the object from its rest; None for annotated events, which the filter then lets pass."""
    return event.displacement


MEASURES: dict[str, Callable[[Clip, PickPutEvent, Place], float | None]] = {
    "wrist_to_goal": wrist_to_goal,
    "pelvis_displacement": pelvis_displacement,
    "object_displacement": object_displacement,
}
"""Maps the option's name to the distance that must reach the protocol's minimum movement."""


def minimum_movement(clip: Clip, event: PickPutEvent, place: Place, *, measure: str, threshold: float) -> Decision:
    """Keep (``sequence``) or drop (``minimum_movement``) a clip; value and threshold in metres."""
    value = MEASURES[measure](clip, event, place)
    outcome = "minimum_movement" if value is not None and value < threshold else "sequence"
    return Decision(outcome, "filters", value, threshold)


@dataclass(frozen=True)
class CurationOptions:
    """Choices that change which sequences come out."""

    in_hand: str | None = None
    """Name of one of the manifest's alternative rules; None = the dataset's own."""
    ray_origin: str | None = None
    """``eye`` or ``camera``; None = the protocol's."""
    minimum_movement: str = "wrist_to_goal"
    """Distance that must reach the protocol's minimum; see :data:`prbench.curation.options.MEASURES`."""
    priming: _PrimingSource = "rule"
    """Prime times from gaze by the equations, or taken over from what the dataset itself publishes."""
    occlusion: OcclusionMode = "off"
    """Treatment of looks through meshes; see :data:`prbench.curation.priming.OcclusionMode`."""
    minimum_prime: float | None = None
    """Seconds that a look must last to prime; None = the protocol's."""

    def __post_init__(self) -> None:
        if self.occlusion not in get_args(OcclusionMode):
            raise UsageError(
                f"unknown treatment of occlusion '{self.occlusion}'; known ones: {', '.join(get_args(OcclusionMode))}."
            )
        if self.occlusion != "off" and self.priming == "published":
            raise UsageError("--occlusion asks about gaze, --priming published takes no gaze: choose one of them.")
        if self.priming not in get_args(_PrimingSource):
            raise UsageError(
                f"unknown source of priming '{self.priming}'; known ones: {', '.join(get_args(_PrimingSource))}."
            )
        if self.minimum_prime is not None and not 0 <= self.minimum_prime < math.inf:
            raise UsageError(f"--minimum-prime: expected seconds, 0 or more, found {self.minimum_prime:g}.")
        if self.minimum_prime and self.priming == "published":
            raise UsageError("--minimum-prime asks about gaze, --priming published takes no gaze: choose one of them.")
        if self.minimum_prime and self.occlusion == "require":
            raise UsageError(
                "--minimum-prime and --occlusion require: which look is the first one that lasts and is unobstructed"
                " is not defined; choose one of them."
            )
        if self.minimum_movement not in MEASURES:
            raise UsageError(
                f"unknown minimum-movement measure '{self.minimum_movement}'; known ones: {', '.join(MEASURES)}."
            )
        if self.ray_origin is not None and self.ray_origin not in RAY_ORIGINS:
            raise UsageError(f"unknown ray origin '{self.ray_origin}'; known ones: {', '.join(RAY_ORIGINS)}.")

    def in_hand_rule(self, manifest: Manifest) -> InHandRule | None:
        """The chosen in-hand rule; None where the dataset annotates its events.

        Raises:
            UsageError: for a name that the manifest does not list.
        """
        return manifest.in_hand_rule(self.in_hand)

    def require_fits(self, manifest: Manifest) -> None:
        """Refuse, before anything is read, what a dataset does not have.

        Raises:
            UsageError: for an in-hand rule that the manifest does not list, or published priming of a dataset without.
            MissingExtraError: if looks or hands are to be compared with meshes, and Open3D is not installed.
        """
        rule = self.in_hand_rule(manifest)
        if self.occlusion != "off":
            import_open3d(f"--occlusion {self.occlusion}")
        if rule is not None and rule.target == "surface":
            import_open3d(f"the in-hand rule '{self.in_hand or 'default'}'")
        if self.priming == "published" and not manifest.publishes_priming:
            raise UsageError(
                f"{manifest.name} publishes no priming of its own, so --priming published is impossible;"
                " leave the option out: the rule applies the equations to its gaze."
            )

    def constants(self, protocol: BenchmarkProtocol) -> CurationConstants:
        """The protocol's numbers, with the user's choice in place of the minimum duration of a prime."""
        if self.minimum_prime is None:
            return protocol.curation
        return msgspec.structs.replace(protocol.curation, minimum_prime=self.minimum_prime)

    def described(self, manifest: Manifest, protocol: BenchmarkProtocol) -> dict[str, str]:
        """The choices as text, as ``dataset.json`` holds them."""
        rule = self.in_hand_rule(manifest)
        # Named where it is asked for only: tables of the default keep their bytes.
        shortest = self.constants(protocol).minimum_prime
        lasting = {"minimum_prime": f"{shortest:g}"} if shortest > 0 else {}
        return lasting | {
            "in_hand_rule": "none" if rule is None else self.in_hand or "default",
            "in_hand_rule_digest": "" if rule is None else digest_of(rule),
            "ray_origin": self.ray_origin or protocol.curation.ray_origin,
            "minimum_movement": self.minimum_movement,
            "priming": self.priming,
            "occlusion": self.occlusion,
        }


DEFAULTS = CurationOptions()
"""The dataset's own rule and the protocol's choices."""


@dataclass(frozen=True)
class BuildOptions:
    """Choices about a whole build."""

    curation: CurationOptions = DEFAULTS
    recordings: str = "*"
    """Glob over recording ids."""
    limit: int | None = None
    """Only the first so many recordings, by name."""
    reader: tuple[tuple[str, str], ...] = ()
    """Options of the dataset's reader as name and value, sorted by name (:mod:`prbench.readers`)."""
    on_error: Literal["skip", "fail"] = "skip"
    """``skip`` reports a recording that cannot be read while the others go on, ``fail`` ends the build."""
    protocol: BenchmarkProtocol | None = None
    """The user's own protocol (:func:`prbench.protocol.own_protocol.read_protocol`); None = prbench's."""
    replace: bool = False
    """Replace a table that holds recordings which the new one lacks (:mod:`prbench.sequences.write`)."""

    @property
    def packages(self) -> tuple[str, ...]:
        """Distributions that reading needs beside prbench's own."""
        return ("open3d",) if dict(self.reader).get("meshes") == "true" else ()


NO_OPTIONS = BuildOptions()
"""Every recording, curated by the defaults."""


def mesh_options(dataset: str | None, *, in_hand: str | None, occlusion: str) -> dict[str, str]:
    """Return the option that asks a dataset's reader for meshes where a choice needs them; it loads none otherwise.

    Args:
        dataset: Name of the dataset; None for whatever is found.
        in_hand: Name of the in-hand rule, if one was chosen.
        occlusion: ``off``, ``mark`` or ``require``.

    Raises:
        UsageError: if the dataset has no meshes.
    """
    from prbench.readers import reader_for

    if in_hand == "surface":
        return {"meshes": "true"}
    if occlusion == "off":
        return {}
    if dataset is not None and "meshes" not in reader_for(dataset).options.names():
        raise UsageError(f"--occlusion needs meshes, and {dataset} has none; leave the option out.")
    return {"meshes": "true"}
