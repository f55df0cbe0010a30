"""Synthetic people and trees of their recordings."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np

from prbench.synthetic.people import PRESETS, perform
from prbench.synthetic.write_tree import synthesize_tree
from tests.laws.cases import SameBytes


def _tree(folder: Path, *, layout: str, seed: int = 4, workers: int = 1) -> None:
    synthesize_tree(layout, folder / "tree", recordings=2, seed=seed, n_events=1, workers=workers)


def digest(*, seed: int = 11, index: int = 4, **changes: object) -> str:
    """Recording id, and digest of all arrays and events, of a performance."""
    acted = perform("adt", seed=seed, index=index, n_events=4, rate=30.0, **changes)
    tracks = [array for item in acted.objects for array in (item.position, item.rotation)]
    arrays = (acted.joints, acted.rotations, acted.eye, acted.gaze, *tracks)
    content = b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)
    content += repr([(e.event_id, e.event_time, e.prime_time, e.tag) for e in acted.events]).encode()
    return f"{acted.recording_id} {hashlib.sha256(content).hexdigest()}"


def _after_others(_: Path) -> str:
    digest(index=0)
    perform("mogaze", seed=11, index=4, n_events=2, rate=30.0)
    return digest()


def _elsewhere(_: Path) -> str:
    code = "from tests.laws.synthetic_cases import digest; print(digest())"
    # All other variables stay: OPENBLAS_CORETYPE, where it is set, changes the last digits of matrix products.
    environment = os.environ | {"PYTHONHASHSEED": "7"}
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment
    ).stdout.strip()


SAME_BYTES = [
    SameBytes(
        "a performance",
        {"alone": lambda _: digest(), "after others": _after_others, "in a process with another hash seed": _elsewhere},
        differs={
            "another index": lambda _: digest(index=5),
            "another seed": lambda _: digest(seed=12),
            "another world": lambda _: digest(world="large"),
        },
    ),
    *(
        SameBytes(
            f"a synthetic tree of {layout}",
            {
                "once": partial(_tree, layout=layout),
                # Processes cost seconds and know nothing of layouts, so one layout tries them.
                "again": partial(_tree, layout=layout, workers=2 if layout == "adt" else 1),
            },
            differs={"another seed": partial(_tree, layout=layout, seed=5)},
        )
        for layout in PRESETS
    ),
]
