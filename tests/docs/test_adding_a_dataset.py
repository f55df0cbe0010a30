"""docs/adding-a-dataset.md: the package that it explains is installed as it stands, and its commands are run."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import msgspec
import numpy as np
import pytest

from prbench.cli import main
from prbench.datasets import find_reader, readable_datasets
from prbench.protocol.manifests import InHandRule
from prbench.sequences import SequenceTable

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "adding-a-dataset.md").read_text(encoding="utf-8")
IN_HAND = "tabletop/src/prbench_tabletop/tabletop-tracked.toml"
COMMANDS = "".join(re.findall(r"^```bash\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE))


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The package that the page's first command writes, installed by its metadata; a folder to work in."""
    monkeypatch.chdir(tmp_path)
    first = COMMANDS.splitlines()[0]
    assert main(shlex.split(first)[1:]) == 0
    source = tmp_path / "tabletop" / "src"
    install(source, tomllib.loads((tmp_path / "tabletop" / "pyproject.toml").read_text("utf-8")))
    monkeypatch.syspath_prepend(str(source))
    monkeypatch.setenv("PYTHONPATH", str(source))
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))
    return tmp_path


def install(source: Path, settings: dict) -> None:
    project = settings["project"]
    info = source / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n")
    ((name, points),) = project["entry-points"].items()
    lines = [f"[{name}]", *(f"{dataset} = {target}" for dataset, target in points.items())]
    (info / "entry_points.txt").write_text("\n".join(lines))


def test_the_page_shows_lines_of_the_package_as_they_stand(package) -> None:
    (shown,) = re.findall(r"^```toml\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
    assert shown.strip() in (package / "tabletop" / "pyproject.toml").read_text("utf-8")


def test_every_key_of_the_in_hand_rule_is_explained_with_the_value_of_the_example(package) -> None:
    shown = re.findall(r"^\| `(\w+)` \| `(.*?)` \|", PAGE, re.MULTILINE)
    explained = tomllib.loads("\n".join(f"{key} = {value}" for key, value in shown))
    rule = tomllib.loads((package / IN_HAND).read_text("utf-8"))["in_hand"]
    assert explained == msgspec.to_builtins(msgspec.convert(rule, InHandRule))


def test_every_command_of_the_page_works_for_the_package(package, capsys) -> None:
    printed = {}
    for line in COMMANDS.splitlines()[1:]:
        program, *arguments = shlex.split(line, comments=True)
        if program == "python":
            subprocess.run([sys.executable, *arguments], check=True, timeout=120)
        else:
            assert program == "prbench"
            assert main(arguments) == 0, line
            printed[arguments[0]] = printed.get(arguments[0], "") + capsys.readouterr().out
    assert "tabletop (tabletop), for: benchmark" in printed["datasets"]
    assert "2 recordings (2 complete)" in printed["inspect"]
    assert "prime-and-reach sequences" in printed["inspect"]
    assert "cup" in printed["explain"]
    assert "doe2026tabletop" in printed["datasets"]

    table = SequenceTable.open(package / "tables" / "tabletop")
    assert table.info.dataset == "tabletop"
    assert table.info.counts.sequences == 2
    tracked = SequenceTable.open(package / "tables" / "tracked")
    found = tracked.events().select(["action", "hand", "outcome"]).to_pylist()
    events = [(each["action"], each["hand"], each["outcome"]) for each in found]
    assert sorted(events) == [("pick", "right", "sequence")] * 2 + [("put", "right", "sequence")] * 2
    np.testing.assert_allclose(sorted(tracked.scalars()["event_time"].to_pylist()), [10, 10, 12, 12], atol=0.05)


def test_the_package_is_listed_beside_those_of_prbench(package, capsys) -> None:
    assert "tabletop" in readable_datasets()
    assert "adt" in readable_datasets()
    assert (find_reader("tabletop").package, find_reader("tabletop").built_in) == ("prbench-tabletop", False)
    assert main(["datasets"]) == 0
    printed = capsys.readouterr().out
    assert "tabletop" in printed
    assert "!" not in printed
