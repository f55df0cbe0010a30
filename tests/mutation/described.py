"""``python -m tests.mutation.described``: put in the changes of ``described.toml``, and look which tests notice.

Each change is told in the words of a user and tied to a public function, so that it can be put into a later tree
whose modules have moved: the function is looked up by its name and by the fragment of source that is replaced.
"""

from __future__ import annotations

import argparse
import ast
import re
import shutil
import tempfile
import tomllib
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import tomli_w

ROOT = Path(__file__).parents[2]
FILE = Path(__file__).with_name("described.toml")
_MOST_FILES = 16  # of tests, nearest first
_SECONDS = 90  # of computing, for each change

Change = dict[str, Any]


def load_changes() -> list[Change]:
    """Return the described changes, in their order."""
    return tomllib.loads(FILE.read_text(encoding="utf-8"))["changes"]


def find_places(change: Change, tree: Path) -> list[tuple[str, str]]:
    """Return every place at which a change can be put in; it is well described if that is one.

    ``inside`` goes before ``function``: a helper may have been taken back into the function that it served.

    Args:
        change: An entry of ``described.toml``.
        tree: Checkout.

    Returns:
        Modules, relative to the tree, each with the source that it has with the change in it.
    """
    fragment = re.compile(r"\s*".join(map(re.escape, re.findall(r"\w+|[^\w\s]", change["find"]))))  # as lines break
    places = []
    for name in filter(None, (change.get("inside"), change["function"])):
        for module, (source, definitions) in _definitions(tree).items():
            lines = source.splitlines(keepends=True)
            for qualified, first, last in definitions:
                if f".{qualified}".endswith(f".{name}"):
                    before, body, after = map("".join, (lines[: first - 1], lines[first - 1 : last], lines[last:]))
                    for match in fragment.finditer(body):
                        changed = body[: match.start()] + change["replace"] + body[match.end() :]
                        places.append((module, before + changed + after))
        if places:
            break
    return places


@cache
def _definitions(tree: Path) -> dict[str, tuple[str, list[tuple[str, int, int]]]]:
    """Source of every module, with name, first and last line of each function and class in it."""
    files = [file for folder in ("prbench", "adapters", "benchmarks") for file in sorted((tree / folder).rglob("*.py"))]
    sources = {file.relative_to(tree).as_posix(): file.read_text(encoding="utf-8") for file in files}
    return {module: (source, list(_named(ast.parse(source), ""))) for module, source in sources.items()}


def _named(parent: ast.AST, prefix: str) -> Iterator[tuple[str, int, int]]:
    for node in ast.iter_child_nodes(parent):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield f"{prefix}{node.name}", node.lineno, node.end_lineno or node.lineno
            yield from _named(node, f"{prefix}{node.name}.")
        else:
            yield from _named(node, prefix)


def nearest_tests(change: Change, module: str, tree: Path) -> list[Path]:
    """Return the files of tests that are most likely to notice a change, nearest first, relative to the tree.

    Args:
        change: Its ``tests`` are parts of the paths of such files, the best first.
        module: In which the change is.
        tree: Checkout.
    """
    words = change["tests"]
    stem = Path(module.removesuffix("/__init__.py")).stem
    name = change["function"].partition(".")[0]  # of a method, its class: that is what tests import
    found = []
    for file in (tree / "tests").rglob("test_*.py"):
        path = file.relative_to(tree).as_posix()
        topic = next((place for place, word in enumerate(words) if word in path), len(words))
        is_mentioned = re.search(rf"\b({name}|{stem})\b", file.read_text(encoding="utf-8")) is not None
        distance = 0 if file.stem in (f"test_{stem}", f"test_{name}") else 1 if is_mentioned else 2
        if topic < len(words) or distance < 2:
            found.append((topic, distance, path))
    return [Path(path) for _, _, path in sorted(found)[:_MOST_FILES]]


def main() -> int:
    """Run what the command line says; 1 if a change that was noticed before is not any more, or is not found."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutation.described", description=__doc__)
    parser.add_argument("--only", nargs="+", metavar="NAME", help="changes to try (default: all)")
    parser.add_argument("--tree", type=Path, default=ROOT, help="checkout to try (default: this one); only read")
    parser.add_argument("--update", action="store_true", help="write into described.toml what the tests said")
    arguments = parser.parse_args()
    from tests.mutation.running import MutatedCopy  # needs POSIX

    tree, changes = arguments.tree.resolve(), load_changes()
    verdicts, is_worse = Counter[str](), False
    folder = Path(tempfile.mkdtemp(prefix="prbench-described-"))
    try:
        copied = MutatedCopy(tree, folder, _SECONDS)
        for change in changes:
            if change["name"] not in (arguments.only or [change["name"]]):
                continue
            verdict, told = _judged(change, tree, copied)
            verdicts[verdict] += 1
            is_worse |= verdict == "not found" or (change.get("killed") is True and verdict != "killed")
            before = {True: " (before: killed)", False: " (before: survived)"}.get(change.get("killed"), "")
            print(f"{change['name']}: {verdict}{before} {told}".rstrip(), flush=True)
            if arguments.update and verdict in ("killed", "survived"):
                change |= {"killed": verdict == "killed", "killed_by": told if verdict == "killed" else ""}
                FILE.write_text(tomli_w.dumps({"changes": changes}), encoding="utf-8")
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    print(dict(verdicts))
    return int(is_worse)


def _judged(change: Change, tree: Path, copied: Any) -> tuple[str, str]:
    """Return what became of a change (``killed``, ``survived``, ``timeout``, ``unsound``, ``not found``) and why."""
    places = find_places(change, tree)
    if len(places) != 1:
        found = [module for module, _ in places]
        return "not found", f"place by hand: {change['function']} with `{change['find']}`, found in {found}"
    module, source = places[0]
    copied.options = ("-m", "not fuzz") if change.get("slow") else ()  # else slow tests are left out, as usual
    try:
        outcome = copied.judge_source(module, source, nearest_tests(change, module, tree))
    except RuntimeError as error:  # the test that failed fails without the change, too
        return "unsound", str(error)
    return outcome.verdict, outcome.test


if __name__ == "__main__":
    raise SystemExit(main())
