"""Runs of a method that is a program of the user's own: what is recorded, what is the same, how it fails."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from prbench.engine import ProcessPool
from prbench.errors import AdapterError, RunError, UsageError
from prbench.files.storage import file_digest
from prbench.harness.methods.loading import forget_loaded_methods, method_spec
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.run_folder.record import RunRecord
from prbench.harness.run_folder.summary import DatasetSummary
from tests.harness.test_run import reproducible_bytes, request
from tests.method_fixtures import adapter_source

PROGRAM = """
import sys
from pathlib import Path
from prbench.contract import Condition
from prbench.engine import engine_for
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
if __name__ == "__main__":
    run_method(
        RunRequest(
            method=sys.argv[1],
            condition=Condition.NONE,
            data=(Path(sys.argv[2]),),
            out=Path(sys.argv[3]),
            batch_size=4,
        ),
        engine=engine_for(int(sys.argv[4])),
        progress=lambda step: print(step.stage, step.done, flush=True),
    )
"""


def started_run(own, table, out, tmp_path, *, workers=1) -> subprocess.Popen:
    (tmp_path / "run.py").write_text(PROGRAM)
    words = [sys.executable, str(tmp_path / "run.py"), own.method, str(table.folder), str(out), str(workers)]
    return subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)


def parts(folder: Path) -> dict[str, bytes]:
    return {name: content for name, content in reproducible_bytes(folder).items() if name != "run.json"}


def test_the_record_holds_what_the_program_says_and_no_path_of_the_machine(own, table, tmp_path):
    own.write(hello='introduction.update(weights={"none": {"name": "w.npz", "sha256": "%s"}})' % ("0" * 64))
    report = run_method(request(table, tmp_path / "out", own.method, options={"a": "1"}))
    record = RunRecord.read(tmp_path / "out").method
    assert (record.name, record.kind, record.version) == ("drawn", "program", "2.1")
    assert record.package == f"{Path(sys.executable).name} drawn.py"
    assert (record.weights, record.weights_digest, record.isolation) == ("w.npz", "0" * 64, None)
    assert record.options == {"a": "1"}
    assert report.summaries[0].method == "drawn"
    assert DatasetSummary.read(tmp_path / "out/synthetic-adt").method == "drawn"
    written = (tmp_path / "out/run.json").read_text() + (tmp_path / "out/synthetic-adt/summary.json").read_text()
    assert str(tmp_path) not in written
    assert "cmd:" not in written


def test_what_a_program_declares_is_honoured(own, table, tmp_path):
    own.write(hello="introduction.update(max_frames=80, motionless=True)")
    run_method(request(table, tmp_path / "out", own.method))
    record = RunRecord.read(tmp_path / "out")
    assert record.method.max_frames == 80
    assert record.method.motionless
    assert record.tables[0].unsupported > 0


def test_a_program_and_the_same_method_in_process_give_the_same_bytes(own, table, tmp_path, install):
    own.write()
    install("made", adapter_source(body="joints = joints.astype(np.float32)"))
    run_method(request(table, tmp_path / "in", "made", samples=2))
    run_method(request(table, tmp_path / "out", own.method, samples=2), engine=ProcessPool(2))
    predictions = {name: content for name, content in parts(tmp_path / "in").items() if "summary" not in name}
    assert len(predictions) == 6
    assert {name: parts(tmp_path / "out")[name] for name in predictions} == predictions


def test_seconds_passes_and_the_programs_memory_stand_in_the_cost(own, table, tmp_path):
    own.write(hello="ballast = np.ones(50_000_000)")
    run_method(request(table, tmp_path / "out", own.method))
    cost = json.loads((tmp_path / "out/synthetic-adt/cost.json").read_text())
    assert cost["network_passes_declared"] == 3 * 4
    assert cost["seconds"] > 0
    assert cost["peak_process_bytes"] > 400_000_000


def test_a_program_gets_settings_and_an_environment_without_the_harness(own, table, tmp_path, monkeypatch):
    monkeypatch.setenv("PRBENCH_SECRET", "1")
    monkeypatch.setenv("USER_OWN", "2")
    (tmp_path / "w.npz").write_bytes(b"weights")
    own.write(hello='print(json.dumps([settings, dict(os.environ), os.getcwd()]), file=open("told.json", "w"))')
    monkeypatch.chdir(tmp_path)
    changes = {"weights": Path("w.npz"), "options": {"k": "v"}, "threads": 2, "device": "cuda:1"}
    run_method(request(table, tmp_path / "out", own.method, limit=1, **changes))
    settings, environment, directory = json.loads((tmp_path / "told.json").read_text())
    assert settings["weights"] == str(tmp_path / "w.npz")
    assert (settings["options"], settings["threads"], settings["device"]) == ({"k": "v"}, 2, "cuda:1")
    assert environment["USER_OWN"] == "2"
    assert not [name for name in environment if name.startswith("PRBENCH_")]
    assert directory == str(tmp_path)
    record = RunRecord.read(tmp_path / "out").method
    assert (record.weights, record.weights_digest) == ("w.npz", file_digest(tmp_path / "w.npz"))


@pytest.mark.parametrize(
    ("name", "owner"),
    [
        ("ground-truth", "control of prbench"),
        ("Scripted", "control of prbench"),
        ("pr", "method of prbench itself"),
        ("Ground_Truth", "control of prbench"),
    ],
)
def test_a_program_must_not_call_itself_like_what_belongs_to_prbench(own, table, tmp_path, name, owner):
    own.write(hello=f'introduction.update(name="{name}")')
    with pytest.raises(
        AdapterError,
        match=f"'{name}' is a {owner}; only prbench itself may use this name. Let it introduce itself by another",
    ):
        run_method(request(table, tmp_path / "out", own.method))
    assert not (tmp_path / "out").exists()


def test_a_toml_file_says_how_the_program_must_call_itself(own, table, tmp_path):
    own.write()
    file = own.folder / "drawn.toml"
    file.write_text(f'[method]\nname = "drawn"\ncommand = [\'{sys.executable}\', "drawn.py"]\n')
    run_method(request(table, tmp_path / "out", str(file)))
    assert RunRecord.read(tmp_path / "out").method.package == f"{Path(sys.executable).name} drawn.py"
    file.write_text(file.read_text().replace('"drawn"', '"glide"'))
    with pytest.raises(AdapterError, match="method 'glide': expected the program to introduce itself by this name"):
        run_method(request(table, tmp_path / "other", str(file)))


@pytest.mark.skipif(os.name == "nt", reason="makes programs as POSIX systems have them")
@pytest.mark.parametrize(
    ("environment", "tool", "isolation"),
    [('conda = "drawn"', "conda", None), ('container = "drawn@sha256:1"', "podman", "container")],
)
def test_a_method_runs_in_its_own_environment(own, table, tmp_path, monkeypatch, environment, tool, isolation):
    own.write()
    (tmp_path / tool).write_text('#!/bin/sh\nwhile [ "$1" != python ]; do shift; done\nshift\nexec $REAL "$@"\n')
    (tmp_path / tool).chmod(0o755)
    file = own.folder / "drawn.toml"
    variables = f'variables = {{ REAL = "{sys.executable}" }}'
    file.write_text(f'[method]\ncommand = "python drawn.py"\n[environment]\n{environment}\n{variables}\n')
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}/bin")
    run_method(request(table, tmp_path / "out", str(file), limit=2, isolate=isolation is not None))
    record = RunRecord.read(tmp_path / "out").method
    assert (record.name, record.isolation) == ("drawn", isolation)
    assert record.package.startswith(tool)
    assert record.package.endswith(": python drawn.py")


def test_another_version_of_the_program_does_not_go_on_in_the_folder(own, table, tmp_path):
    own.write()
    run_method(request(table, tmp_path / "out", own.method))
    own.write(hello='introduction.update(version="3")')
    with pytest.raises(RunError, match=r"method\.version: expected 3 for this run, found 2\.1"):
        run_method(request(table, tmp_path / "out", own.method))


def test_an_error_of_a_program_names_the_sequence(own, table, tmp_path):
    refusal = '{"message": "error", "batch": header["batch"], "text": "no way to " + rows["opaque_id"][0]}'
    own.write(body=f"write({refusal})\ncontinue")
    with pytest.raises(AdapterError, match=r"method 'drawn': .*: no way to synthetic-adt/rec"):
        run_method(request(table, tmp_path / "out", own.method))
    assert not (tmp_path / "out").exists()


def test_wrong_lengths_and_late_answers_end_the_run_and_keep_what_was_finished(own, table, tmp_path):
    own.write(body='if header["batch"] == 2: joints[0] = joints[0][66:]')
    with pytest.raises(AdapterError, match=r"method 'drawn', sequence synthetic-adt.*: expected \d+ frames, found \d+"):
        run_method(request(table, tmp_path / "out", own.method))
    assert len(list((tmp_path / "out/synthetic-adt/predictions").glob("part-*.parquet"))) == 2
    own.write(body="time.sleep(60)")
    with pytest.raises(AdapterError, match="--timeout"):
        run_method(request(table, tmp_path / "out", own.method, timeout=0.5))
    own.write()
    report = run_method(request(table, tmp_path / "out", own.method))
    assert (report.batches_found, report.batches_made) == (2, 2)
    run_method(request(table, tmp_path / "whole", own.method))
    assert reproducible_bytes(tmp_path / "out") == reproducible_bytes(tmp_path / "whole")


def test_a_batch_that_does_not_fit_in_the_programs_memory_is_run_in_halves(own, table, tmp_path):
    full = '{"message": "error", "batch": header["batch"], "text": "full", "out_of_memory": True}'
    own.write(body=f"if len(joints) > 2:\n    write({full})\n    continue")
    assert run_method(request(table, tmp_path / "out", own.method)).batches_made == 4


def test_ctrl_c_ends_the_program_keeps_what_was_finished_and_the_same_command_resumes(own, table, tmp_path):
    own.write()

    def interrupt(step):
        if (step.stage, step.done) == ("generate", 2):
            assert own.running()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_method(request(table, tmp_path / "out", own.method), progress=interrupt)
    assert not own.running()
    report = run_method(request(table, tmp_path / "out", own.method))
    assert (report.batches_found, report.batches_made) == (2, 2)
    run_method(request(table, tmp_path / "whole", own.method))
    assert reproducible_bytes(tmp_path / "out") == reproducible_bytes(tmp_path / "whole")


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
@pytest.mark.parametrize(("end", "workers"), [("SIGINT", 2), ("SIGKILL", 1)])
def test_no_program_outlives_a_harness_that_was_stopped(own, table, tmp_path, end, workers):
    own.write(body="time.sleep(0.2)")
    run = started_run(own, table, tmp_path / "out", tmp_path, workers=workers)
    _wait_for_a_batch(run)
    assert own.running()
    os.killpg(run.pid, getattr(signal, end))
    run.communicate(timeout=20)  # the fixture sees that the programs have ended


def _wait_for_a_batch(run: subprocess.Popen) -> None:
    for line in run.stdout:
        if line.startswith("generate 1"):
            return


def test_settings_that_do_not_fit_together_are_refused(table, tmp_path):
    with pytest.raises(UsageError, match=r"--timeout: 'static' runs in this process.*Add --isolate"):
        method_spec("static", timeout=3.0)
    with pytest.raises(UsageError, match="--timeout: expected seconds above 0, found 0"):
        request(table, tmp_path, timeout=0.0)
    with pytest.raises(UsageError, match="--method scripted is part of the harness"):
        request(table, tmp_path, "scripted", isolate=True)
    with pytest.raises(UsageError, match=r"--weights no/such\.npz: expected a file or folder"):
        run_method(RunRequest(method="cmd:python x", data=(table.folder,), weights=Path("no/such.npz")))


def test_a_forgotten_program_ends_at_once(own):
    own.write()
    assert method_spec(own.method).load().adapter.name == "drawn"
    assert len(own.running()) == 1
    forget_loaded_methods()
    assert not own.running()
