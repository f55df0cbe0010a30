"""A board holds what was verified and nothing else, and its pages are the same wherever they are made."""

from __future__ import annotations

import csv
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from prbench.board.folder import BoardFolder
from prbench.board.pages import PAGES
from prbench.board.submission import declared_training
from prbench.board.upkeep import add_submission, begin_board, build_board, check_board, withdraw_submission
from prbench.cli.main import main
from prbench.contract import Condition
from prbench.errors import PrbenchError, RedistributionError, RunError, StorageError, UsageError
from prbench.files.storage import file_digest
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from tests.board.submissions import edit_json, forged, made, moved_table, submitted
from tests.fakes import fake_dataset
from tests.shared import made_once

ABOUT: dict[str, Any] = {
    "title": "Reach | <b>",
    "url": "https://e.org",
    "contact": "me",
    "maintainers": ("A Lab",),
    "licence": 'CC "BY"',
}
DAY: dict[str, Any] = {"date": "2026-01-02"}


def table() -> Path:
    return made() / "table"


def begun(path: Path) -> Path:
    return begin_board(path, [table()], benchmark="prime-and-reach", **ABOUT).path


def board(path: Path) -> Path:
    """A board with one submission, of a method and of recorded people."""

    def make(folder: Path) -> None:
        file = submitted(
            folder.with_name("first.zip"), "still", "people", name="First", training=declared_training(["none"])
        )
        add_submission(begun(folder), file, [table()], **DAY)

    return Path(shutil.copytree(made_once("board", make), path))


def files_of(path: Path) -> dict[str, bytes]:
    return {file.relative_to(path).as_posix(): file.read_bytes() for file in path.rglob("*") if file.is_file()}


def only(path: Path) -> str:
    (name,) = BoardFolder.open(path).standing
    return name


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def replace_by_link(path: Path) -> None:
    path.rename(path.with_name("moved"))
    path.symlink_to("moved")


def member(path: Path, name: str) -> Path:
    return path / "submissions" / only(path) / "runs" / "still" / name


def test_a_board_is_sound_and_so_is_a_new_one(tmp_path):
    assert check_board(board(tmp_path / "b"), data=[table()]).problems == ()
    new = begun(tmp_path / "new")
    assert check_board(new).problems == ()
    assert check_board(tmp_path / "b", against=new).believed == (only(tmp_path / "b"),)
    assert check_board(tmp_path / "b", against=new, data=[table()]).believed == ()


def test_scoring_again_finds_what_a_pull_request_made_up(tmp_path):
    path = board(tmp_path / "b")
    file = path / "verification" / f"{only(path)}.json"
    before = file_digest(file)
    edit_json(file, verdict="verified by everybody")
    edit(path / "history.jsonl", before, file_digest(file))
    build_board(path)
    assert check_board(path).problems == ()  # nothing here can know
    (problem,) = check_board(path, data=[table()]).problems
    assert "which scoring again finds, found others" in problem


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        (lambda path: (path / "submissions/new-0123456789").mkdir() or (path / "submissions/new-0123456789/x").touch(),
         "x: belongs to nothing on the board"),
        (lambda path: (path / "motions.npz").touch(), "motions.npz: belongs to nothing"),
        (lambda path: replace_by_link(member(path, "run.json")), "found a link"),
        (lambda path: replace_by_link(path / "submissions" / only(path)), "found a link"),
        (lambda path: (path / "docs").symlink_to("/etc"), "docs: expected a plain file, found a link"),
        (lambda path: edit(member(path, "synthetic-adt/summary.json"), '"sequences": 8', '"sequences": 9'),
         "the file was changed"),
        (lambda path: member(path, "synthetic-adt/scores.parquet").unlink(), "found no such file"),
        (lambda path: edit_json(path / "verification" / f"{only(path)}.json", verdict="splendid"), "one was edited"),
        (lambda path: edit_json(path / f"submissions/{only(path)}/submission.json", name="Two"), "one was edited"),
        (lambda path: edit(path / "history.jsonl", '"First"', '"Best"'), "one was edited"),
        (lambda path: (path / "history.jsonl").write_text(""), "belongs to nothing on the board"),
        (lambda path: edit(path / "board.toml", 'redistribution = "yes"', 'redistribution = "none"'), "--permission"),
        (lambda path: edit(path / "leaderboard.csv", "static", "mine"), "leaderboard.csv: is not made of"),
        (lambda path: edit(path / "board.toml", 'identity = "', 'identity = "zz'), "identity: expected"),
    ],
)  # fmt: skip
def test_what_no_command_has_put_there_is_found_and_keeps_pages_from_being_made(tmp_path, damage, told):
    path = board(tmp_path / "b")
    damage(path)
    try:
        problems = " ".join(check_board(path).problems)
    except PrbenchError as error:
        problems = str(error)
    assert told in problems
    if "is not made" not in told:
        with pytest.raises(PrbenchError):
            build_board(path)


