"""Submissions hold finished runs and what their authors say; nothing else can be packed into one or put in later."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from prbench.board.submission import (
    FILE_NAME,
    RUNS,
    TrainingData,
    declared_training,
    open_submission,
    pack,
    read_submission,
)
from prbench.cli.main import main
from prbench.errors import InputFileError, PrbenchError, RedistributionError, UsageError
from prbench.files.archives import open_archive, write_archive
from prbench.files.storage import bytes_digest
from prbench.harness.request import RunRequest
from prbench.harness.results import RunChecker
from prbench.harness.run import run_method
from prbench.harness.run_folder.signature import SIGNATURE, SUMS
from tests.board.submissions import DATASET, edit_json, made, repacked, submitted
from tests.fakes import fake_dataset


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    """A copy to break."""
    shutil.copytree(made() / "runs", tmp_path / "runs")
    return tmp_path / "runs"


def test_a_submission_holds_the_runs_and_comes_back_as_run_folders(tmp_path, capsys):
    words = ["--name", "Großes Ding", "--author", "A. B.", "--author", "C. D.", "--url", "https://example.org/x"]
    out = tmp_path / "a.prbench.zip"
    assert main(["leaderboard", "submit", str(made() / "runs"), "--out", str(out), *words, "--trained-on", "none"]) == 0
    assert "3 runs, 18 files; training data: declared none" in capsys.readouterr().out
    submission = open_submission(out, tmp_path / "unpacked")
    assert submission == read_submission(tmp_path / "unpacked")
    assert (submission.name, submission.authors) == ("Großes Ding", ("A. B.", "C. D."))
    assert submission.id == f"gro-es-ding-{submission.digest[:10]}"
    assert submission.digest == bytes_digest((tmp_path / "unpacked" / FILE_NAME).read_bytes())
    assert list(submission.runs) == ["people", "scripted", "still"]
    (table,) = submission.runs["still"].tables
    assert (table.dataset, table.sequences) == (DATASET, 8)
    for name in submission.members:
        assert (tmp_path / "unpacked" / name).read_bytes() == (made() / name).read_bytes()


def test_equal_runs_give_equal_bytes_wherever_they_lie(tmp_path, runs):
    submitted(tmp_path / "a.zip", "still", "people")
    pack([runs / "people", runs / "still", runs / "still"], tmp_path / "b.zip", checker=RunChecker(), name="Mine")
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()
    assert str(made()).encode() not in (tmp_path / "a.zip").read_bytes()


def test_runs_of_one_name_stand_beside_one_another(tmp_path, runs):
    shutil.copytree(runs / "still", tmp_path / "more" / "still")
    shutil.copytree(runs / "still", tmp_path / "still!")
    found = pack(
        [runs / "still", tmp_path / "more", tmp_path / "still!"], tmp_path / "a.zip", checker=RunChecker(), name="M"
    )
    assert list(found.runs) == ["still", "still--2", "still--3"]


def test_all_folds_of_a_run_are_submitted_and_verified_together(tmp_path):
    table = fake_dataset(tmp_path / "table", 20, recordings=10).folder
    out = tmp_path / "folds"
    words = ["--method", "static", "--condition", "none", "--folds", "participant", "--data", str(table), "-q"]
    assert main(["run", *words, "--out", str(out)]) == 0
    file = str(tmp_path / "a.zip")
    assert main(["leaderboard", "submit", str(out), "--out", file, "--name", "Folds"]) == 0
    assert main(["leaderboard", "verify", file, "--data", str(table)]) == 0
    assert main(["leaderboard", "submit", str(out / "merged"), "--out", str(tmp_path / "b.zip"), "--name", "F"]) == 7
    assert not (tmp_path / "b.zip").exists()


@pytest.mark.parametrize("rate", [[], ["--native-fps", "30"]])
def test_motions_from_a_file_are_submitted_where_scoring_has_kept_them(tmp_path, capsys, rate):
    table = str(made() / "table")
    file = tmp_path / "conditions.npz"
    words = ["--condition", "goal-loc", *rate, "--data", table, "--out", str(file), "-q"]
    assert main(["export-conditions", *words]) == 0
    given = np.load(file)
    n_frames = given["n_frames"]
    moved = np.linspace(0, 1, n_frames.max())[None, :, None, None] * np.array([0.1, 0.0, 0.5])
    motions = {"joints": given["initial_joints"][:, None] + moved, "n_frames": n_frames}
    np.savez(tmp_path / "mine.npz", opaque_id=given["opaque_id"], **motions)
    score = ["score", str(tmp_path / "mine.npz"), "--conditions", str(file), "--data", table, "-q"]
    submit = ["leaderboard", "submit", str(tmp_path / "mine"), "--out", str(tmp_path / "a.zip"), "--name", "Mine"]
    assert main([*score, "--keep-motions"]) == 2
    assert main([*score, "--out", str(tmp_path / "mine")]) == 0
    assert main(submit) == 7
    assert "its folder holds no motions; `prbench score FILE --keep-motions" in capsys.readouterr().err
    assert main([*score, "--out", str(tmp_path / "mine"), "--keep-motions"]) == 0
    assert main([*submit, "--data", table]) == 0
    assert main(["leaderboard", "verify", str(tmp_path / "a.zip"), "--data", table]) == 0
    assert "verified on tables of the same values: 1 run, 8 sequences" in capsys.readouterr().out


def test_runs_of_another_benchmark_are_submitted_in_a_file_of_their_own(tmp_path, capsys):
    windows = str(tmp_path / "windows")
    run = str(tmp_path / "run")
    assert main(["build-windows", "--data", str(made() / "table"), "--out", windows, "-q"]) == 0
    words = ["--benchmark", "motion-prediction", "--method", "zero-velocity", "--condition", "pose", "--data", windows]
    assert main(["run", *words, "--out", run, "-q"]) == 0
    submit = ["leaderboard", "submit", run, "--out", str(tmp_path / "a.zip"), "--name", "W", "--trained-on"]
    assert main([*submit, f"{DATASET}:all"]) == 0
    assert main(["leaderboard", "verify", str(tmp_path / "a.zip"), "--data", windows]) == 0
    assert "overlaps 4 test recordings" in capsys.readouterr().out
    assert main([*submit, "none", str(made() / "runs/still")]) == 7


def break_sums(run: Path) -> None:
    (run / SUMS).write_text(f"{'0' * 64}  run.json\n")
    (run / SIGNATURE).write_text("not looked at without a key")


BROKEN = {
    "unfinished": (lambda run: (run / DATASET / "summary.json").unlink(), "not finished on synthetic-adt"),
    "without motions": (lambda run: shutil.rmtree(run / DATASET / "predictions"), "its folder holds no motions"),
    "edited": (lambda run: edit_json(run / DATASET / "summary.json", recordings=3), "recordings: expected"),
    "cut scores": (lambda run: (run / DATASET / "scores.parquet").write_bytes(b"PAR1"), "not finished"),
    "changed after signing": (break_sums, "was changed, added or removed after it was signed"),
    "another protocol": (lambda run: edit_json(run / "run.json", protocol_digest="0" * 64), "another protocol"),
    "no run": (lambda run: shutil.rmtree(run), "expected a run folder"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_run_is_not_packed_and_nothing_is_written(tmp_path, runs, name):
    damage, message = BROKEN[name]
    damage(runs / "still")
    with pytest.raises(PrbenchError, match=message):
        pack([runs / "people", runs / "still"], tmp_path / "out" / "a.zip", checker=RunChecker(), name="Mine")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("about", "message"),
    [
        ({"name": ""}, "name"),
        ({"name": "a\x1b[31m"}, "name"),
        ({"url": "javascript:alert(1)"}, "url"),
        ({"code": "https://a.b/<script>"}, "code"),
        ({"contact": "x" * 301}, "contact"),
    ],
)
def test_what_authors_say_has_a_form(tmp_path, about, message):
    with pytest.raises(UsageError, match=message):
        submitted(tmp_path / "a.zip", **about)


@pytest.mark.parametrize("redistribution", ["none", "non-commercial"])
def test_recorded_motion_that_its_licence_keeps_needs_the_users_word(tmp_path, redistribution):
    table = fake_dataset(tmp_path / "table", 8, recordings=4, redistribution=redistribution).folder
    for method in ("ground-truth", "scripted"):
        run_method(RunRequest(method=method, data=(table,), out=tmp_path / method))
    given = {"checker": RunChecker(), "name": "Mine"}
    with pytest.raises(
        RedistributionError, match=r"motions of 'ground-truth' in a submission .* --permission synthetic"
    ):
        pack([tmp_path / "scripted", tmp_path / "ground-truth"], tmp_path / "a.zip", **given)
    assert not (tmp_path / "a.zip").exists()
    pack([tmp_path / "scripted"], tmp_path / "a.zip", **given)  # its motions are nobody's
    assert pack([tmp_path / "ground-truth"], tmp_path / "a.zip", permitted=(DATASET,), **given).permission == (DATASET,)


def listing(change: Callable[[dict], object]) -> Callable[[Path], None]:
    """Change submission.json alone."""

    def forge(folder: Path) -> None:
        values = json.loads((folder / FILE_NAME).read_text())
        change(values)
        (folder / FILE_NAME).write_text(json.dumps(values))

    return forge


def added(name: str, content: bytes = b"PK\x05\x06") -> Callable[[Path], None]:
    """Put a file beside the runs, and list it."""

    def forge(folder: Path) -> None:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
        repacked(folder, folder.parent / "unused.zip")
        listing(lambda values: values["members"].update({name: bytes_digest(content)}))(folder)

    return forge


STILL = f"{RUNS}/still"


def twice(folder: Path) -> None:
    record = json.loads((folder / STILL / "run.json").read_text())
    edit_json(folder / STILL / "run.json", tables=record["tables"] * 2)
    with open_archive(repacked(folder, folder.parent / "unused.zip")) as archive:
        (folder / FILE_NAME).write_bytes(archive.read(FILE_NAME))


HOSTILE = {
    "a changed file": (lambda folder: (folder / STILL / "run.json").write_bytes(b"{}"), "the file was changed"),
    "a file that is not listed": (
        lambda folder: (folder / STILL / "more.json").write_bytes(b"{}"), "more.json: .* found one more",
    ),
    "a file that is missing": (lambda folder: (folder / STILL / DATASET / "cost.json").unlink(), "found no such file"),
    "an archive in it": (added(f"{STILL}/inner.zip"), "inner.zip: .* found a file that no run has"),
    "a notice that is none": (added(f"{STILL}/{DATASET}/NOTICE.txt", b"Buy this!"), "NOTICE.txt: expected the notice"),
    "sums that do not fit": (added(f"{STILL}/SHA256SUMS", b"0  run.json"), "was changed, added or removed"),
    "a dataset twice": (twice, "each dataset once"),
    "a program": (added(f"{STILL}/{DATASET}/run.py"), "a file that no run has"),
    "a run that is not described": (added(f"{RUNS}/other/run.json", b"{}"), "a file that no run has"),
    "no list": (lambda folder: (folder / FILE_NAME).unlink(), "a submission .with submission.json., found none"),
    "no JSON": (lambda folder: (folder / FILE_NAME).write_bytes(b"{"), "the form of a submission"),
    "deep JSON": (lambda folder: (folder / FILE_NAME).write_bytes(b"[" * 10**6), "the form of a submission"),
    "huge JSON": (lambda folder: (folder / FILE_NAME).write_bytes(b" " * (2**26 + 1)), "at most 67,108,864 bytes"),
    "another version": (listing(lambda values: values.update(schema_version=2)), "schema_version"),
    "a key too many": (listing(lambda values: values.update(note="x")), "note"),
    "a run elsewhere": (listing(lambda values: values["runs"].update({"../../x": values["runs"]["still"]})), "runs"),
    "no run": (listing(lambda values: values.update(runs={})), "runs"),
    "another run": (listing(lambda values: values["runs"]["still"].update(seed=5)), "run still: expected the run.json"),
    "two protocols": (listing(lambda values: values.update(protocol_digest="0" * 64)), "protocol of the submission"),
    "a script as address": (listing(lambda values: values.update(url="javascript:alert(1)")), "url"),
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_a_file_that_does_not_hold_what_it_lists_leaves_nothing_behind(tmp_path, name):
    forge, message = HOSTILE[name]
    folder = tmp_path / "forged"
    open_submission(submitted(tmp_path / "honest.zip"), folder)
    forge(folder)
    files = {path.relative_to(folder).as_posix(): path for path in folder.rglob("*") if path.is_file()}
    write_archive(tmp_path / "forged.zip", files)
    with pytest.raises(PrbenchError, match=message):
        open_submission(tmp_path / "forged.zip", tmp_path / "out" / "unpacked")
    assert not list(tmp_path.glob("out/*"))
    with pytest.raises(PrbenchError, match=message):
        read_submission(folder)


def test_a_link_in_an_unpacked_submission_is_refused(tmp_path):
    open_submission(submitted(tmp_path / "a.zip"), tmp_path / "folder")
    path = tmp_path / "folder" / STILL / "run.json"
    path.rename(tmp_path / "run.json")
    path.symlink_to(tmp_path / "run.json")
    with pytest.raises(InputFileError, match=r"run.json: expected plain files, found a link"):
        read_submission(tmp_path / "folder")


@pytest.mark.parametrize(
    ("texts", "words"),
    [
        (["none"], "declared none"),
        (["adt"], "declared adt (train split)"),
        (["adt:all", "gimo:3,7"], "declared adt (all of it), gimo (participants 3, 7)"),
    ],
)
def test_training_data_are_declared_in_short(texts, words):
    assert declared_training(texts).words == words


@pytest.mark.parametrize("texts", [["none", "adt"], [""], ["adt:,"], ["atd"]])
def test_a_contradictory_declaration_is_refused(texts):
    with pytest.raises(UsageError, match="training data: "):
        declared_training(texts)


def test_training_data_are_declared_in_a_file_that_names_recordings_by_digests_alone(tmp_path, capsys):
    path = tmp_path / "training.toml"
    lines = ['licence = "CC BY 4.0"', 'corpora = ["AMASS"]', f'recordings = ["{DATASET}/rec001", "adt/secret"]']
    path.write_text("\n".join(lines))
    out = tmp_path / "a.zip"
    words = ["leaderboard", "submit", str(made() / "runs/still"), "--out", str(out), "--name", "M"]
    assert main([*words, "--trained-on", str(path)]) == 0
    with open_archive(out) as archive:
        assert b"secret" not in archive.read(FILE_NAME)
    assert main(["leaderboard", "verify", str(out), "--data", str(made() / "table")]) == 0
    assert "training data: overlaps 1 test recordings" in capsys.readouterr().out
    path.write_text("corpus = ['AMASS']")
    assert main([*words, "--trained-on", str(path)]) == 2


def test_the_recordings_of_a_declared_split_are_listed_by_their_digests(tmp_path):
    checker = RunChecker(lambda _: fake_dataset(tmp_path / "table", 32, recordings=16))
    training = declared_training([DATASET])
    found = pack([made() / "runs/still"], tmp_path / "a.zip", checker=checker, training=training, name="M").training
    assert isinstance(found, TrainingData)
    expected = sorted(bytes_digest(f"{DATASET}/rec{number:03d}".encode()) for number in range(0, 16, 2))
    assert list(found.recordings) == expected
