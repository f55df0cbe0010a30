"""A few damages before every change; those of all doors are many, and tried at night (``test_fuzz.py``)."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOORS = ("conditions-npz", "configuration", "corrections", "diff", "doctor", "humanml3d", "protocol", "score-padded")


def test_a_sample_of_damages_ends_in_a_message():
    # In an interpreter of its own, because only a process without threads may fork.
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-m", "tests.fuzz", *DOORS, "--mutations", "8", "--seed", "1"],
        cwd=ROOT,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert len(done.stdout.splitlines()) == len(DOORS)
