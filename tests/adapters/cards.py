"""What every card beside bundled weights has to say of them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from prbench.files.storage import file_digest


def described(weights: Path, *, largest: int) -> dict[str, Any]:
    """Return the card of a weights file, which names it, its digest and synthetic tables alone.

    Args:
        weights: The ``.safetensors`` file.
        largest: Bytes that it may have.
    """
    card = json.loads(weights.with_suffix(".json").read_text("utf-8"))
    assert weights.stat().st_size <= largest
    assert card["weights"] == weights.name
    assert card["weights_sha256"] == file_digest(weights)
    assert all(table["synthetic"] for table in card["data"])
    return card