LINE = json.dumps({"date": "2026-01-02", "action": "add", "id": "a-0123456789"}) + "\n"


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda lines: ["<<<<<<< HEAD\n", *lines], "line 1: expected an entry, found a merge conflict's marker"),
        (lambda lines: [*lines, "=======\n"], "line 2: expected an entry, found a merge conflict's marker"),
        (lambda lines: lines * 2, "line 2: expected a new submission"),
        (lambda lines: [line.replace("2026-01-02", "2026-13-02") for line in lines], "line 1: expected an entry"),
        (lambda lines: [LINE.replace("a-0", "../a-0")], "line 1: expected an entry"),
        (lambda lines: [LINE.replace("add", "withdraw")], "expected one that stands, and why it went"),
    ],
)
def test_a_history_that_contradicts_itself_is_refused_with_the_line(tmp_path, change, told):
    path = board(tmp_path / "b")
    history = path / "history.jsonl"
    history.write_text("".join(change(history.read_text().splitlines(keepends=True))))
    with pytest.raises(PrbenchError, match=r"history\.jsonl, ") as refused:
        check_board(path)
    assert told in str(refused.value)


def test_the_history_only_grows_and_rules_do_not_change_with_it(tmp_path):
    base, path = board(tmp_path / "base"), board(tmp_path / "b")
    withdraw_submission(path, "First", reason="an error\u2028of <mine>\n| x", **DAY)
    assert check_board(path, against=base).problems == check_board(path, against=base).believed == ()
    (problem,) = check_board(base, against=path).problems
    assert "expected every line of" in problem
    (path / ".github" / "workflows" / "mine.yml").touch()
    (problem,) = check_board(path, against=base).problems
    assert "expected the same board.toml and .github where submissions come or go" in problem


@pytest.mark.parametrize(
    ("names", "name", "told"),
    [
        (("still", "people"), "First", "the same files"),
        (("scripted", "people"), "  FIRST! ", "the same name"),
        (("still", "people"), "Second", "the same motions"),
    ],
)
def test_duplicates_are_refused_and_leave_the_board_as_it_was(tmp_path, names, name, told):
    path = board(tmp_path / "b")
    before = files_of(path)
    file = submitted(tmp_path / "s.zip", *names, name=name, training=declared_training(["none"]))
    with pytest.raises(StorageError, match=told):
        add_submission(path, file, [table()], **DAY)
    assert files_of(path) == before


def test_a_withdrawn_submission_keeps_its_reason_and_returns_only_with_one(tmp_path):
    path = board(tmp_path / "b")
    name = only(path)
    with pytest.raises(UsageError, match=f"no submission .Fist. to withdraw. Those that stand: {name}"):
        withdraw_submission(path, "Fist", reason="x", **DAY)
    with pytest.raises(UsageError, match="--reason: expected why"):
        withdraw_submission(path, name, reason=" ", **DAY)
    withdraw_submission(path, name, reason="trained on test", **DAY)
    assert not list(path.glob("submissions/*")) + list(path.glob("verification/*"))
    assert "withdrawn on 2026-01-02: trained on test" in (path / "leaderboard.md").read_text()
    with pytest.raises(UsageError, match="trained on test"):
        withdraw_submission(path, name, reason="another reason", **DAY)
    renamed = submitted(tmp_path / "s.zip", "still", name="Renamed")
    with pytest.raises(StorageError, match=r"was withdrawn on 2026-01-02: trained on test\. Say why it returns"):
        add_submission(path, renamed, [table()], **DAY)
    entry, _ = add_submission(path, renamed, [table()], reason="it was a mistake", **DAY)
    assert [each.reason for each in BoardFolder.open(path).history] == ["", "trained on test", "it was a mistake"]
    assert check_board(path).problems == ()
    assert entry.name == "Renamed"


