"""``prbench export-conditions``, ``score``, ``--shard`` and ``merge`` as a user or a program meets them."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from prbench.cli import main
from prbench.harness.offline import read_conditions_file
from prbench.harness.run_folder import DatasetSummary
from tests.cli.reports import printed_document, refused, reported
from tests.curation.sources import folder_bytes
from tests.fakes import fake_dataset
from tests.shared import made_once


@pytest.fixture
def data(tmp_path):
    return fake_dataset(tmp_path / "table", 24).folder


def test_from_conditions_to_scores_everything_is_reported(data, tmp_path, capsys):
    conditions = tmp_path / "conditions.npz"
    asked = ["export-conditions", "--data", str(data), "--condition", "goal-loc", "--out", str(conditions)]
    exported = reported([*asked, "--samples", "2"], capsys)
    assert (exported.out, list(exported.sequences)) == (conditions, ["synthetic-adt"])
    assert exported.rows == 2 * exported.sequences["synthetic-adt"]

    given = read_conditions_file(conditions)
    assert given.initial_joints is not None
    longest = int(given.n_frames.max())
    joints = np.repeat(given.initial_joints[:, None], longest, axis=1)
    predictions = tmp_path / "predictions.npz"
    np.savez(
        predictions, joints=joints, n_frames=given.n_frames, opaque_id=given.opaque_id, sample=np.asarray(given.sample)
    )
    out = tmp_path / "scores"
    words = ["score", str(predictions), "--conditions", str(conditions), "--data", str(data), "--out", str(out)]
    (dataset,) = reported([*words, "--name", "still"], capsys)
    scores = dataset.scores
    assert dataset.origin == "file predictions.npz"
    summary = DatasetSummary.read(out / "synthetic-adt")
    assert (scores.method, scores.condition, scores.samples) == ("still", "goal-loc", 2)
    assert scores.sequences == summary.sequences == exported.sequences["synthetic-adt"]
    assert {each.metric: (each.mean, each.low) for each in scores.metrics} == {
        each.metric: (each.mean, each.low) for each in summary.metrics
    }


def test_what_is_said_beside_the_report_is_listed_in_the_document(data, tmp_path, capsys):
    words = ["export-conditions", "--data", str(data), "--condition", "text", "--out", str(tmp_path / "c.npz")]
    document = printed_document(words, capsys, code=0)
    assert document.command == "export-conditions"
    assert any(note.startswith("then: prbench score PREDICTIONS --conditions") for note in document.notes)


def test_mistakes_are_errors_in_the_document(data, tmp_path, capsys):
    words = ["export-conditions", "--data", str(data), "--condition", "none", "--out", str(tmp_path / "c.csv")]
    refused(words, capsys, code=2, message="ends in .npz")
    words = ["score", str(tmp_path / "gone.npz"), "--data", str(data)]
    refused(words, capsys, code=6, message="gone.npz")


@pytest.fixture(scope="module")
def recordings() -> Path:
    words = ["synthesize", "adt", "--count", "3", "--events", "2", "--out"]
    return made_once("three-adt", lambda root: main([*words, str(root)]))


def shards_of(folder: Path, words: list[str], count: int) -> list[str]:
    folders = [str(folder / f"shard-{number}") for number in range(1, count + 1)]
    for number, out in enumerate(folders, start=1):
        assert main([*words, "--out", out, "--shard", f"{number}/{count}"]) == 0
    return folders


def test_a_dataset_in_shards_has_the_bytes_of_one_build(recordings, tmp_path, capsys):
    words = ["build-dataset", "adt", "--root", str(recordings)]
    assert main([*words, "--out", str(tmp_path / "whole")]) == 0
    folders = shards_of(tmp_path, words, 2)
    assert "shard 1/2: 1 of 3 recordings" in capsys.readouterr().out
    report = reported([*words, "--out", folders[0], "--shard", "1/2"], capsys)
    assert (report.shard.shard, report.shard.made_of, report.shard.taken_over) == ("1/2", 1, 1)
    merged = reported(["merge", *folders, "--out", str(tmp_path / "merged")], capsys, kind="of tables")
    assert merged.built[str(tmp_path / "merged")]["counts"]["recordings_read"] == 3
    assert folder_bytes(tmp_path / "merged") == folder_bytes(tmp_path / "whole")
    # Everything but a merge says what the folder is.
    words = ["diff", folders[0], folders[0]]
    refused(words, capsys, code=4, message="found a shard, which `prbench merge` puts together")


def test_windows_in_shards_have_the_bytes_of_one_build(recordings, tmp_path, capsys):
    words = ["build-windows", "adt", "--root", str(recordings)]
    assert main([*words, "--out", str(tmp_path / "whole")]) == 0
    folders = shards_of(tmp_path, words, 4)
    assert "there are fewer recordings than shards: shard 4/4 is empty" in capsys.readouterr().err
    assert reported([*words, "--out", folders[0], "--shard", "1/4"], capsys).shard.planned == 3
    assert main(["merge", *folders, "--out", str(tmp_path / "merged")]) == 0
    assert folder_bytes(tmp_path / "merged") == folder_bytes(tmp_path / "whole")


def test_a_corpus_in_shards_has_the_bytes_of_one_build(tmp_path, capsys):
    words = ["build-corpus", "synthetic", "--count", "3", "--seed", "2"]
    assert main([*words, "--out", str(tmp_path / "whole")]) == 0
    folders = shards_of(tmp_path, words, 2)
    capsys.readouterr()
    merged = reported(["merge", *folders, "--out", str(tmp_path / "merged")], capsys, kind="of tables")
    assert merged.built[str(tmp_path / "merged")]["counts"]["recordings_read"] == 3
    assert folder_bytes(tmp_path / "merged") == folder_bytes(tmp_path / "whole")
    other = ["build-corpus", "synthetic", "--count", "3", "--seed", "3", "--out", str(tmp_path / "other")]
    assert main([*other, "--shard", "2/2"]) == 0
    words = ["merge", folders[0], str(tmp_path / "other"), "--out", str(tmp_path / "mixed")]
    refused(words, capsys, code=14, message="options.source.1.1: expected 2, found 3, unlike")


def test_a_run_in_shards_is_scored_by_the_merge(tmp_path, capsys):
    fake_dataset(tmp_path / "table", 24)
    words = ["run", "--method", "static", "--condition", "none", "--data", str(tmp_path / "table")]
    words += ["--batch-size", "2"]
    assert main([*words, "--out", str(tmp_path / "whole")]) == 0
    folders = shards_of(tmp_path, words, 2)
    assert "shard 2/2: 2 of 3 batches" in capsys.readouterr().out
    report = reported([*words, "--out", folders[0], "--shard", "1/2"], capsys)
    assert [shard.taken_over for shard in report.shards] == [1]
    merged = reported(["merge", *folders, "--out", str(tmp_path / "merged")], capsys, kind="of runs")
    assert merged.runs[0].datasets[0].sequences == 6
    bytes_of = [folder_bytes(tmp_path / name) for name in ("whole", "merged")]
    assert [files.pop("synthetic-adt/cost.json") != b"" for files in bytes_of] == [True, True]
    assert bytes_of[0] == bytes_of[1]


def test_what_could_not_be_read_is_told_by_shard_and_merge(recordings, tmp_path, capsys):
    root = shutil.copytree(recordings, tmp_path / "adt")
    broken = sorted(root.glob("Apartment*"))[1]
    (broken / "aria_trajectory.csv").write_text("nothing\n")
    words = ["build-dataset", "adt", "--root", str(root)]
    folders = [str(tmp_path / f"shard-{number}") for number in (1, 2)]
    codes = [main([*words, "--out", out, "--shard", f"{n}/2"]) for n, out in enumerate(folders, start=1)]
    assert codes == [0, 3]
    assert main(["merge", *folders, "--out", str(tmp_path / "merged")]) == 3
    assert f"failed: {broken.name}" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("build-dataset adt --root x --out y --shard 5/4", "--shard 5/4: expected K/N with K from 1 to N"),
        ("build-dataset all --root x --out y --shard 1/4", "each dataset is merged by itself; name one"),
        ("build-dataset adt --root x --out y --shard 1/4 --replace", "give the option to `prbench merge`"),
        ("build-dataset adt --root x --shard 1/4 --dry-run", "which is of the whole build"),
        ("build-windows --data x --out y --shard 1/4", "windows of a built table are made in one go"),
        ("run --method static --data x --shard 1/4 --view v.png", "the motions are whole after `prbench merge`"),
        ("run --method static --shard 1/4", "a run without --data: name the tables"),
        ("run --method all --data x --shard 1/4", "name one method and one condition"),
    ],
)
def test_an_option_that_does_not_go_with_shards_is_refused(words, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    refused(words.split(), capsys, code=2, message=message)
    assert list(tmp_path.iterdir()) == []


def test_a_wrong_merge_is_refused_before_anything_is_written(recordings, tmp_path, capsys):
    words = ["build-dataset", "adt", "--root", str(recordings)]
    folders = shards_of(tmp_path, words, 2)
    capsys.readouterr()
    out = ["--out", str(tmp_path / "merged")]
    refused(["merge", folders[0], *out], capsys, code=14, message="expected all 2 shards, found 1: 2/2 missing")
    refused(["merge", folders[0], folders[0], *out], capsys, code=14, message="Name each shard once")
    refused(["merge", str(recordings), *out], capsys, code=14, message="expected a shard (a folder with shard.json")
    refused(["merge", *folders, "--out", folders[1]], capsys, code=2, message="is one of the shards")
    refused(["merge", *folders, *out, "--data", "x"], capsys, code=2, message="--data: belongs to shards of a run")
    assert not (tmp_path / "merged").exists()
