"""Forgeries of what a run says about itself are refused where a stored fact contradicts them, else called declared."""

from __future__ import annotations

import csv
import io
import json
import re
import shutil
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

import prbench
from prbench.board import collect_runs, export, make_leaderboard
from prbench.cli.main import main
from prbench.contract import Condition
from prbench.errors import RunError
from prbench.harness.claims import DECLARED
from prbench.harness.request import RunRequest
from prbench.harness.results import RunChecker, summary_of
from prbench.harness.run import run_method
from prbench.harness.run_folder.folder import RunFolder
from prbench.harness.run_folder.predictions import QUESTION
from prbench.harness.run_folder.record import RunCost
from prbench.harness.run_folder.scores import read_scores
from prbench.sequences import SequenceTable
from prbench.sequences.sequence import recording_key
from tests.fakes import fake_dataset
from tests.harness.offline.method import SOURCE
from tests.shared import made_once

GOAL = Condition.GOAL_LOCATION
OTHER = "0" * 64


def make(root: Path) -> None:
    """Write a table, and runs of a method of prbench with a network, of a foreign one, and of two controls."""
    root.mkdir()
    table = fake_dataset(root / "table", 32, recordings=16).folder
    (root / "mine.py").write_text(textwrap.dedent(SOURCE))
    one_pass = {"optimise": "off", "sampler": "one-pass"}
    run_method(RunRequest(method="pr", condition=GOAL, options=one_pass, data=(table,), out=root / "pr", batch_size=3))
    run_method(RunRequest(method=str(root / "mine.py"), condition=GOAL, data=(table,), out=root / "mine"))
    run_method(RunRequest(method="static", data=(table,), out=root / "static"))
    for control in ("scripted", "stare"):
        run_method(RunRequest(method=control, data=(table,), out=root / control))


@pytest.fixture(scope="module")
def made() -> Path:
    return made_once("claims", make)


@pytest.fixture
def forged(made: Path, tmp_path: Path) -> Callable[..., Path]:
    """Copy a run and set keys of its ``run.json``, written with dots; the summary is made to fit."""

    def forge(name: str, **changes: Any) -> Path:
        folder = tmp_path / name
        shutil.copytree(made / name, folder)
        record = json.loads((folder / "run.json").read_text())
        for key, value in changes.items():
            *parents, last = key.split("__")
            place: Any = record
            for parent in parents:
                place = place[0] if parent == "table" else place[parent]
            place[last] = value
        (folder / "run.json").write_text(json.dumps(record))
        refit(folder)
        return folder

    return forge


def refit(folder: Path) -> None:
    run = RunFolder.open(folder, any_benchmark=True)
    files = run.dataset("synthetic-adt")
    scores = read_scores(files.scores)
    recording_of = {name: recording_key(name) for name in scores["sequence_id"].to_pylist()}
    summary_of(run.record, run.record.tables[0], scores, recording_of).write(files.path)


def boards(made: Path, folder: Path) -> dict[str, Any]:
    """The run on a board, checked on its table, in each format."""
    table = SequenceTable.open(made / "table")
    board = make_leaderboard(collect_runs([folder], check=RunChecker(lambda _: table).check, any_benchmark=True))
    (row,) = json.loads(export(board, "json"))["tables"][0]["rows"]
    return {"md": export(board, "md"), "csv": next(csv.DictReader(io.StringIO(export(board, "csv")))), "json": row}


