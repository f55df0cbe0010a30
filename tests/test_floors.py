"""A room imports only from floors below it; and adapters are never imported by prbench."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

FLOORS = {
    "prbench.boundary": 0,
    "prbench.bounded": 0,
    "prbench.errors": 0,
    "prbench.limits": 0,
    "prbench.paths": 0,
    "prbench.shown": 0,
    "prbench_data_manifests": 0,
    "prbench_benchmarks": 0,
    "prbench.axes": 1,
    "prbench.ranges": 1,
    "prbench.formats": 1,
    **{
        f"prbench.{room}": 1
        for room in (
            "skeleton",
            "rays",
            "meshes",
            "timelines",
            "manifests",
            "published",
            "engine",
            "storage",
            "randomness",
            "numpy_files",
            "parquet_files",
            "locks",
            "workers",
        )
    },
    **{f"prbench.{room}": 2 for room in ("metrics", "sequences", "representation", "text", "recording")},
    **{f"prbench.{room}": 3 for room in ("readers", "synthetic", "contract", "runs")},
    **{f"prbench.{room}": 4 for room in ("curation", "corpora", "evaluation", "viewing", "release")},
    **{f"prbench.{room}": 5 for room in ("training", "leaderboard")},
    "prbench.workflows": 6,
    "prbench_adapters": 6,
    "prbench.cli": 7,
}
"""Every room and its floor (design, section 1)."""

NEIGHBOURS = {
    ("prbench.formats", "prbench.skeleton"),
    ("prbench.engine", "prbench.storage"),
    ("prbench.boundary", "prbench.errors"),
    ("prbench.bounded", "prbench.errors"),
    ("prbench.bounded", "prbench.limits"),
    ("prbench.errors", "prbench.limits"),
    ("prbench.engine", "prbench.workers"),
    ("prbench.errors", "prbench.shown"),
    ("prbench.locks", "prbench.storage"),
}
"""The only arrows between rooms of one floor."""


def _modules() -> list[tuple[str, Path]]:
    folders = {"prbench": "prbench", "prbench_adapters": "adapters"}
    return [
        (".".join((package, *path.relative_to(ROOT / folder).with_suffix("").parts)).removesuffix(".__init__"), path)
        for package, folder in folders.items()
        for path in sorted((ROOT / folder).rglob("*.py"))
    ]


def _room(module: str) -> str | None:
    if module in ("prbench", "prbench.__main__"):
        return None  # the version line, and the way in for `python -m`
    parts = module.split(".")
    return parts[0] if parts[0] != "prbench" else ".".join(parts[:2])


def _imports(path: Path) -> list[str]:
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative imports hide the floor"
            found += (
                [f"{node.module}.{alias.name}" for alias in node.names] if node.module == "prbench" else [node.module]
            )
    return [name for name in found if name.split(".")[0].startswith("prbench")]


@pytest.mark.parametrize(("module", "path"), _modules(), ids=lambda value: value if isinstance(value, str) else "")
def test_imports_point_downwards(module, path):
    room = _room(module)
    if room is None:
        return  # the package itself, and ``python -m prbench``
    assert room in FLOORS, f"{module} stands in a room that has no floor; add it to the design first"
    for imported in _imports(path):
        target = _room(imported)
        if target is None or target == room:
            continue
        below = FLOORS[target] < FLOORS[room]
        assert below or (room, target) in NEIGHBOURS, (
            f"{module} (floor {FLOORS[room]}) imports {imported} (floor {FLOORS[target]})"
        )


def test_an_upward_import_would_be_noticed(tmp_path):
    file = tmp_path / "x.py"
    file.write_text("from prbench.cli import main\nimport prbench.sequences.table\nfrom prbench import rays\n")
    assert [_room(name) for name in _imports(file)] == ["prbench.cli", "prbench.sequences", "prbench.rays"]
    assert FLOORS["prbench.cli"] > FLOORS["prbench.sequences"] > FLOORS["prbench.rays"]
