"""``prbench build-windows`` as a user meets it."""

from __future__ import annotations

import pytest

from prbench.cli.main import main
from tests.benchmarks.motion_prediction.windows import mogaze
from tests.cli.reports import refused, reported
from tests.fakes import fake_dataset


def test_recordings_become_windows(tmp_path, capsys):
    words = ["build-windows", "mogaze", "--root", str(mogaze()), "--out", str(tmp_path / "w")]
    report = reported(words, capsys)
    assert report.built is not None
    assert (report.built.joint_set, report.built.outcomes) == ("mogaze21", {"window": 6})


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
