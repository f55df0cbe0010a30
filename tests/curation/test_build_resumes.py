"""A build that is killed goes on where it stopped and gives the same bytes."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from prbench.curation import build_from_sources
from prbench.sequences.parts import work_folder
from tests.curation.sources import SceneSource, folder_bytes, some_sources

ROOT = Path(__file__).parents[2]


def start(out: Path, workers: int = 1) -> subprocess.Popen:
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "tests.curation.sources", str(out), str(workers)]
    return subprocess.Popen(command, cwd=ROOT, env=environment)


def finished_parts(out: Path) -> int:
    work = work_folder(out)
    return len([path for path in work.iterdir() if not path.name.startswith(".")]) if work.is_dir() else 0


def kill_after(process: subprocess.Popen, out: Path, parts: int, delay: float) -> None:
    """Kill a build some time after it has finished so many parts."""
    while process.poll() is None and finished_parts(out) < parts:
        time.sleep(0.002)
    time.sleep(delay)
    process.send_signal(signal.SIGKILL)
    process.wait()


def test_killed_while_its_parts_are_removed_it_builds_again_with_the_same_bytes(tmp_path: Path, monkeypatch) -> None:
    out = tmp_path / "adt"
    with monkeypatch.context() as patch:
        patch.setattr(shutil, "rmtree", remove_tables_and_die)
        with pytest.raises(Interrupted):
            build_from_sources(some_sources(3), out)
    assert len(list(tmp_path.rglob("receipt.json"))) == 3  # halves that look finished
    finished = folder_bytes(out)
    assert build_from_sources(some_sources(3), out).reused == 0
    assert folder_bytes(out) == finished
    assert list(tmp_path.iterdir()) == [out]


def remove_tables_and_die(folder: Path, ignore_errors: bool = False) -> None:
    """Stands for a kill between the first files that ``rmtree`` deletes and the others."""
    tables = list(folder.rglob("*.arrow"))
    for table in tables:
        table.unlink()
    if tables:
        raise Interrupted


def test_killed_with_workers_it_leaves_none_of_them_at_work(tmp_path: Path) -> None:
    out = tmp_path / "adt"
    kill_after(start(out, workers=2), out, parts=2, delay=0.0)
    time.sleep(0.5)
    left = finished_parts(out)
    time.sleep(0.5)
    assert 2 <= finished_parts(out) == left < 8
    assert start(out, workers=2).wait() == 0
    build_from_sources(some_sources(8), tmp_path / "undisturbed")
    assert folder_bytes(out) == folder_bytes(tmp_path / "undisturbed")


class Interrupted(Exception):
    """Stands for a kill between two recordings."""


def interrupt_after(parts: int):
    def progress(done, total, last) -> None:
        if done == parts:
            raise Interrupted

    return progress


def interrupted_build(out: Path, sources: list[SceneSource], parts: int) -> None:
    try:
        build_from_sources(sources, out, progress=interrupt_after(parts))
    except Interrupted:
        return
    raise AssertionError("the build was not interrupted")


def test_only_what_is_missing_or_changed_is_curated_again(tmp_path: Path) -> None:
    interrupted_build(tmp_path / "whole", some_sources(5), 3)
    assert build_from_sources(some_sources(5), tmp_path / "whole").reused == 3
    interrupted_build(tmp_path / "adt", some_sources(5), 3)
    changed = some_sources(5)
    changed[1] = SceneSource("room_1", version=7)
    report = build_from_sources(changed, tmp_path / "adt")
    assert report.reused == 2
    build_from_sources(changed, tmp_path / "afresh")
    assert folder_bytes(tmp_path / "adt") == folder_bytes(tmp_path / "afresh")


def test_half_written_folders_of_this_dataset_are_removed_and_of_others_kept(tmp_path: Path) -> None:
    kept = [tmp_path / ".adt-2-abcdefgh.partial", tmp_path / ".adtx-abcdefgh.partial", tmp_path / "adt-2"]
    removed = tmp_path / ".adt-abcd_123.partial"
    for folder in (*kept, removed):
        folder.mkdir()
    build_from_sources(some_sources(1), tmp_path / "adt")
    assert not removed.exists()
    assert all(folder.exists() for folder in kept)


def test_a_failed_recording_is_tried_again(tmp_path: Path) -> None:
    broken = [SceneSource("a", problem="file"), SceneSource("b")]
    interrupted_build(tmp_path / "adt", broken, 1)
    assert build_from_sources(broken, tmp_path / "adt").reused == 0
