"""``prbench build-corpus`` and ``prbench synthesize nymeria`` as a user meets them."""

from __future__ import annotations

import json

import pytest

from prbench.cli.main import main
from tests.cli.reports import refused, reported


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    root = tmp_path_factory.mktemp("cli") / "tree"
    arguments = ["synthesize", "nymeria", "--count", "2", "--seed", "9", "--out", str(root)]
    assert main(arguments) == 0
    min(root.glob("*/body/xdata.npz")).unlink()
    return root


def test_what_was_left_out_is_told_by_message_and_exit_code(tree, tmp_path, capsys):
    assert main(["build-corpus", "nymeria", "--root", str(tree), "--out", str(tmp_path / "c")]) == 3
    shown = capsys.readouterr()
    assert "recordings read" in shown.out
    assert "1 failed, 0 skipped" in shown.out
    assert "xdata.npz: expected this file" in shown.err
    info = json.loads((tmp_path / "c" / "corpus.json").read_text())
    assert info["counts"]["recordings_failed"] == 1
    assert info["counts"]["clips"] > 5


def test_on_error_fail_ends_the_build(tree, tmp_path, capsys):
    out = tmp_path / "c"
    assert main(["build-corpus", "nymeria", "--root", str(tree), "--out", str(out), "--on-error", "fail"]) == 3
    assert "expected this file" in capsys.readouterr().err
    assert not out.exists()


def test_the_dry_run_writes_nothing(tree, tmp_path, capsys):
    assert main(["build-corpus", "nymeria", "--root", str(tree), "--dry-run"]) == 0
    assert "2 recordings" in capsys.readouterr().out
    assert main(["build-corpus", "synthetic", "--count", "100", "--dry-run"]) == 0
    assert "100 recordings" in capsys.readouterr().out
    assert list(tmp_path.iterdir()) == []


def test_a_synthetic_corpus_from_a_number_and_a_seed(tmp_path, capsys):
    out = tmp_path / "c"
    arguments = ["build-corpus", "synthetic", "--count", "2", "--seed", "4", "--max-recordings", "1", "--fps", "30"]
    assert main([*arguments, "--out", str(out)]) == 0
    info = json.loads((out / "corpus.json").read_text())
    assert info["dataset"] == "synthetic-corpus"
    assert info["counts"]["recordings_found"] == 1
    assert (info["options"]["fps"], info["options"]["reader.seed"]) == ("30", "4")
    assert str(tmp_path) not in (out / "corpus.json").read_text()
    assert "corpus:" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["nymerya", "--out", "x"], "nymeria, humanml3d, synthetic"),
        (["nymeria", "--root", "."], "--out DIR is needed"),
        (["nymeria", "--root", ".", "--count", "3", "--out", "x"], "--count: belongs to the corpus 'synthetic'"),
        (["synthetic", "--root", ".", "--out", "x"], "reads no files"),
        (["synthetic", "--out", "x", "--option", "sed=3"], "Did you mean 'seed'"),
    ],
)
def test_wrong_usage_is_answered(arguments, says, capsys):
    assert main(["build-corpus", *arguments]) == 2
    assert says in capsys.readouterr().err


def test_a_build_reports_its_clips_and_every_recording(tree, tmp_path, capsys):
    words = ["build-corpus", "nymeria", "--root", str(tree), "--out", str(tmp_path / "c")]
    report = reported(words, capsys, code=3)
    assert report.built == {str(tmp_path / "c"): json.loads((tmp_path / "c" / "corpus.json").read_text())}
    (plan,) = reported(["build-corpus", "synthetic", "--count", "3", "--dry-run"], capsys).planned
    assert (len(plan.recordings), plan.root) == (3, None)
    refused(["build-corpus", "nymerya", "--out", "x"], capsys, code=2, message="nymeria, humanml3d, synthetic")
