"""Trees of synthetic recordings."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from prbench.synthetic.people import PRESETS
from prbench.synthetic.write_tree import synthesize_tree
from tests.laws.cases import SameBytes


def _tree(folder: Path, *, layout: str, seed: int = 4, workers: int = 1) -> None:
    synthesize_tree(layout, folder / "tree", recordings=2, seed=seed, n_events=1, workers=workers)


SAME_BYTES = [
    SameBytes(
        f"a synthetic tree of {layout}",
        {"in one process": partial(_tree, layout=layout), "by two": partial(_tree, layout=layout, workers=2)},
        differs={"another seed": partial(_tree, layout=layout, seed=5)},
    )
    for layout in PRESETS
]
