"""What is certainly wrong with scored motions is told last, kept and marked on boards; sound motions are left alone."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from prbench.board import collect_runs, make_leaderboard
from prbench.board.export import export
from prbench.checking.doctor.motion_set import ORDERS_OF_22
from prbench.cli.main import main
from prbench.contract import Condition
from prbench.harness.planning import select
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.run_folder import Predictions
from prbench.harness.run_folder.predictions import PredictionRows
from prbench.harness.scoring import certain_faults
from prbench.harness.synthetic_table import build_synthetic_table
from prbench.sequences import SequenceTable
from tests.checking.doctor.faults import (
    Change,
    at_indices,
    axes,
    cut_to_length,
    in_order,
    played,
    scaled,
    swapped,
    turned,
)
from tests.cli.reports import printed_document
from tests.method_fixtures import adapter_source
from tests.shared import made_once

Z_UP = axes((0, 2, 1), (1, -1, 1))
SIDES = ("hip", "knee", "ankle", "foot", "collar", "shoulder", "elbow", "wrist")
PLANTED = {
    "Z up": (Z_UP, "up-axis"),
    "X forward": (lambda motion: turned(motion, 90), "facing"),
    "where the room has them": (lambda motion: turned(motion, 130) + np.array([2.0, 0.0, 1.0]), "position"),
    "millimetres": (scaled(1000), "unit"),
    "centimetres": (scaled(100), "unit"),
    "30 frames a second, cut": (cut_to_length(played(30)), "frame-rate"),
    "30 frames a second, all of them": (played(30), "frame-rate"),
    "joints of another order": (in_order(next(iter(ORDERS_OF_22.values()))), "joint-order"),
    "left and right exchanged": (swapped(*SIDES), "left-right"),
    "mirrored": (axes((0, 1, 2), (-1, 1, 1)), "mirrored"),
}


@dataclass
class Changed:
    """Recorded motions, each changed in one way."""

    table: SequenceTable
    change: Change
    id_column: str = "sequence_id"

    def motions(self, ids: list[str], sample: int) -> PredictionRows:
        found = recorded(self.table, ids)
        changed = [np.asarray(self.change(found[name]), dtype=np.float32) for name in ids]
        return PredictionRows(np.concatenate(changed), np.cumsum([0, *map(len, changed)]))


def recorded(table: SequenceTable, ids: list[str]) -> dict[str, np.ndarray]:
    found = {}
    for chunk in table.chunks(columns=["joints"], ids=ids):
        for row, name in enumerate(chunk.sequence_ids):
            found[name] = chunk.joints[chunk.offsets[row] : chunk.offsets[row + 1]].astype(np.float64)
    return found


@pytest.fixture(scope="module")
def people() -> SequenceTable:
    """A table of at least twenty test sequences of synthetic people."""
    settings = {"n_events": 12, "noise": 0.0, "provocations": {}}
    folder = made_once("people", lambda path: build_synthetic_table("adt", (1, 10), 2024, path, **settings))
    return SequenceTable.open(folder).with_sequences()


@pytest.mark.parametrize("condition", [Condition.GOAL_LOCATION.value, "unstated"])
@pytest.mark.parametrize("fault", PLANTED)
def test_a_planted_fault_is_found(fault: str, condition: str, people: SequenceTable) -> None:
    change, kind = PLANTED[fault]
    selection = select(people, split="test", limit=None)
    assert len(selection) >= 20
    found = certain_faults(selection, Changed(people, change), condition=condition)
    kinds = {each.kind for each in found}
    # Without the initial pose nobody can tell a mirror from exchanged names.
    assert kinds & ({kind, "left-right"} if kind == "mirrored" else {kind})
    assert all(each.remedy for each in found)


def test_recorded_people_bring_no_alarm_at_any_rate(people: SequenceTable) -> None:
    selection = select(people, split="test", limit=None)
    for change in (np.asarray, lambda motion: np.repeat(motion[:1], len(motion), axis=0)):
        assert certain_faults(selection, Changed(people, change), condition="goal-loc") == ()
    # Finished motions may have a rate of their own, which is then said with --native-fps.
    faster = Changed(people, lambda motion: at_indices(motion, np.arange(np.ceil((len(motion) - 1) * 1.5) + 1) / 1.5))
    assert certain_faults(selection, faster, condition="goal-loc", native_fps=30.0) == ()


@pytest.fixture
def z_up(people: SequenceTable, tmp_path: Path) -> Path:
    motions = recorded(people, list(select(people, split="test", limit=None).sequence_ids))
    turned_up = {name: Z_UP(motion).astype(np.float32) for name, motion in motions.items()}
    path = tmp_path / "mine.npz"
    lengths = [len(motion) for motion in turned_up.values()]
    np.savez(path, joints=np.concatenate(list(turned_up.values())), n_frames=lengths, sequence_id=list(turned_up))
    return path


def test_scores_of_broken_motions_end_with_the_fault_and_its_remedy(people, z_up, tmp_path, capsys) -> None:
    words = ["score", str(z_up), "--data", str(people.folder), "--condition", "goal-loc", "--out", str(tmp_path / "s")]
    assert main(words) == 0
    line, last = capsys.readouterr().out.splitlines()[-2:]
    assert line.startswith("WRONG MOTIONS (up-axis), adt: +z points up instead of +y. Turn the axes")
    assert "np.stack(" in line
    assert "prbench doctor" in last
    assert main([*words, "--strict"]) == 1
    capsys.readouterr()
    (report,) = printed_document([*words, "--strict"], capsys, code=1).report
    assert [each["kind"] for each in report["scores"]["findings"]] == ["up-axis"]
    text = export(make_leaderboard(collect_runs([tmp_path / "s"])), "md")
    assert "| mine ✗" in text, [line for line in text.splitlines() if "mine" in line]
    assert "the motions are certainly wrong: +z points up instead of +y (up-axis); never ranked" in text, [
        line for line in text.splitlines() if "mine" in line
    ]


def test_a_run_keeps_what_is_wrong_and_finds_it_again_where_the_summary_hides_it(people, tmp_path, install) -> None:
    body = """
            joints[:] = batch.initial_joints[:, None] * 39.37"""
    install("made", adapter_source(body=body))
    request = RunRequest(
        method="made", condition=Condition.GOAL_LOCATION, data=(people.folder,), out=tmp_path / "run", limit=20
    )
    (summary,) = run_method(request).summaries
    assert [each.kind for each in summary.findings] == ["unit"]
    path = tmp_path / "run/synthetic-adt/summary.json"
    told = path.read_text()
    assert run_method(request).summaries == (summary,), "a finished run is found again"
    path.write_text(json.dumps(json.loads(told) | {"findings": []}))
    with pytest.raises(Exception, match=r"summary\.json, findings: expected 1 entries"):
        run_method(request)
    assert Predictions.open(tmp_path / "run/synthetic-adt/predictions").ids