def test_runs_under_other_rules_or_on_other_tables_are_refused(tmp_path):
    path = begun(tmp_path / "b")
    other = forged(tmp_path, lambda run: edit_json(run / "run.json", protocol_digest="0" * 64))
    with pytest.raises(RunError, match="expected prime-and-reach under protocol"):
        add_submission(path, other, [table()], **DAY)
    fewer = fake_dataset(tmp_path / "fewer", 30, recordings=16).folder
    run_method(RunRequest(method="static", condition=Condition.NONE, data=(fewer,), out=tmp_path / "run"))
    assert main(["leaderboard", "submit", str(tmp_path / "run"), "--name", "F", "--out", str(tmp_path / "f.zip")]) == 0
    with pytest.raises(RunError, match=r"expected the board's tables \(synthetic-adt"):
        add_submission(path, tmp_path / "f.zip", [fewer], **DAY)
    assert only_pages(path)


def only_pages(path: Path) -> bool:
    return not BoardFolder.open(path).history and check_board(path).problems == ()


def test_runs_on_two_copies_of_the_data_stand_in_one_table(tmp_path):
    path = board(tmp_path / "b")
    elsewhere = moved_table(tmp_path / "moved", 4e-4)
    run_method(RunRequest(method="static", condition=Condition.NONE, data=(elsewhere,), seed=1, out=tmp_path / "run"))
    assert main(["leaderboard", "submit", str(tmp_path / "run"), "--name", "E", "--out", str(tmp_path / "e.zip")]) == 0
    add_submission(path, tmp_path / "e.zip", [table()], **DAY)
    tables = json.loads((path / "leaderboard.json").read_text())["tables"]
    assert [len(each["rows"]) for each in tables] == [3]
    told = {row["submission"].split("-")[0]: row["verified"] for row in tables[0]["rows"]}
    assert told["first"] == "verified"
    assert told["e"].startswith("verified on another copy of the data, within ")
    assert check_board(path, data=[table()]).rescored == tuple(BoardFolder.open(path).standing)


def test_pages_are_the_same_wherever_they_are_made(tmp_path):
    path = board(tmp_path / "b")
    wanted = {name: (path / name).read_bytes() for name in PAGES}
    copy = tmp_path / "another place"
    for file in sorted(path.rglob("*"), reverse=True):  # written in another order
        if file.is_file() and file.name not in PAGES:
            (copy / file.relative_to(path)).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, copy / file.relative_to(path))
    build_board(copy)
    assert {name: (copy / name).read_bytes() for name in PAGES} == wanted
    assert check_board(copy).problems == ()


@pytest.mark.slow
def test_neither_time_zone_nor_language_nor_hash_seed_changes_a_page(tmp_path):
    path = board(tmp_path / "b")
    wanted = {name: (path / name).read_bytes() for name in PAGES}
    for name in PAGES:
        (path / name).unlink()
    settings = os.environ | {
        "TZ": "Asia/Kathmandu",
        "LC_ALL": "tr_TR.UTF-8",
        "PYTHONHASHSEED": "7",
        "OMP_NUM_THREADS": "2",
    }
    command = [sys.executable, "-m", "prbench", "leaderboard", "build", "b"]
    subprocess.run(command, cwd=tmp_path, env=settings, check=True, capture_output=True)
    assert {name: (path / name).read_bytes() for name in PAGES} == wanted


