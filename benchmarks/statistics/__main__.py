"""The whole grid as Markdown: ``python -m benchmarks.statistics [data sets a cell]`` from the repository's root.

Ends with status 1 if an interval covers less than 92 %, or false positives exceed 5 %, by more than two standard errors
of the simulation.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

from benchmarks.statistics.cells import (
    CORRELATIONS,
    DESIGNS,
    FIRST_RUN,
    METRES,
    RATES,
    Share,
    coverage_over_datasets,
    false_positives,
    mean_coverage,
    rate_coverage,
)

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
        print_head(f"Rates, correlation {correlation:g}", header)
        for name, sizes in DESIGNS.items():
            if sizes.max() == 1 and correlation > 0:
                continue  # single sequences have no company to be correlated with
            found = [rate_coverage(sizes, rate, correlation, sets=sets, seed=1) for rate in RATES]
            print_row(name, found, width=lambda share: f" ({100 * share.width:.0f})")
            failures += [
                f"rate {rate}, {correlation}, {name}" for rate, share in zip(RATES, found) if _covers_too_little(share)
            ]
    print_head("Means of 1", ["recordings", *METRES])
    for name, sizes in DESIGNS.items():
        means = [mean_coverage(sizes, kind, sets=sets, seed=2) for kind in METRES]
        print_row(name, means, width=lambda share: f" ({share.width:.2f})")
        failures += [f"mean {kind}, {name}" for kind, share in zip(METRES, means) if _covers_too_little(share)]
    of_five = {"0.02": (0.02,) * 5, "0.1": (0.1,) * 5, "0.5": (0.5,) * 5, "0.1 to 0.9": (0.1, 0.3, 0.5, 0.7, 0.9)}
    print_head("Means over five datasets of rates (correlation 0.1), and of 1", ["recordings", *of_five, *METRES])
    for name, sizes in {"7 uneven of 10": FIRST_RUN, **DESIGNS}.items():
        over = [coverage_over_datasets(sizes, kind, sets=sets, seed=4) for kind in (*of_five.values(), *METRES)]
        print_row(name, over, width=lambda share: f" ({share.width:.2f})")
        failures += [
            f"mean over datasets {kind}, {name}"
            for kind, share in zip((*of_five, *METRES), over)
            if _covers_too_little(share)
        ]
    kinds = (*METRES, "rates")
    print_head("Families of six comparisons with a false positive", ["recordings", *kinds])
    for name, sizes in DESIGNS.items():
        wrong = [false_positives(sizes, kind, families=sets, seed=3) for kind in kinds]
        print_row(name, wrong, width=lambda _: "")
        failures += [
            f"comparisons {kind}, {name}"
            for kind, share in zip(kinds, wrong)
            if share is not None and share.share > MOST_FALSE_POSITIVES + 2 * share.error
        ]
    print("\n" + ("\n".join(f"FAILED: {line}" for line in failures) or "every cell is as promised"))
    return int(bool(failures))


def _covers_too_little(share: Share | None) -> bool:
    return share is not None and share.share < LEAST_COVERAGE - 2 * share.error


def print_head(title: str, columns: list[str]) -> None:
    """Print the head of a Markdown table below its title."""
    print(f"\n{title}\n")
    print("| " + " | ".join(columns) + " |")
    print("|---" * len(columns) + "|")


def print_row(name: str, found: list, *, width: Callable[[Share], str]) -> None:
    """Print a row of shares, each with what ``width`` makes of it; a dash where there is none."""
    cells = ["–" if share is None else f"{100 * share.share:.1f}{width(share)}" for share in found]
    print("| " + " | ".join([name, *cells]) + " |", flush=True)


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:2])))
