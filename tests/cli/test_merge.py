"""``--shard`` and ``prbench merge`` as a user meets them."""

from __future__ import annotations

from pathlib import Path

import pytest

from prbench.cli.main import main
from tests.cli.reports import refused, reported
from tests.curation.sources import folder_bytes
from tests.fakes import fake_dataset


@pytest.fixture(scope="module")
def recordings(tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("merge") / "adt"
    assert main(["synthesize", "adt", "--count", "3", "--events", "2", "--out", str(root)]) == 0
    return root


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
    assert report.shard is not None
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
    report = reported([*words, "--out", folders[0], "--shard", "1/4"], capsys)
    assert report.shard is not None
    assert report.shard.planned == 3
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
    root = tmp_path / "adt"
    (root / "x").mkdir(parents=True)
    for path in recordings.rglob("*"):
        target = root / path.relative_to(recordings)
        target.mkdir(parents=True, exist_ok=True) if path.is_dir() else target.write_bytes(path.read_bytes())
    (root / "x").rmdir()
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
