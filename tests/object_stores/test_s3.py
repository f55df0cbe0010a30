"""Commands and the Python API against a real S3 server on this machine."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import fsspec
import pytest

import prbench
from prbench.cli.main import main
from prbench.errors import InputFileError, RunError
from prbench.files.storage import cache_folder
from prbench.harness import run as running
from prbench.object_stores.inputs import fetched
from prbench.object_stores.store import FINISHED, OWN_PREFIX, UNFINISHED, WORK_PREFIX, ObjectStoreError, Store, describe
from tests.fakes import fake_dataset
from tests.object_stores.conftest import contents, local_contents, start_moto, use_server
from tests.object_stores.test_outputs import publish

RUN = ("run", "--method", "static", "--condition", "none", "--quiet")


@pytest.fixture(scope="module")
def table(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("table") / "table"
    fake_dataset(folder, 12)
    return folder


def put_folder(folder: Path, url: str) -> None:
    """Copy a folder as another program would."""
    system, top = fsspec.url_to_fs(url, skip_instance_cache=True)
    for name, content in local_contents(folder).items():
        system.pipe_file(f"{top}/{name}", content)


@pytest.fixture
def stored_table(bucket, table) -> str:
    describe(table)
    put_folder(table, f"{bucket}/table")
    return f"{bucket}/table"


def test_commands_read_and_write_there_and_show_urls_in_place_of_local_copies(bucket, stored_table, capsys):
    run = f"{bucket}/run"
    assert main([*RUN, "--data", stored_table, "--out", run, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["report"]["runs"][0]["folder"] == run
    assert f"the local copy is {cache_folder()}" in document["notes"][-1]
    assert main(["leaderboard", "compare", run, run, "--json"]) == 0
    unverified = json.loads(capsys.readouterr().out)["report"]["unverified"]
    assert unverified[0].startswith(f"{run}: ")
    assert {FINISHED, "run.json", "synthetic-adt/summary.json"} <= set(contents(run))
    assert b"s3:" not in contents(run)["run.json"]
    assert main([*RUN, "--seed", "1", "--data", stored_table, "--out", run]) == RunError.exit_code
    said = capsys.readouterr().err
    assert f"prbench: {run}" in said
    assert "cache" not in said
    assert main(["inspect", stored_table, "--out", f"{bucket}/inspect.json"]) == 0
    assert json.loads(contents(bucket)["inspect.json"])["command"] == "inspect"
    assert len(prbench.open_table(stored_table)) == 12
    assert prbench.open_run(run).to_pandas().shape[0] > 0


@pytest.mark.slow
def test_python_takes_urls_where_it_takes_folders(bucket, stored_table, table, tmp_path):
    run = prbench.run("static", condition="none", data=stored_table, out=f"{bucket}/run")
    local = prbench.run("static", condition="none", data=table, out=tmp_path / "run")
    assert run.to_pandas().equals(local.to_pandas())
    _require_equal(f"{bucket}/run", tmp_path / "run")
    scores = prbench.score(f"{bucket}/run", stored_table, out=f"{bucket}/scores")
    assert scores.to_pandas().shape == run.to_pandas().shape
    assert FINISHED in contents(f"{bucket}/scores")


@pytest.mark.parametrize(
    ("command", "code", "said"),
    [
        (["inspect", "{}/nothing"], 3, "found nothing"),
        (["inspect", "s3://no-such-bucket/table"], 8, "there is no such bucket"),
        ([*RUN, "--data", "{}/nothing", "--out", "{}/run"], 3, "found nothing"),
        (
            ["build-dataset", "adt", "--root", "{}/nothing", "--out", "{}/table"],
            3,
            "expected files of adt, found nothing",
        ),
        (["inspect", "s3://key:hunter2@bench/table"], 2, "the URL holds a name or a password"),
        (["poses", "egoallo", "--root", "{}/x"], 2, "has to be a path on this machine"),
    ],
)
def test_what_goes_wrong_there_is_one_line_with_the_url(bucket, capsys, command, code, said):
    assert main([word.format(bucket) for word in command]) == code
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert said in line
    assert "s3://" in line
    assert "hunter2" not in line


def test_a_store_that_stops_in_the_middle_of_an_upload(tmp_path, monkeypatch):
    pytest.importorskip("s3fs")
    pytest.importorskip("moto")
    served = start_moto()
    url = f"{use_server(served, monkeypatch)}/folder"
    publish(url, a="old", b="old")
    upload = Store.upload
    uploaded = []

    def stopping(self, path, name):
        if uploaded:
            served.stop()
        uploaded.append(name)
        upload(self, path, name)

    monkeypatch.setattr(Store, "upload", stopping)
    with pytest.raises(ObjectStoreError, match="cannot be reached, or the connection was lost") as lost:
        publish(url, a="new", b="new")
    assert url in str(lost.value)
    assert "nothing at the URL was replaced; the same command uploads it" in str(lost.value)
    with pytest.raises(ObjectStoreError, match="Is the endpoint right"):
        fetched(url)


def test_credentials_that_are_missing_are_named(bucket, monkeypatch):
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.delenv(name)
    monkeypatch.setenv("AWS_EC2_METADATA_DISABLED", "true")
    with pytest.raises(ObjectStoreError, match="Check the credentials"):
        publish(f"{bucket}/folder", a="1")


def test_a_changed_object_is_refused(bucket):
    publish(f"{bucket}/folder", a="abc")
    system, top = fsspec.url_to_fs(f"{bucket}/folder", skip_instance_cache=True)
    system.pipe_file(f"{top}/a", b"abd")
    with pytest.raises(InputFileError, match="the SHA-256"):
        fetched(f"{bucket}/folder")


@pytest.mark.slow
def test_sigterm_uploads_what_is_finished(bucket, table, tmp_path, monkeypatch):
    """In this process: the method itself sends the signal, after some batches."""
    made = []
    run_batch = running.run_batch

    def stop_after_three(task):
        answer = run_batch(task)
        made.append(task.index)
        if len(made) == 2:
            os.kill(os.getpid(), signal.SIGTERM)
        return answer

    arguments = [*RUN, "--split", "train", "--batch-size", "1", "--data", str(table), "--out", f"{bucket}/run"]
    with monkeypatch.context() as patched:
        patched.setattr(running, "run_batch", stop_after_three)
        assert main(arguments) == 143
    kept = contents(f"{bucket}/run")
    assert UNFINISHED in kept
    assert FINISHED not in kept
    assert len([name for name in kept if name.startswith("synthetic-adt/predictions/")]) == 2
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "another machine"))
    assert main(arguments) == 0
    assert main([*arguments[:-1], str(tmp_path / "whole")]) == 0
    _require_equal(f"{bucket}/run", tmp_path / "whole")


def _require_equal(url: str, folder: Path, *, varies: tuple[str, ...] = ("synthetic-adt/cost.json",)) -> None:
    there = contents(url)
    del there[FINISHED]
    here = local_contents(folder)
    assert set(there) == set(here)
    assert {name for name in here if here[name] != there[name]} <= set(varies)


def _environment(cache: Path) -> dict[str, str]:
    return {**os.environ, "PRBENCH_CACHE": str(cache), "PRBENCH_UPLOAD_SECONDS": "0.2"}


def _resume(arguments: list[str], cache: Path) -> str:
    """Run the same command from a machine that has nothing of it, and return what it says."""
    process = subprocess.run(
        [sys.executable, "-m", "prbench", *arguments, "--json"],
        env=_environment(cache),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert process.returncode == 0, process.stdout
    return process.stdout


_KILLED = """
import os, signal, sys, time
from prbench.cli.main import main
from prbench.engine import InProcess
from prbench.object_stores.store import UNFINISHED
from prbench.object_stores.store import Store

