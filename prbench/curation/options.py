"""What a user may choose about curation; everything here is recorded in ``dataset.json``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from prbench.curation.filters import MEASURES
from prbench.curation.occlusion import OcclusionMode
from prbench.curation.priming import RAY_ORIGINS
from prbench.errors import UsageError
from prbench.manifests import BenchmarkProtocol, InHandRule, Manifest, digest_of
from prbench.meshes import import_open3d

PrimingSource = Literal["rule", "published"]


@dataclass(frozen=True)
class CurationOptions:
    """Choices that change which sequences come out."""

    in_hand: str | None = None
    """Name of one of the manifest's alternative rules; None = the dataset's own."""
    ray_origin: str | None = None
    """``eye`` or ``camera``; None = the protocol's."""
    minimum_movement: str = "wrist_to_goal"
    """Which distance must reach the protocol's minimum; see :data:`prbench.curation.filters.MEASURES`."""
    priming: PrimingSource = "rule"
    """Prime times from gaze by the equations, or taken over from what the dataset itself publishes."""
    occlusion: OcclusionMode = "off"
    """What to do with looks through meshes; see :data:`prbench.curation.occlusion.OcclusionMode`."""

    def __post_init__(self) -> None:
        if self.occlusion not in get_args(OcclusionMode):
            raise UsageError(
                f"unknown treatment of occlusion '{self.occlusion}'; known ones: {', '.join(get_args(OcclusionMode))}."
            )
        if self.occlusion != "off" and self.priming == "published":
            raise UsageError("--occlusion asks about gaze, --priming published takes no gaze: choose one of them.")
        if self.priming not in get_args(PrimingSource):
            raise UsageError(
                f"unknown source of priming '{self.priming}'; known ones: {', '.join(get_args(PrimingSource))}."
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

    def described(self, manifest: Manifest, protocol: BenchmarkProtocol) -> dict[str, str]:
        """The choices as text, as ``dataset.json`` holds them."""
        rule = self.in_hand_rule(manifest)
        return {
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
    """Options of the dataset's reader as name and value, sorted by name (:mod:`prbench.readers.options`)."""
    on_error: Literal["skip", "fail"] = "skip"
    """Whether a recording that cannot be read is reported while the others go on, or ends the build."""
    replace: bool = False
    """Replace a table that holds recordings which the new one lacks (:mod:`prbench.sequences.replacing`)."""


NO_OPTIONS = BuildOptions()
"""Every recording, curated by the defaults."""
