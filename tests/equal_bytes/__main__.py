"""``python -m tests.equal_bytes``: make the same tables and runs with two versions of prbench, and compare them.

``make DIR`` runs the ``prbench`` beside the running Python (``--prbench`` names another) and writes native files,
tables, windows, runs and boards into DIR. ``compare OLD NEW`` then says which files differ: Parquet and native files by
bytes, JSON by values after the renamings in ``key_map.toml``. Seconds, memory and versions are left out.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

LAYOUTS = ("hd-epic", "mogaze", "hot3d", "adt", "gimo")
RUNS = {
    "none": ("static", "nearest-neighbour"),
    "text": ("mdm",),
    "goal-pose": ("gmd", "dno", "dart", "pr"),
    "goal-loc": ("dno", "dart", "wandr", "pr", "scripted", "ground-truth", "ground-truth-resampled"),
}
LEARNT = ("gazemodiff", "gazemotion", "humanmac", "cvae", "dlow", "belfusion")
PREDICTORS = ("zero-velocity", "constant-velocity", "nearest-past", *LEARNT)
RENAMED = tomllib.loads(Path(__file__).with_name("key_map.toml").read_text(encoding="utf-8"))


def commands() -> Iterator[tuple[str, list[str]]]:
    """Yield the name of the result (a path in the folder) and the command line that makes it."""
    for layout in LAYOUTS:
        yield f"native/{layout}", ["synthesize", layout, "--count", "8", "--events", "3", "--seed", "2"]
        yield f"tables/{layout}", ["build-dataset", layout, "--root", f"native/{layout}"]
    data = [f"tables/{layout}" for layout in LAYOUTS]
    for condition, methods in RUNS.items():
        for method in methods:
            limit = ["--limit", "1"] if method in ("dno", "dart") else ["--limit", "3", "--samples", "2"]
            chosen = ["--method", method, "--condition", condition, "--seed", "5", "--data", *data, *limit]
            yield f"runs/{method}-{condition}", ["run", *chosen]
    shuffled = ["run", "--method", "scripted", "--condition", "goal-loc", "--data", *data, "--control", "shuffled-goal"]
    yield "runs/scripted-shuffled", shuffled
    for layout in ("mogaze", "adt"):
        yield f"windows/{layout}", ["build-windows", layout, "--root", f"native/{layout}"]
    for predictor in PREDICTORS:
        samples = "50" if predictor == "dlow" else "3"  # DLow's samples are one design, of which fewer are no part
        chosen = ["--method", predictor, "--data", "windows/adt", "--limit", "4", "--samples", samples]
        condition = "pose+gaze" if predictor.startswith("gaze") else "pose"
        asked = ["run", "--benchmark", "motion-prediction", "--condition", condition]
        yield f"futures/{predictor}", [*asked, *chosen]
    boards = [f"runs/{name}" for name in ("static-none", "pr-goal-loc", "scripted-goal-loc", "wandr-goal-loc")]
    for form in ("md", "csv", "json"):
        yield f"boards/board.{form}", ["leaderboard", "export", *boards, "--format", form]


def make(folder: Path, prbench: Path) -> None:
    """Run every command in ``folder``; one that fails ends it."""
    folder.mkdir(parents=True, exist_ok=True)
    environment = {**os.environ, "PRBENCH_CACHE": str(folder.absolute() / "cache"), "OMP_NUM_THREADS": "1"}
    for name, words in commands():
        out = folder / name
        if out.exists():
            continue
        out.parent.mkdir(parents=True, exist_ok=True)
        print(name, flush=True)
        line = [prbench.absolute(), *words, "--out", name, "--quiet"]
        subprocess.run(line, cwd=folder, env=environment, check=True, stdout=subprocess.DEVNULL)


def _renamed(value: Any) -> Any:
    """Return a JSON value without what may differ, under its present names."""
    if isinstance(value, dict):
        kept = {RENAMED["keys"].get(key, key): _renamed(item) for key, item in value.items()}
        return {key: item for key, item in kept.items() if key not in RENAMED["left_out"]}
    return [_renamed(item) for item in value] if isinstance(value, list) else value


def _same(old: Path, new: Path) -> bool:
    if old.suffix == ".json" and "native" not in old.parts:
        return _renamed(json.loads(old.read_bytes())) == _renamed(json.loads(new.read_bytes()))
    return old.read_bytes() == new.read_bytes()


def compare(old: Path, new: Path) -> int:
    """Print every file that only one folder has or that differs, and return how many there are."""
    ignored = set(RENAMED["ignored_files"])
    found = [
        {path.relative_to(folder) for path in folder.rglob("*") if path.is_file() and path.name not in ignored}
        for folder in (old, new)
    ]
    names = [{name for name in side if name.parts[0] != "cache"} for side in found]
    problems = [f"only in {old}: {name}" for name in sorted(names[0] - names[1])]
    problems += [f"only in {new}: {name}" for name in sorted(names[1] - names[0])]
    problems += [f"differs: {name}" for name in sorted(names[0] & names[1]) if not _same(old / name, new / name)]
    print("\n".join(problems))
    print(f"{len(names[0] & names[1])} files compared, {len(problems)} differ or stand alone")
    return len(problems)


def main() -> int:
    """Run what the command line says; 1 if something differs."""
    parser = argparse.ArgumentParser(prog="python -m tests.equal_bytes", description=__doc__)
    parser.add_argument("what", choices=["make", "compare"])
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--prbench", type=Path, default=Path(sys.executable).with_name("prbench"))
    arguments = parser.parse_args()
    if arguments.what == "make":
        make(arguments.folders[0], arguments.prbench)
        return 0
    return int(compare(*arguments.folders) > 0)


if __name__ == "__main__":
    raise SystemExit(main())