@pytest.mark.parametrize(
    ("run", "changes", "contradicted"),
    [
        ("pr", {"condition": "goal-pose"}, r"method\.weights: expected weights for 'goal-pose'.*pr-small-goal-loc"),
        ("pr", {"condition": "text"}, r"condition: expected one that pr takes, .'goal-loc', 'goal-pose'., found text"),
        ("pr", {"method__name": "mdm"}, r"condition: expected one that mdm takes, \['text'\], found goal-loc"),
        ("pr", {"method__name": "better"}, r"method\.name: expected one of prbench's own, .*found better"),
        ("pr", {"method__weights_digest": OTHER}, "as the bundled pr-small-goal-loc.*found 0000"),
        ("pr", {"method__weights": "PR-Small-Goal-LOC", "method__weights_digest": OTHER}, "weights_digest: expected"),
        ("pr", {"method__weights": None, "method__weights_digest": None}, "weights: expected pr-small-goal-loc"),
        ("pr", {"method__motionless": True}, r"method\.motionless: expected (false for a Foot Skating|False)"),
        ("pr", {"method__max_frames": 9000}, r"method\.max_frames: expected 241, as pr has it, found 9000"),
        ("pr", {"method__native_fps": 30.0}, r"method\.native_fps: expected 20.0"),
        ("pr", {"seed": 7}, r"control, seed: expected those of the question that part-00000.* found goal-loc, None, 7"),
        ("pr", {"control": "shuffled-goal"}, r"control, seed: expected those of .* found goal-loc, shuffled-goal, 0"),
        ("pr", {"tables__table__batch_plan": {"batch_size": 3, "batches": 3, "digest": OTHER}}, "batch_plan: exp"),
        ("mine", {"condition": "text"}, r"condition, control, seed: expected those of .* found text, None, 0"),
        ("mine", {"condition": "none"}, r"condition, control, seed: expected those of .* found none, None, 0"),
        ("mine", {"method__kind": "built-in", "method__name": "pr"}, r"method\.weights: expected pr-small-goal-loc"),
        ("mine", {"method__motionless": True}, r"method\.motionless: expected false for a Foot Skating"),
        ("mine", {"method__gaze": True}, r"method\.gaze: expected False, as the motions say, found True"),
        ("mine", {"tables__table__synthetic": False}, r"tables\.synthetic-adt\.synthetic: expected True, as the table"),
        ("mine", {"tables__table__selection_digest": OTHER}, r"selection_digest: expected .*found 0000"),
        ("mine", {"tables__table__redistribution": "none"}, r"redistribution: expected yes"),
        ("mine", {"tables__table__title": "Real people"}, r"title: expected .*found Real people"),
        ("mine", {"protocol_version": 2}, r"protocol_version: expected \d, found 2"),
        ("mine", {"sequences": ["x"]}, r"sequences: expected those that were run, found \('x',\)"),
        ("mine", {"benchmark": "motion-prediction"}, "benchmark: expected the benchmark of its table"),
        ("mine", {"tables__table__fold": "1/3"}, r"fold: expected None, as the table says, found 1/3"),
        ("static", {"method__name": "pr"}, "condition: expected one that pr takes"),
        ("scripted", {"method__name": "stare"}, r"method\.name: expected stare's motions, found others, .* m off"),
        ("scripted", {"method__name": "waving"}, r"method\.name: expected one of prbench's own, .*found waving"),
    ],
)  # fmt: skip
def test_what_a_stored_fact_contradicts_is_refused(made, forged, run, changes, contradicted) -> None:
    if "method__kind" in changes:
        changes = changes | {"method__version": prbench.__version__}
    folder = forged(run, **changes)
    with pytest.raises(RunError, match=contradicted) as refused:
        boards(made, folder)
    assert "run the method again into another folder" in str(refused.value) or "Delete it" in str(refused.value)


@pytest.mark.parametrize(
    ("run", "changes"),
    [
        ("pr", {"method__isolation": "bubblewrap"}),
        ("pr", {"method__weights": "mine.safetensors", "method__weights_digest": OTHER}),
        ("pr", {"method__options": {"optimise": "paper"}}),
        ("pr", {"method__kind": "package", "method__name": "bright", "method__package": "bright"}),
        ("mine", {"method__isolation": "container"}),
        ("mine", {"device": "cuda", "threads": 64, "packages": {}, "prbench_version": "9"}),
    ],
)
def test_what_nothing_contradicts_is_called_declared_in_every_format(made, forged, run, changes) -> None:
    shown = boards(made, forged(run, **changes))
    header = next(line for line in shown["md"].splitlines() if line.startswith("| Condition"))
    heads = [head.strip() for head in header.strip("|").split("|")]
    declared = ["Condition", "Method", "Variant", "s/motion", "CPU s/motion", "Passes/motion", "Memory (MiB)",
                "Parameters", "Kind"]  # fmt: skip
    assert [head for head in heads if head.endswith(" (declared)")] == [f"{title} (declared)" for title in declared]
    assert "- Declared: said by the run's own files, contradicted by none" in shown["md"]
    assert shown["csv"]["declared"] == "; ".join(DECLARED)
    assert shown["json"]["declared"] == list(DECLARED)


