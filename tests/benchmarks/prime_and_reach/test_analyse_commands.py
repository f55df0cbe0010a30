"""``prbench analyse``: agreement and diversity of finished runs, printed, as JSON, and how each refuses."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from prbench.cli import main
from prbench.contract import Condition
from prbench.geometry.skeleton import Joint
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.run_folder import read_scores
from prbench.protocol.manifests import load_protocol
from prbench.sequences import Sequence, SequenceTable
from prbench_benchmarks.prime_and_reach.diversity import read_fan
from tests.cli.reports import refused, reported
from tests.fakes import fake_dataset
from tests.method_fixtures import adapter_source, install, own_cache

__all__ = ["install", "own_cache"]


def test_agreement_of_runs_is_printed_and_reported(tmp_path, capsys):
    table = str(fake_dataset(tmp_path / "table", 48).folder)
    run = str(tmp_path / "run")
    words = ["run", "--method", "nearest-neighbour", "--data", table, "--out", run]
    (made,) = reported(words, capsys).runs
    assert main(words) == 0
    assert "agreement with recorded people (phi): Prime Success" in capsys.readouterr().out
    out = tmp_path / "agreement.json"
    rates, by_place = reported(["analyse", "agreement", run, "--data", table, "--out", str(out)], capsys).tables
    assert json.loads(out.read_text())["command"] == "analyse"
    (stored,) = made.agreements
    assert [row.cells[0].value for row in rates.blocks[0].rows] == [rate.phi for rate in stored.rates]
    assert [row.text["sequences"] for row in by_place.blocks[0].rows] == [str(e.sequences) for e in stored.breakdown]
    assert not any("unverified" in note for note in by_place.notes)
    assert main(["analyse", "agreement", run]) == 0
    shown = capsys.readouterr().out
    assert "bearing 30 to 90°" in shown
    assert "height from 1.4 m" in shown
    assert "unverified: its table of synthetic-adt is not at hand" in shown


def test_sequences_of_several_runs_agree_with_people_together(tmp_path, capsys):
    runs = []
    tables = []
    for seed, change in enumerate((lambda row: row, other_goal), start=1):
        tables.append(str(fake_dataset(tmp_path / f"table-{seed}", 48, change=change).folder))
        runs.append(str(tmp_path / f"run-{seed}"))
        reported(["run", "--method", "nearest-neighbour", "--data", tables[-1], "--out", runs[-1]], capsys)
    found = reported(["analyse", "agreement", *runs, "--data", *tables], capsys).tables
    of_dataset, of_all = found[-2:]
    assert of_dataset.title.startswith("synthetic-adt, 2 together")
    assert of_all.title.startswith("all datasets, 2 together")
    for first, second, both in zip(*(table.blocks[0].rows for table in (found[0], found[2], of_all)), strict=True):
        counts = [row.cells[0].sequences for row in (first, second)]
        assert both.cells[0].sequences == sum(counts)
        people = [row.cells[1].value * count for row, count in zip((first, second), counts, strict=True)]
        assert both.cells[1].value == pytest.approx(sum(people) / sum(counts))
    twice = reported(["analyse", "agreement", runs[0], runs[0], "--data", tables[0]], capsys).tables
    assert [row.cells[0].value for row in twice[-1].blocks[0].rows] == pytest.approx(
        [row.cells[0].value for row in twice[0].blocks[0].rows], nan_ok=True
    )


def other_goal(row: Sequence) -> Sequence:
    return replace(row, goal_location=row.goal_location + np.array([0.0, 0.1, 0.0]))


GENTLE = "joints = batch.initial_joints[:, None] + 0.05 * joints if batch.initial_joints is not None else joints"


@pytest.fixture(scope="module")
def table(tmp_path_factory) -> SequenceTable:
    return fake_dataset(tmp_path_factory.mktemp("data") / "table", 60)


def measures_of(words, capsys) -> tuple[dict[str, dict], str]:
    """Cells of each measure by what they are of, and the notes."""
    (table,) = reported(words, capsys).tables
    rows = table.blocks[0].rows
    return {row.cells[0].variant: {cell.metric: cell for cell in row.cells} for row in rows}, " ".join(table.notes)


def made_run(table: SequenceTable, out: Path, **changes) -> str:
    wanted = {"method": "made", "condition": Condition.GOAL_LOCATION, "samples": 3, "limit": 8}
    run_method(RunRequest(**{**wanted, "data": (table.folder,), "out": out, **changes}))
    return str(out)


def test_spreads_stand_beside_those_of_people_with_intervals(table, tmp_path, install, capsys):
    install("made", adapter_source(body=GENTLE))
    run = made_run(table, tmp_path / "run")
    words = ["analyse", "diversity", run, "--data", str(table.folder)]
    by_name, notes = measures_of(words, capsys)
    assert "m apart in median" in notes
    joint = by_name["apd_joint"]
    # Noise of 5 cm in each coordinate, independently in two motions.
    assert joint["method"].value == pytest.approx(0.05 * 6**0.5, rel=0.02)
    assert joint["method"].sequences == 8
    assert joint["difference"].value == pytest.approx(joint["method"].value - joint["people"].value)
    assert joint["difference"].low is not None
    assert main(words) == 0
    shown = capsys.readouterr().out
    assert "3 motions of each of 8 sequences" in shown
    assert "Prime time" in shown
    assert "an upper bound of what one task brings forth" in shown
    assert "These are scores on synthetic data: never compare them with published ones." in shown


def test_recorded_motion_drawn_several_times_has_no_spread(table, tmp_path, capsys):
    run = made_run(table, tmp_path / "run", method="ground-truth", condition=None)
    found, _ = measures_of(["analyse", "diversity", run, "--data", str(table.folder)], capsys)
    assert [each["method"].value for each in found.values()] == pytest.approx([0.0] * len(found), abs=1e-12)
    assert all(each["people"].value > 0 for each in list(found.values())[:4])


@pytest.mark.parametrize("by", [None, "layout", "limit"])
def test_causes_of_motions_that_are_not_plausible_add_up_to_the_score(table, tmp_path, install, capsys, by):
    # From a body that stands still to one that trembles more and more.
    trembling = "np.geomspace(1e-4, 0.02, len(joints))[:, None, None, None] * joints"
    install("made", adapter_source(body=f"joints = __import__('tests.fakes').fakes.STANDING + {trembling}"))
    run = made_run(table, tmp_path / "run", limit=None, condition=Condition.NONE)
    scores = read_scores(tmp_path / "run/synthetic-adt/scores.parquet").to_pylist()
    rows = [row for row in scores if row["metric"] == "plausible"]
    flags = [{*(row["flag"] or "").split(";")} - {"", "own_first_frame"} for row in rows]
    words = ["analyse", "causes", run, *(["--by", by] if by else []), "--data", str(table.folder)]
    ((block,),) = (found.blocks for found in reported(words, capsys).tables)
    found = {row.cells[0].variant: [cell.value for cell in row.cells] for row in block.rows}
    assert found.pop("plausible") == pytest.approx([100 * np.mean([not each for each in flags])])
    assert block.title == ("synthetic-adt" if by == "layout" else "")
    assert len(found) > 2
    if by == "limit":
        limits = load_protocol().metrics.plausible
        assert {limits[told.partition(",")[0]].flag for told in found} == set.union(*flags)
    else:
        assert set(found) == set.union(*flags)
        assert any(alone > 0 for _, alone in found.values())
        for flag, shares in found.items():
            both = [flag in each for each in flags], [each == {flag} for each in flags]
            assert shares == pytest.approx([100 * np.mean(each) for each in both])


def test_pairs_of_a_run_are_written_answered_and_counted(table, tmp_path, install, capsys):
    install("made", adapter_source(body=GENTLE))
    run = made_run(table, tmp_path / "run", samples=1)
    out = tmp_path / "pairs"
    words = ["analyse", "pairs", run, "--data", str(table.folder), "--out", str(out)]
    made = reported([*words, "--pairs", "5", "--seed", "3"], capsys)
    key = json.loads((out / "key.json").read_text())
    assert (made.page, len(key["pairs"])) == (out / "pairs.html", 5)
    assert {side for pair in key["pairs"] for side in pair["sides"]} == {"ground truth", "made, goal-loc"}
    answers = {n: "AB"[pair["sides"].index("ground truth")] for n, pair in enumerate(key["pairs"], 1)}
    saved = tmp_path / "answers.json"
    saved.write_text(json.dumps({"page": key["page"], "judge": "Ann", "answers": answers}))
    (counted,) = reported(["analyse", "answers", str(out), str(saved)], capsys).tables
    assert counted.blocks[0].rows[0].cells[0].value == 100.0
    refused([*words, "--seed", "4"], capsys, code=2, message="is the key of another page")
    control = made_run(table, tmp_path / "control", method="ground-truth", condition=None, samples=1)
    refused(["analyse", "pairs", control, *words[3:]], capsys, code=2, message="holds motions of a control")


def test_a_classifier_tells_noise_from_people_and_no_people_from_others(tmp_path, install, capsys):
    install("made", adapter_source(body=GENTLE))
    table = fake_dataset(tmp_path / "table", 48, recordings=48)
    words = ["analyse", "tell-apart", made_run(table, tmp_path / "run", samples=1, split="train", limit=None)]
    (found,) = reported([*words, "--data", str(table.folder)], capsys).tables
    area, people = found.blocks[0].rows[0].cells
    assert (area.metric, area.value) == ("area", 1.0)
    assert area.recordings >= 10
    assert people.value < 0.75  # so few motions are told apart worse than by chance
    assert " of " in found.blocks[0].rows[0].text["telling"]
    words[2] = made_run(table, tmp_path / "few", samples=1, split="train", limit=8)
    refused([*words, "--data", str(table.folder)], capsys, code=2, message="10 recordings or more")


def test_pairs_of_people_whose_licence_keeps_their_motion_need_a_permission(tmp_path, install, capsys):
    install("made", adapter_source(body=GENTLE))
    table = fake_dataset(tmp_path / "table", 12, redistribution="none")
    run = made_run(table, tmp_path / "run", samples=1, split="train", limit=None)
    words = ["analyse", "pairs", run, "--data", str(table.folder), "--out", str(tmp_path / "out")]
    refused(words, capsys, code=10, message=f"--permission {table.info.dataset}")
    assert not (tmp_path / "out").exists()
    assert reported([*words, "--permission", table.info.dataset], capsys).page == tmp_path / "out/pairs.html"
    assert "holds recorded motion by permission" in (tmp_path / "out/pairs.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", ["fan.png", "fan.svg"])
def test_a_fan_is_drawn_and_the_same_bytes_again(table, tmp_path, install, capsys, name):
    install("made", adapter_source(body=GENTLE))
    run = made_run(table, tmp_path / "run")
    sequence = pq.read_table(tmp_path / "run/synthetic-adt/predictions", columns=["sequence_id"])["sequence_id"][
        0
    ].as_py()
    pictures = []
    for folder in ("one", "two"):
        out = tmp_path / folder / name
        out.parent.mkdir()
        words = ["analyse", "diversity", run, "--data", str(table.folder), "--fan", str(out), "--sequence", sequence]
        assert reported(words, capsys).fan_sequence == sequence
        pictures.append(out.read_bytes())
    assert pictures[0] == pictures[1]
    assert len(pictures[0]) > 10_000
    people = read_fan(tmp_path / "run", [table.folder], sequence=sequence).groups[1].motions.joints
    assert np.ptp(people[:, 0, Joint.PELVIS, ::2], axis=0).max() < 1e-5, "all start where the method is told to start"
    assert np.ptp(people[:, -1, Joint.PELVIS, ::2], axis=0).max() > 1e-3


def test_a_run_that_cannot_be_measured_is_refused_with_what_to_do(table, tmp_path, install, capsys):
    install("made", adapter_source(body=GENTLE))
    data = ["--data", str(table.folder)]
    single = made_run(table, tmp_path / "single", samples=1)
    shuffled = made_run(table, tmp_path / "shuffled", control="shuffled-goal")
    run = made_run(table, tmp_path / "run")
    for words, message in (
        ([single], "expected two motions or more of each sequence, found one"),
        ([shuffled], "were given other sequences' goals"),
        ([run, "--sequence", "x"], "--sequence: belongs to --fan FILE"),
        ([run, "--fan", str(tmp_path / "fan.mp4")], "written as .png, .svg or .pdf"),
        ([run, "--fan", str(tmp_path / "fan.png"), "--sequence", "nowhere"], "nowhere"),
    ):
        assert main(["analyse", "diversity", *words, *data]) == 2
        assert message in capsys.readouterr().err
    for part in (tmp_path / "run/synthetic-adt/predictions").iterdir():
        part.unlink()
    assert main(["analyse", "diversity", run, *data]) != 0
    assert "expected the predictions of a run, found none" in capsys.readouterr().err


def test_a_table_of_one_recording_has_no_people_beside(tmp_path, install, capsys, monkeypatch):
    install("made", adapter_source(body=GENTLE))
    table = fake_dataset(tmp_path / "table", 12, recordings=1)
    run = made_run(table, tmp_path / "run", split="train", limit=None)
    found, notes = measures_of(["analyse", "diversity", run, "--data", str(table.folder)], capsys)
    assert "too few recordings to put people beside one another" in notes
    assert all(set(each) == {"method"} for each in found.values())


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["agreement", "r", "--fan", "f.png"], "analyse agreement takes no --fan; its options: --data, --workers."),
        (["agreement", "r", "--out", "."], "is a directory"),
        (["causes", "r", "--by", "joint"], "'joint' is not one of"),
        (["pairs", "r"], "with --out DIR name the folder"),
        (["answers", "d"], "name the DIR that `analyse pairs` has written"),
        (["diversity", "a", "b"], "analyse diversity: name one RUN."),
        (["diversities", "a"], "'diversities' is not one of"),
    ],
)
def test_what_a_kind_does_not_take_is_refused(words, message, capsys):
    refused(["analyse", *words], capsys, code=2, message=message)
