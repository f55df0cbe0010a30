"""Interpreters and packages outside this environment, found or the test skipped."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from functools import lru_cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "docs" / "examples"
_PROBE = "import json, sys, numpy, pyarrow; print(json.dumps(sys.version_info[:2]))"


@lru_cache(maxsize=1)
def older_python() -> tuple[tuple[int, int], str]:
    """Version and path of the oldest Python below this one, from 3.8 on, that has NumPy and PyArrow."""
    found = sorted(filter(None, map(_probed, _candidates())))
    older = [(version, path) for version, path in found if (3, 8) <= version < sys.version_info[:2]]
    if not older:
        pytest.skip(
            "no Python from 3.8 on that is older than this one and has NumPy and PyArrow: neither in"
            " PRBENCH_TEST_PYTHONS (paths of interpreters), nor on the PATH, nor of pyenv"
        )
    return older[0]


def _candidates() -> list[str]:
    named = [path for path in os.environ.get("PRBENCH_TEST_PYTHONS", "").split(os.pathsep) if path]
    on_path = [shutil.which(f"python3.{minor}") for minor in range(8, sys.version_info.minor)]
    root = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
    of_pyenv = [str(path) for path in sorted(root.glob("versions/3.*/bin/python"))]
    return list(dict.fromkeys(path for path in (*named, *on_path, *of_pyenv) if path))


def _probed(python: str) -> tuple[tuple[int, int], str] | None:
    try:
        done = subprocess.run([python, "-c", _PROBE], capture_output=True, timeout=20)
        return (tuple(json.loads(done.stdout)), python) if done.returncode == 0 else None
    except (OSError, subprocess.TimeoutExpired):
        return None


def javascript(folder: Path) -> list[str]:
    """The command of glide.mjs, in ``folder`` if the packages that it needs are not beside it."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("node is not installed")
    modules = Path(os.environ.get("PRBENCH_TEST_NODE_MODULES", EXAMPLES / "node_modules"))
    if not (modules / "apache-arrow").is_dir():
        pytest.skip(
            f"apache-arrow is not in {modules}: run `npm install --no-package-lock` in docs/examples, or name a"
            " node_modules folder in PRBENCH_TEST_NODE_MODULES"
        )
    if modules == EXAMPLES / "node_modules":
        return [node, str(EXAMPLES / "glide.mjs")]
    for name in ("glide.mjs", "package.json"):
        shutil.copy(EXAMPLES / name, folder)
    (folder / "node_modules").symlink_to(modules.resolve(), target_is_directory=True)
    return [node, str(folder / "glide.mjs")]