def test_the_motions_of_a_control_are_made_again(made) -> None:
    shown = boards(made, made / "scripted")
    assert "- Made again from the table, and equal: the motions of scripted." in shown["md"]
    assert shown["csv"]["declared"] == "device; packages; cost"
    assert shown["json"]["declared"] == ["device", "packages", "cost"]
    assert boards(made, made / "static")["json"]["declared"] == list(DECLARED)


@pytest.mark.parametrize("digest", ["", OTHER])
def test_motions_whose_question_was_taken_away_are_those_of_an_earlier_version(made, forged, digest) -> None:
    folder = forged("mine", condition="goal-pose")
    part = folder / "synthetic-adt/predictions/part-00000.parquet"
    table = pq.read_table(part)
    pq.write_table(table.replace_schema_metadata({**table.schema.metadata, QUESTION.encode(): digest.encode()}), part)
    if digest:
        with pytest.raises(RunError, match="expected those of the question that part-00000"):
            boards(made, folder)
    else:
        assert "condition" in boards(made, folder)["json"]["declared"]


@pytest.mark.parametrize("changes", [{"tables": []}, {"seed": -1}, {"samples": 0}, {"limit": 0}, {"schema_version": 2}])
def test_values_that_no_run_has_are_told_with_file_and_key(forged, changes) -> None:
    with pytest.raises(
        RunError, match=rf"run\.json: not a valid run\.json: Expected .* at `\$\.{next(iter(changes))}`"
    ):
        forged("mine", **changes)


def scaled(cost: dict[str, Any], factor: float, *names: str) -> dict[str, Any]:
    times = ("seconds", "processor_seconds", "seconds_per_motion", "warm_up_seconds", "warm_up_processor_seconds")
    return cost | {name: cost[name] * factor for name in names or times if cost[name] is not None}


@pytest.mark.parametrize("remade", [False, True], ids=["checksum kept", "checksum remade"])
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda cost: scaled(cost, 1e-4), "too few to check"),
        (lambda cost: cost | {"seconds": -1.0, "seconds_per_motion": -0.2}, "numbers from 0 on"),
        (lambda cost: cost | {"motions": cost["motions"] + 1}, r"expected 8 motions, as were scored, found 9"),
        (lambda cost: cost | {"seconds_per_motion": 1e-6}, "its sums say .* s a motion, not it"),
        (lambda cost: cost | {"peak_process_bytes": cost["peak_process_bytes"] // 10_000}, "hold no Python with"),
        (lambda cost: cost | {"network_passes_declared": 1}, "3 batches need a network pass each"),
        (lambda cost: scaled(cost, 1e5, "processor_seconds"), "s of processors are too many in"),
    ],
)
def test_an_impossible_cost_is_told_and_the_rest_of_the_row_stays(made, forged, capsys, change, words, remade) -> None:
    folder = forged("static" if "check" in words else "pr")
    path = folder / "synthetic-adt/cost.json"
    path.write_text(json.dumps(change(json.loads(path.read_text()))))
    if remade:
        RunCost.read(path).write(path)
    shown = require_unverified_cost(made, folder, capsys)
    assert re.search(words if remade else "checksum", shown["json"]["unverified_cost"])


@pytest.mark.parametrize("content", ["{", "[]", '{"seconds": "1"}', '{"seconds": 3.5}'])
def test_a_damaged_cost_is_told_and_the_rest_of_the_row_stays(made, forged, capsys, content) -> None:
    folder = forged("pr")
    (folder / "synthetic-adt/cost.json").write_text(content)
    require_unverified_cost(made, folder, capsys)


def require_unverified_cost(made: Path, folder: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    shown = boards(made, folder)
    assert "unverified (cost)" in shown["md"]
    assert "- Unverified (cost): " in shown["md"]
    assert (shown["csv"]["verified"], shown["csv"]["seconds_per_motion"]) == ("unverified (cost)", "")
    assert shown["csv"]["value"] != ""
    assert shown["json"]["unverified_cost"]
    assert set(shown["json"]["cost"].values()) == {None}
    assert main(["leaderboard", "export", str(folder), "--data", str(made / "table"), "--format", "csv"]) == 0
    assert f"unverified (cost): {folder.name}, synthetic-adt, cost.json: " in capsys.readouterr().err
    return shown
