"""The same method in process and isolated: the same bytes, the same errors."""

from __future__ import annotations

import tempfile

import numpy as np
import pytest

from prbench.cli.main import main
from prbench.contract import Condition, ConditionBatch
from prbench.engine import ProcessPool
from prbench.errors import AdapterError, RunError
from prbench.harness.methods.loading import forget_loaded_methods, method_spec
from prbench.harness.methods.motions import generate_checked
from prbench.harness.run import run_method
from prbench.harness.run_folder.record import RunRecord
from tests.harness.test_run import reproducible_bytes, request
from tests.method_fixtures import adapter_source


def results(folder) -> dict[str, bytes]:
    """Everything but the record, which says how the method was kept."""
    return {name: content for name, content in reproducible_bytes(folder).items() if name != "run.json"}


def test_a_method_that_draws_gives_the_same_bytes_in_process_and_isolated(fence, table, tmp_path, install):
    install("made", adapter_source())
    run_method(request(table, tmp_path / "here", "made", samples=2))
    run_method(request(table, tmp_path / "apart", "made", samples=2, isolate=True))
    assert len(results(tmp_path / "apart")) == 7
    assert results(tmp_path / "apart") == results(tmp_path / "here")
    record = RunRecord.read(tmp_path / "apart").method
    assert (record.name, record.kind, record.package, record.version) == ("made", "package", "prbench_made", "1.2")
    assert record.isolation == fence


def test_an_isolated_run_that_was_stopped_is_resumed_by_two_workers_with_the_same_bytes(
    no_bubblewrap, table, tmp_path, install
):
    def stop(step):
        if (step.stage, step.done) == ("generate", 2):
            raise KeyboardInterrupt

    install("made", adapter_source())
    run_method(request(table, tmp_path / "here", "made"))
    with pytest.raises(KeyboardInterrupt):
        run_method(request(table, tmp_path / "apart", "made", isolate=True), progress=stop)
    report = run_method(request(table, tmp_path / "apart", "made", isolate=True), engine=ProcessPool(2))
    assert (report.batches_found, report.batches_made) == (2, 2)
    assert results(tmp_path / "apart") == results(tmp_path / "here")


def test_a_method_that_is_fitted_learns_the_same_from_a_copy_of_the_training_rows(fence, table, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    fits, folders = {}, {}
    for name, isolate in (("here", False), ("apart", True)):
        monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / f"cache-{name}"))
        run_method(request(table, tmp_path / name, "static", isolate=isolate))
        [fits[name]] = (tmp_path / f"cache-{name}/fits").glob("*/mean_pose.json")
        folders[name] = fits[name].parent.name
    assert fits["here"].read_bytes() == fits["apart"].read_bytes()
    assert folders["here"] == folders["apart"]
    assert results(tmp_path / "here") == results(tmp_path / "apart")
    assert list((tmp_path / "temporary").iterdir()) == []


def test_a_network_computes_the_same_apart_with_its_bundled_weights_and_threads(no_bubblewrap, table, tmp_path):
    asked = {"condition": Condition.TEXT, "limit": 1, "options": {"steps": "1"}, "threads": 2}
    for name, isolate in (("here", False), ("apart", True)):
        run_method(request(table, tmp_path / name, "mdm", isolate=isolate, **asked))
    assert results(tmp_path / "here") == results(tmp_path / "apart")
    here, apart = (RunRecord.read(tmp_path / name).method for name in ("here", "apart"))
    assert apart.weights_digest is not None
    assert (apart.weights, apart.weights_digest) == (here.weights, here.weights_digest)


def test_a_fit_gets_no_path_to_the_table(no_bubblewrap, table, tmp_path, install):
    body = "raise ValueError([str(train.folder), type(train).__name__])"
    source = adapter_source(attributes=f"def fit(self, train, *, validation, run): {body}")
    install("made", source)
    with pytest.raises(AdapterError) as error:
        run_method(request(table, tmp_path / "out", "made", isolate=True))
    assert "prbench-train-" in str(error.value)
    assert "TrainingSplit" in str(error.value)
    assert str(table.folder) not in str(error.value)


def test_a_run_that_was_isolated_does_not_go_on_in_one_that_was_not(no_bubblewrap, table, tmp_path, install):
    install("made", adapter_source())
    run_method(request(table, tmp_path / "out", "made"))
    with pytest.raises(RunError, match=r"method\.isolation: expected process for this run, found nothing"):
        run_method(request(table, tmp_path / "out", "made", isolate=True))