def test_recorded_motion_that_a_licence_keeps_needs_the_authors_word(tmp_path, capsys):
    path = begun(tmp_path / "b")
    edit(path / "board.toml", 'redistribution = "yes"', 'redistribution = "non-commercial"')
    with pytest.raises(RedistributionError, match="--permission synthetic-adt"):
        add_submission(path, submitted(tmp_path / "a.zip", "people"), [table()], **DAY)
    add_submission(path, submitted(tmp_path / "b.zip", "scripted", name="Only mine"), [table()], **DAY)
    permitted = submitted(tmp_path / "c.zip", "people", name="With leave", permitted=("synthetic-adt",))
    add_submission(path, permitted, [table()], **DAY)
    page = (path / "leaderboard.md").read_text()
    left_out = "recorded motion, gaze, goals and scenes are left out"
    assert f"for non-commercial purposes only: {left_out}" in page
    assert "- with-leave-" in page.partition(" may hold recorded motion of synthetic-adt, by a perm")[0][-30:]
    assert main(["leaderboard", "build", str(path)]) == 0
    assert left_out in capsys.readouterr().err


@pytest.mark.parametrize(
    ("declared", "told", "kinds"),
    [
        (["none"], "declared none", {"none", "declared"}),
        (["synthetic-adt"], "declared synthetic-adt (train split)", {"declared"}),
        (["synthetic-adt:test"], "overlaps 4 test recordings", {"overlapping"}),
        ([], "not declared", {"undeclared"}),
    ],
)
def test_training_data_are_a_column_and_a_filter(tmp_path, capsys, declared, told, kinds):
    path = begun(tmp_path / "b")
    file = submitted(tmp_path / "s.zip", "still", "people", training=declared_training(declared) if declared else None)
    add_submission(path, file, [table()], **DAY)
    assert f"| {told} |" in (path / "leaderboard.md").read_text()
    found = set()
    for kind in ("none", "declared", "overlapping", "undeclared"):
        assert main(["leaderboard", "export", str(path), "--training", kind, "--format", "csv"]) == 0
        rows = {row["method"]: row["training"] for row in csv.DictReader(capsys.readouterr().out.splitlines())}
        assert rows["ground-truth"] == told
        found |= {kind} if "static" in rows else set()
    assert found == kinds


def test_what_is_cited_is_told_by_the_state_of_the_board(tmp_path, capsys):
    path = board(tmp_path / "b")
    said: list[str] = []
    for form in ("bibtex", "apa", "cff"):
        assert main(["leaderboard", "cite", str(path), "--format", form]) == 0
        said.append(capsys.readouterr().out)
    for cited in ("@misc{board-", "pan2023aria", "hatano_prime", "@software{prbench", f"% {only(path)}: First"):
        assert cited in said[0]
    assert said[1].startswith("A Lab (2026). Reach | <b> [prime-and-reach, protocol version 4 (")
    withdraw_submission(path, "First", reason="x", **DAY)
    assert main(["leaderboard", "cite", str(path)]) == 0
    assert capsys.readouterr().out != said[0]


def test_files_for_github_say_what_the_board_says_and_can_be_read(tmp_path):
    yaml = pytest.importorskip("yaml")
    path = begun(tmp_path / "b")
    steps = yaml.safe_load((path / ".github/workflows/board.yml").read_text())["jobs"]["check"]["steps"]
    assert "prbench leaderboard check board --against base" in steps[-1]["run"]
    form = yaml.safe_load((path / ".github/ISSUE_TEMPLATE/submission.yml").read_text())
    assert 'licence: CC "BY"' in form["body"][-1]["attributes"]["options"][0]["label"]
    assert (path / "README.md").read_text().startswith("# Reach \\| &lt;b&gt;\n")
    (path / "README.md").write_text("mine")
    assert (begun(path) / "README.md").read_text() == "mine"
    with pytest.raises(StorageError, match="another board stands there"):
        begin_board(path, [table()], benchmark="prime-and-reach", **ABOUT | {"title": "Other"})
