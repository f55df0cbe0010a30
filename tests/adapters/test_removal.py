"""A method is one folder, or one file, and one line of ``pyproject.toml``: without both, nothing else notices."""

from __future__ import annotations

import ast
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ADAPTERS = ROOT / "adapters"
METHODS = ("dart", "dno", "gmd", "mdm", "pr", "static", "wandr")
LEARNED = {"dart", "gmd", "mdm", "pr", "wandr"}
GROUP = "prbench.adapters"

LOOK_AROUND = """
import sys
sys.path.insert(0, sys.argv[1])
import prbench
from prbench.errors import AdapterError
from prbench.evaluation.adapters import load_adapter
from prbench.evaluation.installed import list_adapters
from prbench.training.installed import list_tasks, load_task
from prbench_adapters.diffusion.bundled import bundled_names

assert prbench.__file__.startswith(sys.argv[1])
print(*sorted(adapter.name for adapter in list_adapters()))
print(*list_tasks())
print(*bundled_names())
for removed in sys.argv[2:]:
    try:
        load_adapter(removed, None, {}, "cpu")
    except AdapterError as error:
        print(error)
for task in list_tasks():
    assert load_task(task).name == task
for adapter in list_adapters():
    try:
        assert load_adapter(adapter.name, None, {}, "cpu").name == adapter.name
    except AdapterError as error:  # without weights it says so
        print(error)
"""


def _own(method: str) -> Path:
    """What is deleted with a method: a folder, or a file."""
    folder = ADAPTERS / method
    return folder if folder.is_dir() else folder.with_suffix(".py")


def _pyproject() -> dict:
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def _imported(path: Path) -> set[str]:
    """Full names of all modules that a file imports, at its top or later."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


@pytest.fixture(scope="module")
def imports() -> dict[Path, set[str]]:
    return {path: _imported(path) for folder in ("prbench", "adapters") for path in (ROOT / folder).rglob("*.py")}


def test_these_are_all_methods():
    assert sorted(_pyproject()["project"]["entry-points"][GROUP]) == sorted(METHODS)


@pytest.mark.parametrize("method", METHODS)
def test_nobody_else_imports_it(imports, method):
    name = f"prbench_adapters.{method}"
    own = _own(method)
    users = {
        str(path.relative_to(ROOT))
        for path, imported in imports.items()
        if not path.is_relative_to(own) and any(f"{one}.".startswith(f"{name}.") for one in imported)
    }
    assert users == set()


@pytest.mark.parametrize("method", METHODS)
def test_one_line_installs_it(method):
    lines = (ROOT / "pyproject.toml").read_text(encoding="utf-8").splitlines()
    assert [line for line in lines if line.startswith(f"{method} =") or f"_adapters.{method}:" in line] == [
        f'{method} = "prbench_adapters.{method}:load"'
    ]


def test_importing_them_loads_neither_torch_nor_their_own_modules():
    folders = [method for method in METHODS if _own(method).is_dir()]
    code = (
        f"import sys, {', '.join(f'prbench_adapters.{method}' for method in METHODS)}\n"
        f"own = tuple(f'prbench_adapters.{{name}}.' for name in {folders})\n"
        "print([name for name in sys.modules if name == 'torch' or name.startswith(own)])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


def _copy_without(methods: tuple[str, ...], site: Path) -> None:
    """The package as it is installed once a folder and a line of each of these methods are deleted."""
    shutil.copytree(ROOT / "prbench", site / "prbench", ignore=shutil.ignore_patterns("__pycache__"))
    gone = {_own(method) for method in methods}
    shutil.copytree(
        ADAPTERS,
        site / "prbench_adapters",
        ignore=lambda folder, names: {n for n in names if n == "__pycache__" or Path(folder, n) in gone},
    )
    groups = _pyproject()["project"]["entry-points"]
    kept = {group: {k: v for k, v in lines.items() if k not in methods} for group, lines in groups.items()}
    metadata = site / "prbench-0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: prbench\nVersion: 0\n")
    text = "".join(f"[{group}]\n" + "".join(f"{k} = {v}\n" for k, v in lines.items()) for group, lines in kept.items())
    (metadata / "entry_points.txt").write_text(text)


@pytest.mark.parametrize("method", METHODS)
def test_without_it_the_others_are_listed_loaded_and_trained(tmp_path, method):
    _copy_without((method,), tmp_path)
    done = subprocess.run(
        [sys.executable, "-c", LOOK_AROUND, str(tmp_path), method], capture_output=True, text=True, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    adapters, tasks, weights, refusal, *rest = done.stdout.splitlines()
    assert set(adapters.split()) == set(METHODS) - {method}
    assert set(tasks.split()) & set(METHODS) == LEARNED - {method}
    assert not any(name.startswith(f"{method}-") for name in weights.split())
    assert f"adapter '{method}' is not installed." in refusal
    unready = [line for line in rest if "no weights come with this version" not in line]
    if method == "mdm":
        assert len(unready) == 1
        assert "dno has no network of its own" in unready[0]
        assert "Give --weights" in unready[0]
    else:
        assert unready == []