WRONG = """
            if seed == 0: raise ValueError("no way")
            if seed == 1: joints = joints[:, :-1]
            if seed == 2: joints[0, 1] = np.nan
            if seed == 3: n_frames = n_frames - 1
            if seed == 4: joints = joints.tolist()
            if seed == 5: import sys; sys.exit("enough")
            if seed == 6: import os; os._exit(3)"""
ANSWERS = (
    "ValueError: no way (",
    "expected 60 frames, found 59 in joints",
    "sequence a/b, frame 1: expected finite positions",
    "sequence a/b: expected 60 frames, found 59",
    "expected joints as a NumPy array, found list",
    "SystemExit: enough",
    "exit status 3",
)


def test_errors_are_told_like_those_of_a_method_in_process(no_bubblewrap, install):
    install("made", adapter_source(body=WRONG.strip()))
    adapter = method_spec("made", isolate=True).load().adapter
    batch = ConditionBatch(
        condition=Condition.NONE, n_frames=np.array([60, 9]), fps=20.0, opaque_id=("0f", "f0"), noise_seed=(1, 2)
    )
    for seed, answer in enumerate(ANSWERS):
        with pytest.raises(AdapterError) as error:
            generate_checked(adapter, batch, seed=seed, method="made", sequence_ids=("a/b", "c/d"))
        assert answer in str(error.value)
        assert "a/b" in str(error.value)
    forget_loaded_methods()


def test_prints_of_a_method_and_of_its_libraries_do_no_harm(no_bubblewrap, table, tmp_path, install):
    noise = "import os, sys; print('hello'); os.write(1, b'from C'); os.system('echo from a child'); sys.stdin.read()"
    install("made", adapter_source(body=noise))
    run_method(request(table, tmp_path / "out", "made", isolate=True))
    install("quiet", adapter_source())
    run_method(request(table, tmp_path / "quiet", "quiet"))
    names = [name for name in results(tmp_path / "out") if name.startswith("predictions")]
    assert len(names) == 4
    for name in names:
        assert (tmp_path / "out" / name).read_bytes() == (tmp_path / "quiet" / name).read_bytes()


def test_a_batch_that_does_not_fit_in_the_workers_memory_is_run_in_halves(no_bubblewrap, table, tmp_path, install):
    install("made", adapter_source(body="if len(batch) > 2: raise MemoryError"))
    assert run_method(request(table, tmp_path / "out", "made", isolate=True)).batches_made == 4


def test_the_command_line_says_what_is_withheld_and_shows_the_methods_own_name(no_bubblewrap, table, tmp_path, capsys):
    words = ["run", "--method", "static", "--data", str(table.folder), "--out", str(tmp_path / "out"), "--isolate"]
    assert main([*words, "--limit", "2", "--timeout", "60"]) == 0
    shown = capsys.readouterr()
    assert "THE FILE SYSTEM IS NOT WITHHELD" in shown.err
    assert "static (built in, isolated: process), condition none" in shown.out


def test_settings_that_the_method_refuses_are_told(no_bubblewrap, table, tmp_path):
    with pytest.raises(AdapterError, match="unknown option 'pose'; known options: pose-only"):
        run_method(request(table, tmp_path / "out", options={"pose": "1"}, isolate=True))
    with pytest.raises(AdapterError, match="does not take the condition 'text'"):
        run_method(request(table, tmp_path / "out", condition=Condition.TEXT, isolate=True))


def test_declared_limits_and_weights_cross_the_border(no_bubblewrap, table, tmp_path, install):
    attributes = (
        "max_frames = 200; native_fps = 30.0; motionless = True\n"
        "        def weights_for(self, condition):\n"
        "            import pathlib\n"
        "            return pathlib.Path(__file__)"
    )
    install("made", adapter_source(attributes=attributes))
    run_method(request(table, tmp_path / "here", "made"))
    run_method(request(table, tmp_path / "apart", "made", isolate=True))
    here, apart = RunRecord.read(tmp_path / "here").method, RunRecord.read(tmp_path / "apart").method
    assert apart.weights_digest
    for name in ("max_frames", "native_fps", "motionless", "weights", "weights_digest"):
        assert getattr(here, name) == getattr(apart, name)
    assert results(tmp_path / "here") == results(tmp_path / "apart")
