"""Damaged files end in a message or in a result that tells of the damage, whatever the damage is.

`PRBENCH_FUZZ=N` sets the number of damages of each door and `PRBENCH_FUZZ_SEED` chooses others.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.fuzz

ROOT = Path(__file__).parents[2]
DAMAGES = {
    "adt": 100,
    "gimo": 100,
    "hd-epic": 100,
    "hot3d": 100,
    "mogaze": 100,
    "own": 100,
    "adt-egoallo nymeria humanml3d conditions-npz weights configuration method-description corrections protocol": 12,
    "build-adt build-gimo build-hd-epic build-hot3d build-mogaze build-own build-corpus": 4,
    "inspect diff run board board-data score-run import-release verify submission": 12,
    "score-flat score-padded score-ragged doctor windows experiment": 12,
}
"""How often files are damaged before each door; doors that share a line share a process."""


def test_every_door_is_tried():
    from tests.fuzz.doors import COMMANDS, READERS

    assert sorted(" ".join(DAMAGES).split()) == sorted(door.name for door in (*READERS, *COMMANDS))


@pytest.mark.parametrize("doors", DAMAGES)
def test_no_damage_ends_in_a_traceback_a_hang_or_a_silent_change(doors):
    mutations = os.environ.get("PRBENCH_FUZZ", str(DAMAGES[doors]))
    seed = os.environ.get("PRBENCH_FUZZ_SEED", "1")
    # In an interpreter of its own, because only a process without threads may fork.
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-m", "tests.fuzz", *doors.split(), "--mutations", mutations, "--seed", seed],
        cwd=ROOT,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
