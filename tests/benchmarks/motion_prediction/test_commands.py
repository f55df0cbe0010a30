"""``prbench build-windows`` as a user meets it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from prbench.cli.main import main
from prbench.readers.mogaze.format import Segment
from prbench.readers.mogaze.synthetic import write
from tests.cli.reports import refused, reported
from tests.fakes import fake_dataset
from tests.recording.mogaze_scene import CUP, GOGGLES, PLATE, TABLE, N, still_life


@pytest.fixture
def root(tmp_path):
    write(replace(still_life(), segments=(Segment(0, N, "null"),)), tmp_path / "mogaze")
    names = {CUP: "cup_red", PLATE: "plate_red", GOGGLES: "goggles", TABLE: "table"}
    bodies = "".join(f'<body id="{key}" name="{name}"/>' for key, name in names.items())
    (tmp_path / "mogaze" / "scene.xml").write_text(f"<scene>{bodies}</scene>")
    return tmp_path / "mogaze"


def test_recordings_become_windows(root, tmp_path, capsys):
    words = ["build-windows", "mogaze", "--root", str(root), "--out", str(tmp_path / "w")]
    report = reported(words, capsys)
    assert report.built is not None
    assert (report.built.joint_set, report.built.outcomes) == ("mogaze21", {"window": 3})


def test_a_table_becomes_anchored_windows(tmp_path, capsys):
    fake_dataset(tmp_path / "table", 4)
    assert main(["build-windows", "--data", str(tmp_path / "table"), "--out", str(tmp_path / "w")]) == 0
    assert "20 frames a second" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--out", "z"), "expected either DATASET with --root DIR, or --data DIR alone"),
        (("adt", "--out", "z"), "expected either DATASET"),
        (("adt", "--root", "x", "--data", "y", "--out", "z"), "expected either DATASET"),
        (("adt", "--root", "x"), "'--out'"),
        (("--data", "y", "--out", "z", "--joints", "native"), "leave the other options out"),
    ],
)
def test_a_wrong_call_says_what_is_expected(words, message, capsys):
    refused(["build-windows", *words], capsys, code=2, message=message)
