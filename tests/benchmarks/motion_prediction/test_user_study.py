"""The user study of motion prediction: a page of two runs' futures that names nobody, and shares beside the study's."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from prbench.cli import main
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.viewing.pairs import KEY, PAGE
from prbench_benchmarks.motion_prediction.batch import Condition
from prbench_benchmarks.motion_prediction.study_tables import published_scores
from prbench_benchmarks.motion_prediction.table import WindowsTable, write_windows
from prbench_benchmarks.motion_prediction.user_study import QUESTIONS
from tests.benchmarks.motion_prediction.windows import cut, info, walking, write
from tests.browser import browser, page  # noqa: F401 - fixtures
from tests.cli.reports import refused, reported

STILL = "zero-velocity, pose"
GOING = "constant-velocity, pose"


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """Two runs on nine windows of two recordings; of ``going`` on a part of them."""
    folder = tmp_path_factory.mktemp("study")
    write(folder / "windows", walking("a", 150), walking("b", 135, number=2), walking("c", 150, split="train"))
    for name, method, limit in (("still", "zero-velocity", None), ("going", "constant-velocity", 6)):
        run(folder, name, method, limit=limit)
    return folder


def run(folder: Path, name: str, method: str, **changes) -> Path:
    asked = {"condition": "pose", "samples": 12, "data": (folder / "windows",), **changes}
    run_method(RunRequest(benchmark="motion-prediction", method=method, out=folder / name, **asked))
    return folder / name


def words(folder: Path, out: Path, *more: str, runs: tuple[str, ...] = ("still", "going")) -> list[str]:
    paths = [str(folder / name) for name in runs]
    return ["analyse", "pairs", *paths, "--data", str(folder / "windows"), "--out", str(out), *more]


def read(folder: Path) -> list[dict]:
    text = (folder / PAGE).read_text(encoding="utf-8")
    return [json.loads(each) for each in re.findall(r'class="pair">(.*?)</script>', text)]


def positions(text: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), dtype="<i2").reshape(-1, 22, 3) / 1000


def answer(folder: Path, name: str, **wanted: str) -> Path:
    """Save the answers of a person who prefers one label for each question."""
    key = json.loads((folder / KEY).read_text())
    choices = {
        2 * number + place + 1: "AB"[pair["sides"].index(wanted[question.name])]
        for number, pair in enumerate(key["pairs"])
        for place, question in enumerate(QUESTIONS)
    }
    path = folder / f"answers-{name}.json"
    path.write_text(json.dumps({"page": key["page"], "judge": name, "answers": choices}))
    return path


def test_the_page_shows_ten_futures_of_each_run_and_what_happened_and_names_nobody(made, tmp_path, capsys):
    reported(words(made, tmp_path / "kit", "--pairs", "4", "--seed", "3"), capsys)
    key = json.loads((tmp_path / "kit" / KEY).read_text())
    assert key["counted"] == [STILL, GOING]
    assert sorted(pair["sides"] for pair in key["pairs"]) == 2 * [[GOING, STILL]] + 2 * [[STILL, GOING]]
    table = WindowsTable.open(made / "windows")
    batches = table.batches(Condition.POSE, table.chosen(split="test"))
    truths = {name: (b, t, row) for b, t in batches for row, name in enumerate(t.window_ids)}
    shown = read(tmp_path / "kit")
    assert len(shown) == 4
    for pair, told in zip(key["pairs"], shown, strict=True):
        batch, truth, row = truths[pair["sequence_id"]]
        assert positions(told["observed"]) == pytest.approx(batch.observed_joints[row], abs=6e-4)
        assert positions(told["recorded"]) == pytest.approx(truth.joints[row], abs=6e-4)
        assert [len(side) for side in told["sides"]] == [10, 10]
        still = positions(told["sides"][pair["sides"].index(STILL)][0])
        going = positions(told["sides"][pair["sides"].index(GOING)][0])
        assert np.ptp(still, axis=0).max() == 0
        assert np.ptp(going, axis=0).max() > 0.5
    text = (tmp_path / "kit" / PAGE).read_text(encoding="utf-8")
    data = text[text.index('id="data"') : text.index("</script>\n<script>")]
    assert not any(word in data for word in ("zero-velocity", "constant-velocity", "sliding", "synthetic-walks"))
    reported(words(made, tmp_path / "again", "--pairs", "4", "--seed", "3"), capsys)
    for name in (PAGE, KEY):
        assert (tmp_path / "again" / name).read_bytes() == (tmp_path / "kit" / name).read_bytes()


def test_windows_that_are_recorded_longest_come_first(tmp_path, capsys):
    runs = [cut(walking("a", 150)), cut(walking("b", 150, number=1))]
    short = replace(runs[0], windows=tuple(replace(window, n_scored=15) for window in runs[0].windows))
    write_windows(tmp_path / "windows", info(), [short, runs[1]])
    for name, method in (("still", "zero-velocity"), ("going", "constant-velocity")):
        run(tmp_path, name, method)
    reported(words(tmp_path, tmp_path / "kit", "--pairs", "5"), capsys)
    assert {len(positions(told["recorded"])) for told in read(tmp_path / "kit")} == {60}
    reported(words(tmp_path, tmp_path / "all"), capsys)  # futures end with what was recorded
    shown = read(tmp_path / "all")
    assert sorted(len(positions(told["recorded"])) for told in shown) == 5 * [15] + 5 * [60]
    assert all(len(told["recorded"]) == len(told["sides"][1][0]) for told in shown)


def test_shares_stand_beside_the_printed_ones_of_which_one_row_adds_up_to_101(made, tmp_path, capsys):
    kit = tmp_path / "kit"
    reported(words(made, kit), capsys)
    saved = [answer(kit, f"person-{n}", realism=STILL, precision=STILL if n else GOING) for n in range(6)]
    (table,) = reported(["analyse", "answers", str(kit), *map(str, saved)], capsys).tables
    measured, printed = table.blocks
    found = {row.text["chosen"]: {cell.metric: cell.value for cell in row.cells} for row in measured.rows[:2]}
    assert found[STILL] == {"realism": 100.0, "precision": pytest.approx(500 / 6)}
    assert found[GOING] == {"realism": 0.0, "precision": pytest.approx(100 / 6)}
    assert all(cell.low is not None for cell in measured.rows[0].cells)
    shares = [[cell.value for cell in row.cells] for row in printed.rows]
    assert shares == [[67.7, 74.6], [33.3, 25.4]]
    assert np.sum(shares, axis=0) == pytest.approx([101.0, 100.0])
    notes = " ".join(table.notes)
    assert "they add up to 101.0 %" in notes
    assert "realism: p = 0.031 (Wilcoxon's signed ranks of 6 people)" in notes
    assert "never compare them with published ones" in notes
    assert main(["analyse", "answers", str(kit), str(saved[0])]) == 0
    out = capsys.readouterr().out
    assert "printed in the study" in out
    assert "Wilcoxon" not in out  # one person


def test_the_printed_shares_are_typed_as_printed():
    assert {(each["method"], each["metric"]): each["value"] for each in published_scores("user_study")} == {
        ("gazemodiff", "realism"): "67.7",
        ("humanmac", "realism"): "33.3",
        ("gazemodiff", "precision"): "74.6",
        ("humanmac", "precision"): "25.4",
    }


@pytest.mark.parametrize(
    ("runs", "told"),
    [
        (("still",), "expected two runs of predictors and their windows"),
        (("still", "still"), "expected two runs that can be told apart"),
        (("still", "elsewhere"), "expected runs on the same windows, found none in both"),
        (("still", "designed"), "12 futures are one design, of which 10 are no part. Run it with --samples 10"),
    ],
)
def test_runs_that_make_no_pairs_are_refused(made, tmp_path, capsys, runs, told):
    if "elsewhere" in runs and not (made / "elsewhere").exists():
        run(made, "elsewhere", "constant-velocity", split="train")
    if "designed" in runs and not (made / "designed").exists():
        record = run(made, "designed", "constant-velocity") / "run.json"
        values = json.loads(record.read_text())
        values["method"]["one_design"] = True
        record.write_text(json.dumps(values))
    refused(words(made, tmp_path / "kit", runs=runs), capsys, code=2, message=told)
    assert not (tmp_path / "kit").exists()


def test_a_page_of_people_whose_licence_keeps_their_motion_needs_a_permission(tmp_path, capsys):
    write_windows(
        tmp_path / "windows", msgspec.structs.replace(info(), redistribution="none"), [cut(walking("a", 150))]
    )
    for name, method in (("still", "zero-velocity"), ("going", "constant-velocity")):
        run(tmp_path, name, method)
    refused(words(tmp_path, tmp_path / "kit"), capsys, code=10, message="--permission synthetic-walks")
    assert not (tmp_path / "kit").exists()
    reported(words(tmp_path, tmp_path / "kit", "--permission", "synthetic-walks"), capsys)
    assert "holds recorded motion by permission" in (tmp_path / "kit" / PAGE).read_text(encoding="utf-8")


@pytest.mark.slow
def test_a_person_answers_both_questions_of_each_pair(made, page, tmp_path, capsys):  # noqa: F811
    kit = tmp_path / "kit"
    reported(words(made, kit, "--pairs", "2"), capsys)
    page.emulate_media(reduced_motion="reduce")
    page.goto((kit / PAGE).as_uri())
    for question in (*QUESTIONS, *QUESTIONS):
        assert page.locator("#question").text_content() == question.text
        drawn = page.locator("canvas").evaluate_all("all => all.map((each) => each.toDataURL())")
        assert len(set(drawn)) == 2
        page.keyboard.press("1")
    assert "All questions are answered" in page.locator("#said").text_content()
    page.locator("#judge").fill("Ann")
    with page.expect_download() as saved:
        page.locator("#save").click()
    saved.value.save_as(kit / "answers-Ann.json")
    (table,) = reported(["analyse", "answers", str(kit), str(kit / "answers-Ann.json")], capsys).tables
    shares = [[cell.value for cell in row.cells] for row in table.blocks[0].rows[:2]]
    assert shares == [[50.0, 50.0], [50.0, 50.0]]  # each label stands left once
