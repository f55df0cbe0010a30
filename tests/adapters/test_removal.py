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
import importlib.util, os, sys
from pathlib import Path
import numpy, safetensors.torch, scipy.spatial, torch  # what takes long to import, once for all copies


def look_around(removed):
    import prbench
    from prbench.errors import AdapterError
    from prbench.harness.methods.loading import load_adapter
    from prbench.harness.methods.installed import list_adapters
    from prbench.harness.methods.installed import list_tasks, load_task
    from prbench_adapters.diffusion.method import bundled_names

    assert prbench.__file__.startswith(sys.path[0])
    assert importlib.util.find_spec("prbench_adapters." + removed) is None
    print(*sorted(adapter.name for adapter in list_adapters()))
    print(*list_tasks())
    print(*bundled_names())
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


for site in map(Path, sys.argv[1:]):
    child = os.fork()
    if not child:
        for stream, name in ((1, "found"), (2, "failed")):
            os.dup2(os.open(site / name, os.O_WRONLY | os.O_CREAT), stream)
        sys.path.insert(0, str(site))
        # an editable installation has a finder that would bring back what is deleted here
        sys.meta_path[:] = [finder for finder in sys.meta_path if "editable" not in finder.__module__]
        look_around(site.name)
        sys.exit()
    (site / "status").write_text(str(os.waitpid(child, 0)[1]))
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
    paths = [path for folder in ("prbench", "adapters") for path in (ROOT / folder).rglob("*.py")]
    return {path: _imported(path) for path in paths if "prbench_adapters" in path.read_text(encoding="utf-8")}


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


def _linked(source: str, target: str) -> None:
    """Files stand in for themselves, compiled ones too: copying and compiling is most of the time otherwise."""
    Path(target).symlink_to(source)


def _copy_without(method: str, site: Path) -> None:
    """The package as it is installed once the folder, or the file, and the line of a method are deleted."""
    for folder, package in (("prbench", "prbench"), ("benchmarks", "prbench_benchmarks")):
        shutil.copytree(ROOT / folder, site / package, copy_function=_linked)
    shutil.copytree(
        ADAPTERS,
        site / "prbench_adapters",
        copy_function=_linked,
        ignore=lambda folder, names: {name for name in names if Path(folder, name) == _own(method)},
    )
    groups = _pyproject()["project"]["entry-points"]
    kept = {group: {k: v for k, v in lines.items() if k != method} for group, lines in groups.items()}
    metadata = site / "prbench-0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: prbench\nVersion: 0\n")
    text = "".join(f"[{group}]\n" + "".join(f"{k} = {v}\n" for k, v in lines.items()) for group, lines in kept.items())
    (metadata / "entry_points.txt").write_text(text)


@pytest.fixture(scope="module")
def without(tmp_path_factory) -> Path:
    """A folder with a copy of the package for each method, which is missing there, and what was found in it."""
    folder = tmp_path_factory.mktemp("without")
    for method in METHODS:
        _copy_without(method, folder / method)
    sites = [str(folder / method) for method in METHODS]
    subprocess.run([sys.executable, "-c", LOOK_AROUND, *sites], cwd=folder, check=True)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_without_it_the_others_are_listed_loaded_and_trained(without, method):
    assert (without / method / "status").read_text() == "0", (without / method / "failed").read_text()
    found = (without / method / "found").read_text()
    adapters, tasks, weights, refusal, *rest = found.splitlines()
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
