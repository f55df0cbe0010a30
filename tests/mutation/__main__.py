"""``python -m tests.mutation``: put in small mistakes, one at a time, and look which of them the tests notice.

The mistakes are drawn evenly over the packages and the kinds of mistake. Each is put into a copy of the tree, and only
the tests of its package run, nearest first, until one fails.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections import Counter
from dataclasses import asdict
from pathlib import Path

from tests.mutation.mutants import draw, mutants_of
from tests.mutation.running import MutatedCopy

PACKAGES = ("metrics", "curation", "harness", "representation", "readers")
ROOT = Path(__file__).parents[2]


def main() -> None:
    """Draw mutants, try each, and print what became of it."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=30, help="how many mutants (default 30)")
    parser.add_argument("--seconds", type=float, default=60, help="computing time for each (default 60)")
    parser.add_argument("--packages", nargs="+", default=PACKAGES, help=f"default: {' '.join(PACKAGES)}")
    parser.add_argument("--only", type=int, nargs="+", help="numbers of the mutants to run, of those drawn")
    parser.add_argument("--report", type=Path, help="JSON file to write")
    arguments = parser.parse_args()
    mutants = [mutant for module in sorted((ROOT / "prbench").rglob("*.py")) for mutant in mutants_of(ROOT, module)]
    drawn = draw(mutants, packages=tuple(arguments.packages), seed=arguments.seed, count=arguments.count)
    rows = []
    with tempfile.TemporaryDirectory(prefix="prbench-mutation-", ignore_cleanup_errors=True) as folder:
        copied = MutatedCopy(ROOT, Path(folder), arguments.seconds)
        for number, mutant in enumerate(drawn):
            if arguments.only and number not in arguments.only:
                continue
            outcome = copied.judge(mutant)
            rows.append({"number": number, "mutant": asdict(mutant), "outcome": asdict(outcome)})
            print(f"{number:3d} {outcome.verdict} in {outcome.seconds:.0f} s: {mutant.module} {mutant.function}")
            print(f"      {mutant.operator}: {mutant.before}  ->  {mutant.after}")
            print(f"      {outcome.test or mutant.statement}", flush=True)
            if arguments.report:
                arguments.report.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    print(dict(Counter(row["outcome"]["verdict"] for row in rows)))


if __name__ == "__main__":
    main()
