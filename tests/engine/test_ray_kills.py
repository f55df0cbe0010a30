"""Nightly: work on Ray whose workers, node and driver are killed at random moments ends in the bytes of one process.

``PRBENCH_FUZZ_SEED`` chooses other moments.
"""

from __future__ import annotations

import os
import sys

import pytest

from tests.engine.ray_kills import check

pytest.importorskip("ray", reason="Ray is not installed (pip install -c constraints.txt -e '.[ray]')")
pytestmark = [
    pytest.mark.fuzz,
    pytest.mark.skipif("PRBENCH_FUZZ" not in os.environ, reason="takes ten minutes: set PRBENCH_FUZZ to run it"),
    pytest.mark.skipif(sys.platform == "win32", reason="clusters of several nodes on one machine need Linux or macOS"),
]


def test_work_that_is_killed_at_twenty_random_moments_ends_in_the_same_bytes(tmp_path):
    found = check(tmp_path, moments=20, seed=int(os.environ.get("PRBENCH_FUZZ_SEED", "1")))
    assert found.unequal == []
    assert found.killed.total() == 20
    assert set(found.killed) == {"worker", "node", "driver"}