begin, write, wanted = InProcess.map, Store.write, sys.argv[1].encode()

def two_items(self, *work, **options):
    for done, answer in enumerate(begin(self, *work, **options), start=1):
        yield answer
        if done == 2:
            time.sleep(60)

def killed_once_written(self, name, content):
    write(self, name, content)
    if name == UNFINISHED and b'"' + wanted in content.partition(b'"files"')[2]:
        os.kill(os.getpid(), signal.SIGKILL)

InProcess.map, Store.write = two_items, killed_once_written
sys.exit(main(sys.argv[2:]))
"""
"""A command that works on two items, waits, and is killed when a file whose name begins so has been uploaded."""


def _kill_once_it_has_uploaded(wanted: str, arguments: list[str], cache: Path) -> None:
    process = subprocess.run(
        [sys.executable, "-c", _KILLED, wanted, *arguments], env=_environment(cache), capture_output=True, text=True
    )
    assert process.returncode == -signal.SIGKILL, process.stderr


@pytest.mark.slow
def test_a_build_that_was_killed_goes_on_from_an_empty_cache(bucket, tmp_path):
    recordings = tmp_path / "adt"
    assert main(["synthesize", "adt", "--count", "4", "--events", "2", "--out", str(recordings)]) == 0
    put_folder(recordings, f"{bucket}/adt")
    assert main(["build-dataset", "adt", "--root", str(recordings), "--out", str(tmp_path / "whole")]) == 0
    arguments = ["build-dataset", "adt", "--root", f"{bucket}/adt", "--out", f"{bucket}/table"]
    _kill_once_it_has_uploaded(WORK_PREFIX, arguments, tmp_path / "first")
    assert FINISHED not in contents(f"{bucket}/table")
    said = _resume(arguments, tmp_path / "second")
    assert "going on with what an interrupted command has uploaded" in said
    assert "recordings were taken over from an interrupted build" in said
    _require_equal(f"{bucket}/table", tmp_path / "whole", varies=())
    assert not [name for name in contents(f"{bucket}/table") if name.startswith(OWN_PREFIX)]


@pytest.mark.slow
def test_a_run_that_was_killed_goes_on_from_an_empty_cache(bucket, tmp_path):
    fake_dataset(tmp_path / "table", 60)
    given = [*RUN, "--split", "train", "--batch-size", "1", "--data", str(tmp_path / "table"), "--out"]
    arguments = [*given, f"{bucket}/run"]
    _kill_once_it_has_uploaded("synthetic-adt/predictions/", arguments, tmp_path / "first")
    said = _resume(arguments, tmp_path / "second")
    assert '"batches_found": 0' not in said
    assert main([*given, str(tmp_path / "whole")]) == 0
    _require_equal(f"{bucket}/run", tmp_path / "whole")


@pytest.mark.slow
def test_a_store_that_is_stopped_while_a_command_works_and_comes_back(tmp_path, monkeypatch, capsys):
    pytest.importorskip("s3fs")
    pytest.importorskip("moto")
    served = start_moto()
    bucket = use_server(served, monkeypatch)
    fake_dataset(tmp_path / "table", 20)
    arguments = [*RUN, "--batch-size", "1", "--data", str(tmp_path / "table"), "--out", f"{bucket}/run"]
    run_batch = running.run_batch

    def stopping(task):
        served.stop()
        return run_batch(task)

    with monkeypatch.context() as patched:
        patched.setattr(running, "run_batch", stopping)
        assert main(arguments) == 8
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert f"{bucket}/run" in line
    assert "the same command uploads it" in line
    use_server(start_moto(), monkeypatch)
    assert main(arguments) == 0
    assert FINISHED in contents(f"{bucket}/run")
