"""The method is its folder and one line: without both, nothing else notices."""

from __future__ import annotations

import ast
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[3]
LINE = 'wandr = "prbench_adapters.wandr:load"'


def test_one_line_installs_it():
    assert (ROOT / "pyproject.toml").read_text(encoding="utf-8").splitlines().count(LINE) == 1


def test_nothing_outside_its_folder_imports_it():
    for path in [*(ROOT / "adapters").rglob("*.py"), *(ROOT / "prbench").rglob("*.py")]:
        if path.is_relative_to(ROOT / "adapters" / "wandr"):
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            named = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            named += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            assert not any(name.startswith("prbench_adapters.wandr") for name in named), path


def test_a_copy_without_it_lists_and_trains_the_others(tmp_path):
    copy = tmp_path / "site"
    for folder, name in {"prbench": "prbench", "adapters": "prbench_adapters"}.items():
        shutil.copytree(ROOT / folder, copy / name, ignore=shutil.ignore_patterns("weights", "__pycache__"))
    shutil.rmtree(copy / "prbench_adapters" / "wandr")
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8").replace(LINE, "")
    metadata = copy / "prbench-0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: prbench\nVersion: 0\n")
    lines = text.split('[project.entry-points."')[1:]
    groups = [f"[{part.split(chr(34), 1)[0]}]\n" + part.split("]", 1)[1].split("\n[", 1)[0] for part in lines]
    (metadata / "entry_points.txt").write_text("\n".join(groups).replace('"', ""))
    script = (
        f"import sys; sys.path.insert(0, {str(copy)!r})\n"
        "from prbench.evaluation.installed import list_adapters\n"
        "from prbench.training.installed import list_tasks, load_task\n"
        "import prbench; assert prbench.__file__.startswith(sys.path[0])\n"
        "print({adapter.name for adapter in list_adapters()} & {'wandr', 'pr'}, 'wandr' in list_tasks())\n"
        "print(load_task('pr').name)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split("\n")[:2] == ["{'pr'} False", "pr"]


def test_importing_it_imports_neither_torch_nor_its_network():
    script = (
        "import sys, prbench_adapters.wandr\n"
        "print('torch' in sys.modules, [name for name in sys.modules if name.startswith('prbench_adapters.wandr.')])"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.stdout.strip() == "False []", done.stderr
