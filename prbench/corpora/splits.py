"""Splits of corpora: by participant, whose name alone decides, so that a partial copy never moves anybody."""

from __future__ import annotations

from typing import Literal

from prbench.manifests import Manifest
from prbench.randomness import hash_fraction


def split_by_participant(manifest: Manifest, participant_id: str) -> Literal["train", "validation", "test"]:
    """The manifest's shares of sha256(dataset/participant) / 2**256."""
    fraction = hash_fraction(manifest.name, participant_id)
    if fraction >= manifest.thresholds["test_from"]:
        return "test"
    return "validation" if fraction < manifest.thresholds["validation_below"] else "train"
