"""What is built from the tree holds exactly the tree."""

from __future__ import annotations

import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from prbench.protocol.manifests import load_protocol

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
FOLDERS = {
    "prbench": "prbench",
    "adapters": "prbench_adapters",
    "benchmarks": "prbench_benchmarks",
    "data_manifests": "prbench_data_manifests",
}


def _tree() -> set[str]:
    """Import-named paths of everything that a wheel must hold."""
    return {
        str(Path(package) / path.relative_to(ROOT / folder)).replace("\\", "/")
        for folder, package in FOLDERS.items()
        for path in (ROOT / folder).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts and not _is_program(path)
    }


def _is_program(path: Path) -> bool:
    """True for timings, simulations and measurements, which are of use beside the source only."""
    return any(path.is_relative_to(ROOT / "benchmarks" / name) for name in ("choices", "speed", "statistics"))


@pytest.fixture(scope="module")
def distributions(tmp_path_factory) -> Path:
    """A source archive of the tree, and the wheel built from that archive."""
    copy = tmp_path_factory.mktemp("source") / "prbench"
    ignored = shutil.ignore_patterns(".git", "build", "dist", "*.egg-info", "__pycache__", ".venv", ".*_cache")
    shutil.copytree(ROOT, copy, ignore=ignored, symlinks=True)
    out = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(out), str(copy)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    return out


def test_wheel_made_from_the_sdist_holds_the_tree_and_nothing_else(distributions):
    (wheel,) = distributions.glob("*.whl")
    names = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    assert sorted(_tree() - names) == [], "missing from the wheel"
    assert sorted(names - _tree()) == [], "in the wheel, not in the tree"


def test_wheel_offers_the_console_script_and_the_built_in_methods(distributions):
    (wheel,) = distributions.glob("*.whl")
    archive = zipfile.ZipFile(wheel)
    entry_points = next(name for name in archive.namelist() if name.endswith("entry_points.txt"))
    text = archive.read(entry_points).decode()
    assert "prbench = prbench.cli:main" in text
    assert "static = prbench_adapters.static:load" in text


def test_data_files_are_found_in_the_installed_wheel(distributions, tmp_path):
    (wheel,) = distributions.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path)
    script = (
        "from prbench.protocol.manifests import load_manifest, load_protocol\n"
        "import prbench\n"
        "print(prbench.__file__, load_manifest('adt').name, load_protocol().version)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, cwd=tmp_path, env=_environment(tmp_path)
    )
    assert done.returncode == 0, done.stderr
    assert str(tmp_path) in done.stdout
    assert done.stdout.split()[1:] == ["adt", str(load_protocol().version)]


def _environment(folder: Path) -> dict[str, str]:
    import os

    return {**os.environ, "PYTHONPATH": str(folder)}
