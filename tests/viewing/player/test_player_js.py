"""The player's scripts in a real browser, with documents made by hand."""

from __future__ import annotations

import hashlib
import tomllib
from pathlib import Path

import prbench.viewing.player

PLAYER = Path(prbench.viewing.player.__file__).parent


def test_vendored_three_is_the_file_that_its_record_names_and_leaves_room_for_the_player() -> None:
    folder = PLAYER / "vendor" / "three"
    record = tomllib.loads((folder / "vendored.toml").read_text("utf-8"))
    script = (folder / "three.js").read_bytes()
    assert hashlib.sha256(script).hexdigest() == record["sha256"]
    own = sum(len(path.read_bytes()) for path in PLAYER.glob("*.js"))
    assert len(script) + own <= 700 * 1024
