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
LAYOUTS = ("adt", "gimo", "hd-epic", "hot3d", "mogaze")
OTHERS = (
    "adt-egoallo", "nymeria", "humanml3d", "conditions-npz", "conditions-parquet", "weights", "configuration",
    "method-description", "build-adt", "build-gimo", "build-hd-epic", "build-hot3d", "build-mogaze", "build-corpus",
    "stats", "diff", "run", "board", "import-release", "score-flat", "score-padded", "score-ragged", "score-named",
    "score-numbered",
)  # fmt: skip
DAMAGES_OF_A_LAYOUT = 100
DAMAGES_OF_ANOTHER_DOOR = 10


@pytest.mark.parametrize("door", [*LAYOUTS, *OTHERS])
def test_no_damage_ends_in_a_traceback_a_hang_or_a_silent_change(door):
    usual = DAMAGES_OF_A_LAYOUT if door in LAYOUTS else DAMAGES_OF_ANOTHER_DOOR
    mutations = os.environ.get("PRBENCH_FUZZ", str(usual))
    seed = os.environ.get("PRBENCH_FUZZ_SEED", "1")
    # In an interpreter of its own, because only a process without threads may fork.
    done = subprocess.run(
        [sys.executable, "-m", "tests.fuzz", door, "--mutations", mutations, "--seed", seed],
        cwd=ROOT,
        env=os.environ | {"OMP_NUM_THREADS": "1", "PRBENCH_PARSE_CACHE": "off"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
