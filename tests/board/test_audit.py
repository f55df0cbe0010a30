"""The audit: every control on one table, under every metric, and which of them do no worse than people."""

from __future__ import annotations

from pathlib import Path

import pytest

from prbench.board.audit import TableAudit, audit, not_worse_than_people
from prbench.engine import InProcess
from prbench.errors import UsageError
from prbench.harness.controls import CONTROLS
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.synthetic_table import build_synthetic_table
from prbench.metrics import METRICS
from prbench.sequences import SequenceTable
from tests.shared import made_once

INFO = {info.id: info for info in METRICS}


def people_in_every_split() -> Path:
    return made_once("audited-people", lambda path: build_synthetic_table("adt", 12, 0, path, n_events=4))


@pytest.fixture(scope="module")
def people() -> SequenceTable:
    return SequenceTable.open(people_in_every_split())


@pytest.fixture(scope="module")
def audited(people: SequenceTable, tmp_path_factory: pytest.TempPathFactory) -> TableAudit:
    out = tmp_path_factory.mktemp("audit") / "runs"
    run = run_method(RunRequest(method="static", data=(people.folder,), out=out.parent / "static-run")).folder.path
    done: list[str] = []
    (found,) = audit(
        [people.folder],
        runs=[run],
        split="test",
        limit=None,
        out=out,
        engine=InProcess(),
        progress=lambda _done, _total, name: done.append(name),
    )
    assert [control.name for control in found.controls if control.name != "static-run"] == done
    assert sorted(folder.name for folder in out.iterdir()) == sorted(name.replace(", ", "-") for name in done)
    return found


def mean(audited: TableAudit, name: str, metric: str) -> float:
    summary = next(control.summary for control in audited.controls if control.name == name)
    return next(entry.mean for entry in summary.metrics if entry.metric == metric)


def test_every_control_that_differs_from_the_recorded_motion_is_there(audited):
    names = {control.name for control in audited.controls}
    methods = {control.name for control in CONTROLS if control.use == "--method"}
    assert names - {"static-run"} == methods - {"ground-truth-20fps"} | {
        "ground-truth, shuffled-goal"
    }  # the table has 20 itself


def test_every_metric_of_the_registry_is_there_gaze_of_recorded_people_too(audited):
    assert all(any(info.id in control.means for control in audited.means) for info in METRICS)
    assert mean(audited, "ground-truth", "prime_success_gaze") > 0.5


def test_a_finished_run_stands_beside_the_controls_and_one_on_other_sequences_is_refused(audited, people, tmp_path):
    assert mean(audited, "static-run", "prime_success") == 0.0
    assert mean(audited, "static-run", "mpjpe") > 0.1
    run = run_method(RunRequest(method="static", data=(people.folder,), limit=1, out=tmp_path / "one")).folder.path
    with pytest.raises(UsageError, match=r"one: expected a finished run on the \d+ sequences of .* that are audited"):
        audit([people.folder], runs=[run], split="test", limit=None, out=None, engine=InProcess(), progress=print)


def test_the_equation_is_won_by_a_tremor_and_its_onset_is_not(audited):
    assert mean(audited, "stare", "prime_success") == 0.0
    assert mean(audited, "tremor", "prime_success") == 1.0
    assert "tremor" in not_worse_than_people(audited.means, INFO["prime_success"])
    assert "tremor" not in not_worse_than_people(audited.means, INFO["prime_success_onset"])


def test_a_jump_reaches_and_a_floating_body_skates_less_than_a_gliding_one(audited):
    assert mean(audited, "teleport", "reach_success") == 1.0
    assert mean(audited, "float", "foot_skating") == 0.0 < mean(audited, "scripted", "foot_skating")
    assert mean(audited, "float", "contact_share") < 0.2 < mean(audited, "scripted", "contact_share")


def test_round_trips_stay_close_to_the_recorded_motion(audited):
    for name in ("ground-truth-resampled", "ground-truth-30fps"):
        assert mean(audited, name, "mpjpe") < 0.005


def test_metrics_that_compare_with_recorded_motion_or_have_no_direction_are_won_by_nobody(audited):
    for metric in ("mpjpe", "goal_mpjpe", "location_error", "contact_share"):
        assert not_worse_than_people(audited.means, INFO[metric]) == ()
    for info in METRICS:
        assert not {"ground-truth", "ground-truth, shuffled-goal"} & set(not_worse_than_people(audited.means, info))
