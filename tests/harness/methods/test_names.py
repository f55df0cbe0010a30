"""One rule for names: what belongs to prbench is never borne by a package, a program, a file or a folder of a run."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pytest

from prbench.cli import main
from prbench.contract import Condition
from prbench.errors import AdapterError, InputFileError, MemoryFullError, UsageError
from prbench.harness.controls import CONTROLS
from prbench.harness.first_run import companions
from prbench.harness.methods.installed import (
    BUILT_IN_METHODS,
    METHOD_CONTROLS,
    entry_points_of,
    has_form,
    list_adapters,
    name_problem,
    offered_twice,
)
from prbench.harness.methods.loading import find_adapter, load_adapter
from prbench.harness.methods.programs import read_description
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.run_folder.record import RunRecord
from prbench.harness.score_predictions import score_predictions
from prbench.harness.score_request import ScoreRequest
from tests.harness.test_run import request
from tests.method_fixtures import adapter_source

ROOT = Path(__file__).parents[3]


def test_the_reserved_names_are_those_of_the_methods_and_controls_that_come_with_prbench():
    points = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["entry-points"]
    installed = {adapter.name for adapter in list_adapters() if adapter.built_in}
    assert set(BUILT_IN_METHODS) == set(points["prbench.adapters"]) == installed
    assert tuple(control.name for control in CONTROLS if control.use == "--method") == METHOD_CONTROLS
    tasks = points["prbench.training_tasks"].keys() - points["prbench.predictors"].keys()  # of the default benchmark
    for name in (*BUILT_IN_METHODS, *(control.name for control in CONTROLS), *tasks, "all"):
        assert "only prbench itself may use this name" in str(name_problem(name))


@pytest.mark.parametrize("name", ["PR", "Static", "ground_truth", "Ground Truth", "W.A.N.D.R", "groundtruth", "m-d-m"])
def test_a_name_that_reads_like_one_of_prbenchs_is_reserved_too(name):
    assert "only prbench itself may use this name" in str(name_problem(name))


@pytest.mark.parametrize("name", ["glide", "pr2", "my-static", "PR (ours)", "Glide 2.0+", "scripted-v2", "x" * 100])
def test_other_names_of_the_right_form_can_be_used(name):
    assert name_problem(name) is None


@pytest.mark.parametrize(
    "name",
    [
        "",
        " glide",
        "glide ",
        "-x",
        "=cmd|x",
        "a\nb",
        "a\x1b[2J",
        "<img>",
        "a|b",
        "x" * 101,
        "рr",
        "ｐｒ",
        None,
        3,
        "@a",
        "../a",
    ],
)
def test_a_name_of_another_form_is_refused_with_the_form(name):
    assert not has_form(name)
    assert "expected a name of 1 to 100 characters of A to Z" in str(name_problem(name))


def test_a_package_that_claims_a_method_of_prbench_spoils_nothing_and_is_listed_with_the_reason(install, capsys):
    install("static", adapter_source(), package="prbench_thief")
    install("scripted", adapter_source(), package="prbench_shadow")
    static = find_adapter("static")
    assert (static.package, static.built_in) == ("prbench", True)
    assert type(load_adapter("static", None, {}, "cpu")).__module__.startswith("prbench_adapters")
    asked = RunRequest(method="pr", condition=Condition.GOAL_LOCATION, data=(Path(),))
    assert [one.method for one in companions(asked)] == ["mdm", "scripted", "static", "ground-truth"]
    assert main(["adapters", "list"]) == 0
    lines = {tuple(line.split()[:2]): line for line in capsys.readouterr().out.splitlines()}
    assert "'static' is a method of prbench itself; only prbench" in lines["static", "prbench_thief"]
    assert "'scripted' is a control of prbench; only prbench" in lines["scripted", "prbench_shadow"]
    assert "!" not in lines["static", "prbench"]


def test_a_companion_is_the_built_in_method_or_none(install, monkeypatch):
    install("static", adapter_source(), package="prbench_thief")
    others = [adapter for adapter in list_adapters() if adapter.package != "prbench"]
    monkeypatch.setattr("prbench.harness.first_run.list_adapters", lambda: others)
    asked = RunRequest(method="made", data=(Path(),))
    assert [one.method for one in companions(asked)] == ["scripted", "ground-truth"]


def test_a_name_that_two_packages_claim_is_unusable_and_nothing_else_is(install):
    install("same", adapter_source(), package="prbench_one")
    install("same", adapter_source(), package="prbench_two")
    install("made", adapter_source())
    assert offered_twice(list_adapters()) == {"same"}
    with pytest.raises(AdapterError, match=r"offered more than once: .*prbench_one 1\.2.*prbench_two 1\.2"):
        find_adapter("same")
    assert find_adapter("made").package == "prbench_made"


def test_a_package_never_trains_in_place_of_a_method_of_prbench(install, tmp_path):
    install("made", adapter_source())
    info = tmp_path / "site" / "prbench_made-1.2.dist-info" / "entry_points.txt"
    info.write_text(info.read_text() + "\n[prbench.training_tasks]\nmdm = prbench_made:task\nt2m-evaluator = x:y\n")
    found = [(point.name, point.value) for point in entry_points_of("prbench.training_tasks")]
    assert ("mdm", "prbench_made:task") not in found
    assert [value for name, value in found if name == "t2m-evaluator"] == [
        "prbench_benchmarks.text_to_motion.training:t2m_evaluator"
    ]


def test_the_command_says_which_package_claims_the_name_that_it_runs(install, table, tmp_path, capsys):
    install("static", adapter_source(), package="prbench_thief")
    words = ["run", "--method", "static", "--data", str(table.folder), "--out", str(tmp_path / "out"), "--limit", "4"]
    assert main(words) == 0
    said = capsys.readouterr()
    assert "note: prbench_thief 1.2 is not used: 'static' is a method of prbench itself" in said.err
    assert "static (built in), condition none" in said.out
    assert RunRecord.read(tmp_path / "out").method.kind == "built-in"


@pytest.mark.parametrize("name", ["pr", "Ground-Truth", "a|b"])
def test_a_toml_file_with_a_name_that_is_not_its_own_is_refused(tmp_path, name):
    file = tmp_path / "m.toml"
    file.write_text(f'[method]\ncommand = "python m.py"\nname = "{name}"\n')
    with pytest.raises(InputFileError, match=r"m\.toml, method\.name: expected a name of the method's own, found"):
        read_description(file)


def test_a_file_of_motions_is_refused_under_a_name_of_prbenchs(table, tmp_path):
    with pytest.raises(UsageError, match="--name: 'ground-truth' is a control of prbench"):
        ScoreRequest(predictions=tmp_path / "x.npz", data=(table.folder,), name="ground-truth")
    with pytest.raises(UsageError, match="--name: expected a name of 1 to 100 characters"):
        ScoreRequest(predictions=tmp_path / "x.npz", data=(table.folder,), name="=cmd|' /C calc'!A0")
    wanted = ScoreRequest(predictions=tmp_path / "ground-truth.npz", data=(table.folder,))
    with pytest.raises(UsageError, match=r"ground-truth\.npz: .* Say what the method is called with --name\."):
        score_predictions(wanted)


def test_the_kind_of_a_method_is_recorded_and_told(install, table, tmp_path):
    install("made", adapter_source())
    run_method(request(table, tmp_path / "made", "made", limit=2))
    run_method(request(table, tmp_path / "truth", "ground-truth", limit=2))
    made = RunRecord.read(tmp_path / "made").method
    assert (made.kind, made.origin) == ("package", "package prbench_made 1.2")
    assert RunRecord.read(tmp_path / "truth").method.origin == "control"


@pytest.mark.parametrize(
    ("method", "origin"),
    [
        ({"kind": "adapter", "package": "prbench"}, "built in"),
        ({"kind": "adapter", "package": "prbench-glide"}, "package prbench-glide 1.0"),
        ({"kind": "offline", "package": "m.npz"}, "file m.npz"),
        (
            {"kind": "program", "package": "python m.py", "isolation": "bubblewrap"},
            "program python m.py, isolated: bubblewrap",
        ),
        ({"package": "who"}, "unknown kind"),
        ({"kind": "whatever", "package": "who"}, "unknown kind"),
        ({"kind": "package", "package": "a\x1b[2Jb"}, r"package a\x1b[2Jb 1.0"),
    ],
)
def test_records_of_older_versions_are_read_and_say_what_they_know(table, tmp_path, method, origin):
    run_method(request(table, tmp_path / "out", limit=2))
    record = json.loads((tmp_path / "out/run.json").read_text())
    del record["method"]["kind"]
    record["method"] |= {"version": "1.0", **method}
    (tmp_path / "out/run.json").write_text(json.dumps(record))
    assert RunRecord.read(tmp_path / "out").method.origin == origin


def test_a_method_that_ends_its_worker_is_blamed(install, table, tmp_path):
    class Broken:
        def map(self, function, items):
            raise MemoryFullError("one item of the work", "a worker process ended without an answer")

    install("made", adapter_source())
    with pytest.raises(AdapterError, match="method 'made': one item of the work: a worker process ended"):
        run_method(request(table, tmp_path / "made", "made"), engine=Broken())
    with pytest.raises(MemoryFullError):
        run_method(request(table, tmp_path / "static"), engine=Broken())
