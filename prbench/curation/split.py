"""Decide the split of a recording: its own name decides, so a partial copy never moves one.

Source: docs/specification/curation.md#splits.
"""

from __future__ import annotations

from typing import Literal

from prbench.manifests import Manifest, SplitRule
from prbench.randomness import hash_fraction

Split = Literal["train", "validation", "test"]


def split_of(recording_id: str, split_group: str, manifest: Manifest, rule: SplitRule) -> Split:
    """The manifest's lists where they name the recording or its group, else the hash of the group.

    Args:
        recording_id: The recording.
        split_group: Shared by recordings that must not be separated (concurrent twins: the smaller id).
        manifest: The dataset's manifest, for its lists and its name.
        rule: Shares of the hash range.
    """
    listed: dict[Split, tuple[str, ...]] = {
        "test": manifest.test_recordings,
        "validation": manifest.validation_recordings,
        "train": manifest.train_recordings,
    }
    for name in (recording_id, split_group):
        for split, recordings in listed.items():
            if name in recordings:
                return split
    fraction = hash_fraction(manifest.name, split_group)
    if fraction >= rule.test_from:
        return "test"
    return "validation" if fraction < rule.validation_below else "train"
