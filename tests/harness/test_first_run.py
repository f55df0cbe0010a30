"""Without data, prbench builds small synthetic datasets once, says so and where, and goes on."""

from __future__ import annotations

import json
import threading
import time
from collections import Counter

import pytest

from prbench.cli import main
from prbench.contract import Condition
from prbench.engine import InProcess
from prbench.harness import first_run
from prbench.harness.methods.installed import list_adapters
from prbench.harness.request import RunRequest
from prbench.harness.synthetic_table import recordings_of_people
from prbench.sequences import DatasetInfo
from prbench.synthetic.people.world import Source, assign
from tests.fakes import fake_dataset
from tests.files.test_storage import holder


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty cache, and default datasets of two layouts with one recording each."""
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(first_run, "LAYOUTS", ("adt", "hot3d"))
    monkeypatch.setattr(first_run, "PEOPLE", {"train": 1})
    return tmp_path / "cache"


def build_fakes(monkeypatch, after=lambda: None):
    """Make every build a made-up one, followed by a call; return the list of the folders that are built."""
    built = []

    def build(layout, *, out, **more):
        fake_dataset(out, 2, dataset=f"synthetic-{layout}")
        built.append(out)
        after()

    monkeypatch.setattr("prbench.harness.synthetic_table.build_synthetic_table", build)
    return built


@pytest.mark.slow
@pytest.mark.unchecked_shapes
def test_a_run_without_data_builds_the_datasets_once_and_says_where(cache, tmp_path, capsys):
    run = ["run", "--method", "ground-truth", "--split", "train"]
    assert main([*run, "--out", str(tmp_path / "one")]) == 0
    first = capsys.readouterr()
    folder = first_run.default_folder()
    assert folder.is_relative_to(cache)
    assert f"building 2 small synthetic datasets in {folder} (once)" in first.err
    assert [path.name for path in sorted(folder.iterdir())] == ["adt", "hot3d"]
    for name in first_run.LAYOUTS:
        info = DatasetInfo.read(folder / name)
        assert info.synthetic
        assert info.dataset == f"synthetic-{name}"
        assert info.counts.recordings_read == 1
    assert "These are scores on synthetic data: never compare them with published ones." in first.out
    header = next(line for line in first.out.splitlines() if "metric" in line)
    assert header.split() == ["metric", "adt", "hot3d", "mean"]
    assert "· phi" in first.out
    assert "Cannot be decided: adt, hot3d (1 recording, where a comparison of 2 methods needs 9)." in first.out
    built = (folder / "adt" / "sequences.parquet").stat().st_mtime_ns
    assert main([*run, "--out", str(tmp_path / "two"), "--json"]) == 0
    second = capsys.readouterr()
    assert f"using the 2 embedded synthetic datasets in {folder}" in second.err
    assert (folder / "adt" / "sequences.parquet").stat().st_mtime_ns == built
    made = json.loads(second.out)["report"]["runs"][0]
    reached = [
        next(metric["mean"] for metric in dataset["metrics"] if metric["metric"] == "reach_success")
        for dataset in made["datasets"]
    ]
    assert made["means"]["reach_success"]["mean"] == pytest.approx(sum(reached) / 2)


def test_a_killed_first_build_goes_on_with_the_datasets_that_are_missing(cache, monkeypatch):
    def kill():
        raise KeyboardInterrupt

    killed = build_fakes(monkeypatch, after=kill)
    with pytest.raises(KeyboardInterrupt):
        first_run.default_tables(InProcess(), lambda done, total, last: None)
    assert [path.name for path in killed] == ["adt"]
    assert not first_run.default_tables_are_built()
    later = build_fakes(monkeypatch)
    tables = first_run.default_tables(InProcess(), lambda done, total, last: None)
    assert [path.name for path in later] == ["hot3d"]
    assert [table.info.dataset for table in tables] == ["synthetic-adt", "synthetic-hot3d"]


def test_the_test_people_of_every_layout_are_all_there_and_in_no_other_split():
    for layout in first_run.LAYOUTS:
        source = Source(first_run.SEED, layout, "default")
        recordings = recordings_of_people(layout, first_run.SEED, first_run.PEOPLE)
        castings = [assign(source, index) for index in recordings]
        people = Counter(split for _, _, split in castings)
        assert people == first_run.PEOPLE
        assert len({person for _, person, _ in castings}) == len(castings)


def test_another_version_of_the_people_gets_another_folder(cache, monkeypatch):
    folder = first_run.default_folder()
    monkeypatch.setattr(first_run, "GENERATOR_VERSION", first_run.GENERATOR_VERSION + 1)
    assert first_run.default_folder() != folder


def test_a_first_run_is_shown_beside_the_methods_that_are_installed(tmp_path, monkeypatch):
    request = RunRequest(method="pr", condition=Condition.GOAL_LOCATION, data=(tmp_path,))
    beside = [(one.method, one.condition) for one in first_run.companions(request)]
    assert beside[0] == ("mdm", Condition.TEXT)
    assert [method for method, _ in beside[1:]] == ["scripted", "static", "ground-truth"]
    without = [adapter for adapter in list_adapters() if adapter.name != "mdm"]
    monkeypatch.setattr(first_run, "list_adapters", lambda: without)
    assert [(one.method, one.condition) for one in first_run.companions(request)] == beside[1:]


def test_a_first_run_waits_for_the_one_that_builds_the_dataset_and_says_for_whom(cache, monkeypatch):
    said: list[str] = []
    folder = first_run.default_folder()
    built = build_fakes(monkeypatch)
    with holder(folder.with_name(f"{folder.name}.first-run")) as process:

        def let_go_when_told():
            while not said:
                time.sleep(0.01)
            assert not built
            process.communicate("\n")

        other = threading.Thread(target=let_go_when_told)
        other.start()
        first_run.default_tables(InProcess(), lambda done, total, last: None, said.append)
        other.join()
    assert f"waiting until process {process.pid} on " in said[0]
    assert tuple(built) == first_run.default_table_folders()
