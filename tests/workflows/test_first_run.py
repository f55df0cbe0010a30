"""Without data, prbench builds a synthetic dataset once, says so and where, and goes on."""

from __future__ import annotations

import threading
import time

import pytest

from prbench.cli import main
from prbench.contract import Condition
from prbench.engine import InProcess
from prbench.evaluation.request import RunRequest
from prbench.methods.installed import list_adapters
from prbench.workflows import first_run
from tests.fakes import fake_dataset
from tests.test_locks import holder


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty cache, and a default dataset of two recordings."""
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(first_run, "RECORDINGS", 2)
    return tmp_path / "cache"


@pytest.mark.unchecked_shapes
def test_a_run_without_data_builds_it_once_and_says_where(cache, tmp_path, capsys):
    run = ["run", "--method", "ground-truth", "--split", "train"]
    assert main([*run, "--out", str(tmp_path / "one")]) == 0
    first = capsys.readouterr()
    folder = first_run.default_table_folder()
    assert folder.is_relative_to(cache)
    assert f"building a synthetic dataset of 2 recordings in {folder} (once)" in first.err
    assert "synthetic" in first.out
    built = (folder / "sequences.parquet").stat().st_mtime_ns
    assert main([*run, "--out", str(tmp_path / "two")]) == 0
    second = capsys.readouterr()
    assert f"using the embedded synthetic dataset in {folder}" in second.err
    assert (folder / "sequences.parquet").stat().st_mtime_ns == built


def test_the_embedded_dataset_says_that_it_is_synthetic(cache):
    info = first_run.default_table(InProcess(), lambda done, total, last: None).info
    assert info.synthetic
    assert info.dataset == "synthetic-adt"
    assert info.counts.recordings_read == 2


def test_another_version_of_the_people_gets_another_folder(cache, monkeypatch):
    folder = first_run.default_table_folder()
    monkeypatch.setattr(first_run, "GENERATOR_VERSION", first_run.GENERATOR_VERSION + 1)
    assert first_run.default_table_folder() != folder


def test_a_first_run_is_shown_beside_the_methods_that_are_installed(tmp_path, monkeypatch):
    request = RunRequest(method="pr", condition=Condition.GOAL_LOCATION, data=(tmp_path,))
    beside = [(one.method, one.condition) for one in first_run.companions(request)]
    assert beside[0] == ("mdm", Condition.TEXT)
    assert [method for method, _ in beside[1:]] == ["scripted", "static", "ground-truth"]
    without = [adapter for adapter in list_adapters() if adapter.name != "mdm"]
    monkeypatch.setattr(first_run, "list_adapters", lambda: without)
    assert [(one.method, one.condition) for one in first_run.companions(request)] == beside[1:]


def test_a_first_run_waits_for_the_one_that_builds_the_dataset_and_says_for_whom(cache, monkeypatch):
    said, built = [], []
    folder = first_run.default_table_folder()

    def build(*arguments, out, **more):
        built.append(out)
        fake_dataset(out, 2)

    monkeypatch.setattr("prbench.workflows.synthetic_table.build_synthetic_table", build)
    with holder(folder.with_name(f"{folder.name}.first-run")) as process:

        def let_go_when_told():
            while not said:
                time.sleep(0.01)
            assert not built
            process.communicate("\n")

        other = threading.Thread(target=let_go_when_told)
        other.start()
        first_run.default_table(InProcess(), lambda done, total, last: None, said.append)
        other.join()
    assert f"waiting until process {process.pid} on " in said[0]
    assert built == [folder]
