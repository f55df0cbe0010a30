"""The commands of the page about real data run as they are printed, at a thousandth of their size."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from prbench.cli import main
from tests.test_architecture import ROOT

PAGE = (ROOT / "docs" / "real-data.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```bash\n(.*?)```", PAGE, re.DOTALL)
# Seed, recordings and events of each that leave sequences for training and for the test in every layout.
RECORDINGS = {
    "hd-epic": (3, 7, 4),
    "mogaze": (0, 4, 2),
    "hot3d": (4, 3, 2),
    "adt": (0, 3, 3),
    "gimo": (3, 3, 2),
}
# What a laptop has less of: the value of an option on the page, and in the rehearsal.
SMALLER = {
    "--config": {"paper": "smoke"},
    "--device": {"cuda": "cpu"},
    "--loaders": {"2": "0", "8": "0"},
    "--workers": {"8": "1"},
    "--limit": {"200": "1"},
    "--condition": {"all": "goal-loc"},
}
# Searches that take a minute a motion at their full length.
FEWER = [f"--option={key}=1" for key in ("dart.iterations", "dno.iterations", "pr.iterations")]


def rehearsed(words: list[str]) -> list[str]:
    """A command of the page at its smaller size, with patterns of files as a shell would have expanded them."""
    found: list[str] = []
    for before, word in zip(["", *words], words):
        files = sorted(map(str, Path().glob(word))) if "*" in word else []
        if words[0] in ("run", "study"):
            files = files[:1]
        found += files or [SMALLER.get(before, {}).get(word, word)]
    return found + (FEWER if words[0] == "run" else [])


@pytest.mark.slow
@pytest.mark.unchecked_shapes
def test_the_commands_of_the_page_lead_from_recordings_to_table_2(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))
    assert main(["synthesize", "nymeria", "--count", "2", "--out", "data/nymeria", "--quiet"]) == 0
    for layout, (seed, count, events) in RECORDINGS.items():
        words = ["--seed", str(seed), "--count", str(count), "--events", str(events), "--bystander-objects", "3"]
        assert main(["synthesize", layout, *words, "--out", f"data/{layout}", "--quiet"]) == 0
    for line in "".join(BLOCKS).splitlines():
        program, *words = shlex.split(line)
        if program == "ln":
            Path(words[2]).symlink_to(words[1])
        elif program == "prbench":
            capsys.readouterr()
            assert main(rehearsed(words)) == 0, f"{line}\n{capsys.readouterr().err}"
    trained = {path.parent.name for path in Path("trained").glob("*/weights.safetensors")}
    assert len(trained) == 12, "a folder for every name that a row looks for"
    assert "goal-loc" in Path("table_2.csv").read_text(encoding="utf-8")
    rows = {path.name for path in Path("runs/table-2/rows").iterdir()}
    assert {f"goal-loc-{method}-finetuned" for method in ("dno", "dart", "wandr")} < rows
