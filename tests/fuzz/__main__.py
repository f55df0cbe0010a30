"""``python -m tests.fuzz``: many mutations through every door, and a table of what became of them."""

from __future__ import annotations

import argparse
import os
import shutil
from collections import Counter
from pathlib import Path
from random import Random

import pyarrow as pa

from tests.fuzz.doors import COMMANDS, READERS, Door
from tests.fuzz.judging import GOOD, SECONDS, Looker, Outcome, temporary_folder, verdict
from tests.fuzz.mutations import Mutation, files_by_kind, mutate
from tests.shared import open_folder

os.fsync = lambda _file: None  # as in conftest.py, which this interpreter has not read

Finding = tuple[str, Mutation, Outcome]


def fuzz(
    door: Door, folder: Path, *, seed: int, mutations: int, seconds: float = SECONDS
) -> tuple[Counter[str], list[Finding]]:
    """Send damaged files through one door.

    Args:
        door: Where they go in.
        folder: Empty; the files are made there.
        seed: Of the damages.
        mutations: How many.
        seconds: How long one look may take.

    Returns:
        How often each verdict was given, and the damages whose verdict is a finding.
    """
    door.make(folder)
    groups = [group for group in files_by_kind(folder / "input") if group[0].name not in door.spared]
    kept = set(folder.iterdir())
    looked = Looker(lambda: door.look(folder), seconds=seconds)
    whole = looked()
    if whole.seen is None:
        raise RuntimeError(f"{door.name}: undamaged files: {whole.ending} {whole.message}")
    counts: Counter[str] = Counter()
    findings = []
    for number in range(mutations):
        _remove_made(folder, kept)
        mutation, undo = mutate(groups, Random(f"{door.name} {seed} {number}"))
        after = looked()
        ending = verdict(whole.seen, after, must_be_told=_must_be_told(mutation, door))
        undo.restore()
        counts[ending] += 1
        if ending not in GOOD:
            findings.append((f"{seed}/{number} {ending}", mutation, after))
    looked.close()
    return counts, findings


def _must_be_told(mutation: Mutation, door: Door) -> bool:
    if mutation.path.name in door.optional and mutation.harm == "replaced":
        return False
    return mutation.harm == "replaced" or (mutation.harm == "shorter" and door.knows_whole)


def _remove_made(folder: Path, kept: set[Path]) -> None:
    for path in set(folder.iterdir()) - kept:
        shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("doors", nargs="*", help="names of doors (default: all)")
    parser.add_argument("--mutations", type=int, default=100, help="of each door (default 100)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=SECONDS, help="how long one look may take (default 60)")
    return parser.parse_args()


def main() -> int:
    """Run the doors that the command line names; 1 if there was a finding."""
    arguments = _arguments()
    open_folder()
    pa.set_cpu_count(1)  # only a process without threads may fork
    found = 0
    for door in (*READERS, *COMMANDS):
        if arguments.doors and door.name not in arguments.doors:
            continue
        folder = temporary_folder()
        counts, findings = fuzz(
            door, folder, seed=arguments.seed, mutations=arguments.mutations, seconds=arguments.seconds
        )
        shutil.rmtree(folder)
        print(f"{door.name}: {dict(sorted(counts.items()))}", flush=True)
        for place, mutation, after in findings:
            print(f"    {place}: {mutation}: {after.message[:300]}", flush=True)
        found += len(findings)
    return 1 if found else 0


if __name__ == "__main__":
    raise SystemExit(main())
