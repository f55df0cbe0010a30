"""The ids of sequences: ``dataset/recording/object/action/event/pose source``."""

from __future__ import annotations

from collections.abc import Sequence


def recording_key(sequence_id: str) -> str:
    """Dataset and recording of a sequence: its id without object, action, event and pose source."""
    return sequence_id.rsplit("/", 4)[0]


def names_its_recording(sequence_ids: Sequence[str]) -> bool:
    """Return True where ids have all six parts; those of an imported release have three."""
    parts = {name.count("/") + 1 for name in sequence_ids}
    return len(parts) == 1 and min(parts) >= 6
