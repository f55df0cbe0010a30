"""False positives where no constant of the test was chosen: ``python -m benchmarks.statistics.held_out [families]``.

The factor ((k + 5)/k)³ and the 1.5 of docs/specification/protocol.md#comparisons were chosen on the grid of
``python -m benchmarks.statistics``. Here are other numbers of recordings, other distributions and another seed.
Nothing is promised for them: the status is 0 whatever comes out, and cells above the promise are named.
"""

from __future__ import annotations

import sys

import numpy as np

from benchmarks.statistics.__main__ import MOST_FALSE_POSITIVES, print_head, print_row
from benchmarks.statistics.cells import DESIGNS, METRES, UNUSED_METRES, false_positives

SEED = 20_261_123
HELD_OUT = {
    **{f"{count} of 10": np.full(count, 10) for count in (6, 7, 8, 9)},
    **{name: DESIGNS[name] for name in ("11 uneven of 55", "22 of 8", "47 uneven of 117")},
}


def main(families: int = 4_000) -> None:
    """Print the table.

    Args:
        families: Simulated families of six comparisons in each cell.
    """
    kinds = (*METRES, *UNUSED_METRES, "rates")
    above: list[str] = []
    print(f"{families} families a cell, seed {SEED}; in %.")
    print_head("Families of six comparisons with a false positive", ["recordings", *kinds])
    for name, sizes in HELD_OUT.items():
        found = [false_positives(sizes, kind, families=families, seed=SEED) for kind in kinds]
        print_row(name, found, width=lambda _: "")
        above += [
            f"{kind}, {name}: {100 * share.share:.1f} %"
            for kind, share in zip(kinds, found, strict=True)
            if share is not None and share.share > MOST_FALSE_POSITIVES + 2 * share.error
        ]
    print("\n" + ("\n".join(f"above 5 % and two standard errors: {line}" for line in above) or "no cell is above 5 %"))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
