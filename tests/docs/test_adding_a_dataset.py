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
EXAMPLE = DOCS / "examples" / "tabletop"
FILES = {
    str(path.relative_to(EXAMPLE)): path.read_text("utf-8") for path in EXAMPLE.rglob("*.*") if path.suffix != ".pyc"
}
COMMANDS = "".join(re.findall(r"^```bash\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE))


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The files of the example in one folder, installed by their metadata; a folder to work in."""
    for name, text in FILES.items():
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
    project = tomllib.loads(FILES["pyproject.toml"])["project"]
    info = tmp_path / "src" / "prbench_tabletop-0.1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n")
    (name, points), *others = project["entry-points"].items()
    assert not others
    lines = [f"[{name}]", *(f"{dataset} = {target}" for dataset, target in points.items())]
    (info / "entry_points.txt").write_text("\n".join(lines))
    monkeypatch.syspath_prepend(str(tmp_path / "src"))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "src"))
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_page_shows_lines_of_the_package_as_they_stand() -> None:
    (shown,) = re.findall(r"^```toml\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
    assert shown.strip() in FILES["pyproject.toml"]


def test_every_key_of_the_in_hand_rule_is_explained_with_the_value_of_the_example() -> None:
    shown = re.findall(r"^\| `(\w+)` \| `(.*?)` \|", PAGE, re.MULTILINE)
    explained = tomllib.loads("\n".join(f"{key} = {value}" for key, value in shown))
    rule = tomllib.loads(FILES["src/prbench_tabletop/tabletop-tracked.toml"])["in_hand"]
    assert explained == msgspec.to_builtins(msgspec.convert(rule, InHandRule))


def test_every_command_of_the_page_works_for_the_package(package, capsys) -> None:
    printed = {}
    for line in COMMANDS.splitlines():
        program, *arguments = shlex.split(line, comments=True)
        if program == "python":
            subprocess.run([sys.executable, *arguments], check=True, timeout=120)
        else:
            assert program == "prbench"
            assert main(arguments) == 0, line
            printed[arguments[0]] = printed.get(arguments[0], "") + capsys.readouterr().out
    assert "Tabletop (tabletop), for: benchmark" in printed["datasets"]
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
    assert "Tabletop" in printed
    assert "!" not in printed
