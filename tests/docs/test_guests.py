"""docs/examples/guests: packages that wrap somebody else's model, installed and tested as their users would."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

GUEST = Path(__file__).parents[2] / "docs" / "examples" / "guests" / "mdm"


def _run(*command: str | Path, path: Path) -> str:
    environment = {**os.environ, "PYTHONPATH": str(path)}
    done = subprocess.run([sys.executable, *command], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    return done.stdout


@pytest.mark.parametrize("tests", ["not Conformance", pytest.param("Conformance", marks=pytest.mark.slow)])
def test_the_guest_passes_its_own_tests_on_a_made_up_checkout(tests, monkeypatch):
    monkeypatch.delenv("PUBLIC_MDM", raising=False)
    options = ["-q", "-n", "0", "-p", "no:cacheprovider", "-W", "ignore"]
    printed = _run("-m", "pytest", *options, "-k", tests, GUEST, path=GUEST)
    assert int(printed.splitlines()[-1].split()[0]) >= 8, printed


def test_the_guest_is_installed_and_listed(tmp_path):
    copy = tmp_path / "guest"
    copy.mkdir()
    for file in GUEST.iterdir():  # pip builds beside the sources
        if file.is_file():
            (copy / file.name).write_bytes(file.read_bytes())
    options = ["--no-deps", "--no-build-isolation", "--no-index", "--quiet", "--disable-pip-version-check"]
    _run("-m", "pip", "install", *options, "--target", tmp_path / "site", copy, path=tmp_path)
    printed = _run("-m", "prbench", "adapters", "list", "public-mdm", path=tmp_path / "site")
    assert "public-mdm  prbench-guest-mdm  0.1.0    prbench_guest_mdm:load" in printed
