"""The whole grid as Markdown: ``python -m benchmarks.statistics [data sets a cell]`` from the repository's root.

Ends with status 1 if an interval covers less than 92 %, or false positives exceed 5 %, by more than two standard errors
of the simulation.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

from benchmarks.statistics.cells import Share, false_positives, mean_coverage, rate_coverage
from benchmarks.statistics.designs import CORRELATIONS, DESIGNS, METRES, RATES

LEAST_COVERAGE = 0.92
MOST_FALSE_POSITIVES = 0.05


def main(sets: int = 5_000) -> int:
    """Print the tables.

    Args:
        sets: Simulated data sets (and families of comparisons) of each cell.
    """
    print(f"{sets} data sets a cell; coverage in %, median width in parentheses (rates in points).\n")
    failures: list[str] = []
    header = ["recordings", *(f"{rate:g}" for rate in RATES)]
    for correlation in CORRELATIONS:
        _head(f"Rates, correlation {correlation:g}", header)
        for name, sizes in DESIGNS.items():
            if sizes.max() == 1 and correlation > 0:
                continue  # single sequences have no company to be correlated with
            found = [rate_coverage(sizes, rate, correlation, sets=sets, seed=1) for rate in RATES]
            _row(name, found, width=lambda share: f" ({100 * share.width:.0f})")
            failures += [
                f"rate {rate}, {correlation}, {name}" for rate, share in zip(RATES, found) if _covers_too_little(share)
            ]
    _head("Means of 1", ["recordings", *METRES])
    for name, sizes in DESIGNS.items():
        means = [mean_coverage(sizes, kind, sets=sets, seed=2) for kind in METRES]
        _row(name, means, width=lambda share: f" ({share.width:.2f})")
        failures += [f"mean {kind}, {name}" for kind, share in zip(METRES, means) if _covers_too_little(share)]
    kinds = (*METRES, "rates")
    _head("Families of six comparisons with a false positive", ["recordings", *kinds])
    for name, sizes in DESIGNS.items():
        wrong = [false_positives(sizes, kind, families=sets, seed=3) for kind in kinds]
        _row(name, wrong, width=lambda _: "")
        failures += [
            f"comparisons {kind}, {name}"
            for kind, share in zip(kinds, wrong)
            if share is not None and share.share > MOST_FALSE_POSITIVES + 2 * share.error
        ]
    print("\n" + ("\n".join(f"FAILED: {line}" for line in failures) or "every cell is as promised"))
    return int(bool(failures))


def _covers_too_little(share: Share | None) -> bool:
    return share is not None and share.share < LEAST_COVERAGE - 2 * share.error


def _head(title: str, columns: list[str]) -> None:
    print(f"\n{title}\n")
    print("| " + " | ".join(columns) + " |")
    print("|---" * len(columns) + "|")


def _row(name: str, found: list, *, width: Callable[[Share], str]) -> None:
    cells = ["–" if share is None else f"{100 * share.share:.1f}{width(share)}" for share in found]
    print("| " + " | ".join([name, *cells]) + " |", flush=True)


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:2])))
