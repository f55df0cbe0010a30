"""``python -m tests.mutation``: put in small mistakes, one at a time, and look which of them the tests notice.

The mistakes are drawn evenly over the packages and the kinds of mistake. Each is put into a copy of the tree, and only
the tests of its package run, nearest first, until one fails. A report can be replayed on a later tree: functions are
found by name and statement wherever their modules have moved to.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path

from tests.mutation.mutants import Mutant, draw, mutants_of
from tests.mutation.replaying import find
from tests.mutation.running import MutatedCopy, Outcome

PACKAGES = ("metrics", "curation", "evaluation", "representation", "readers")
ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Trial:
    """A mutant to try, its number in the report, and what the tests of an earlier tree said."""

    number: int
    mutant: Mutant
    before: str = ""


def _replayed(report: Path, placed: Path | None, mutants: list[Mutant]) -> list[Trial]:
    rows = json.loads(report.read_text(encoding="utf-8"))["mutants"]
    by_hand = json.loads(placed.read_text(encoding="utf-8")) if placed else {}
    known = set(mutants)
    trials = []
    for row in rows:
        number = row["number"]
        old = Mutant(**row["mutant"])
        given = by_hand.get(str(number))
        new = Mutant(**given) if given else find(old, mutants)
        if new in known:
            trials.append(Trial(number, new, row["outcome"]["verdict"]))
        else:
            print(f"{number}: not found, place it by hand: {old}", flush=True)
    return trials


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=30, help="how many mutants (default 30)")
    parser.add_argument("--seconds", type=float, default=60, help="computing time for each (default 60)")
    parser.add_argument("--tree", type=Path, default=ROOT, help="checkout to try (default: this one); only read")
    parser.add_argument("--packages", nargs="+", default=PACKAGES, help=f"default: {' '.join(PACKAGES)}")
    parser.add_argument("--report", type=Path, help="JSON file to write")
    parser.add_argument("--replay", type=Path, help="report of another tree whose mutants are tried here")
    parser.add_argument("--placed", type=Path, help="JSON: number in that report to the whole mutant, placed by hand")
    parser.add_argument("--list", action="store_true", help="print the mutants and run nothing")
    parser.add_argument("--only", type=int, nargs="+", help="numbers of mutants to run, of those drawn or replayed")
    return parser.parse_args()


def main() -> int:
    """Run what the command line says; 1 if a mutant that was killed before is not any more."""
    arguments = _arguments()
    tree = arguments.tree.resolve()
    mutants = [mutant for module in sorted((tree / "prbench").rglob("*.py")) for mutant in mutants_of(tree, module)]
    if arguments.replay:
        trials = _replayed(arguments.replay, arguments.placed, mutants)
    else:
        drawn = draw(mutants, packages=tuple(arguments.packages), seed=arguments.seed, count=arguments.count)
        trials = [Trial(number, mutant) for number, mutant in enumerate(drawn)]
    if arguments.only:
        trials = [trial for trial in trials if trial.number in arguments.only]
    if arguments.list:
        for trial in trials:
            _tell(trial, None)
        return 0
    folder = Path(tempfile.mkdtemp(prefix="prbench-mutation-"))
    try:
        outcomes = _run(trials, MutatedCopy(tree, folder, arguments.seconds), arguments)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    print(dict(Counter(outcome.verdict for outcome in outcomes)))
    return int(any(trial.before == "killed" != after.verdict for trial, after in zip(trials, outcomes, strict=True)))


def _run(trials: list[Trial], copied: MutatedCopy, arguments: argparse.Namespace) -> list[Outcome]:
    outcomes = []
    rows = []
    for trial in trials:
        outcome = copied.judge(trial.mutant)
        outcomes.append(outcome)
        rows.append({**asdict(trial), "outcome": asdict(outcome)})
        _tell(trial, outcome)
        if arguments.report:
            text = json.dumps({"seed": arguments.seed, "mutants": rows}, indent=1)
            arguments.report.write_text(text + "\n", encoding="utf-8")
    return outcomes


def _tell(trial: Trial, outcome: Outcome | None) -> None:
    mutant = trial.mutant
    before = f" (before: {trial.before})" if trial.before else ""
    verdict = f"{outcome.verdict} in {outcome.seconds:.0f} s" if outcome else "not run"
    print(f"{trial.number:3d} {verdict}{before}: {mutant.module} {mutant.function}")
    print(f"      {mutant.operator}: {mutant.before}  ->  {mutant.after}")
    print(f"      {outcome.test if outcome and outcome.test else mutant.statement}", flush=True)


if __name__ == "__main__":
    raise SystemExit(main())
