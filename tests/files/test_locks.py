"""One process at a time writes a result."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from prbench.errors import StorageError
from prbench.files.storage import in_turn, lock_file, sole_file, sole_writer

ROOT = Path(__file__).parents[1]
HOLD = """
import sys
from pathlib import Path
from prbench.files.storage import sole_writer
with sole_writer(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.readline()
"""


@contextlib.contextmanager
def holder(path: Path) -> Iterator[subprocess.Popen]:
    """Another process that holds a result."""
    command = [sys.executable, "-c", HOLD, str(path)]
    with subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        try:
            yield process
        finally:
            process.kill()


def test_the_second_process_is_told_who_holds_the_result_and_leaves_nothing(tmp_path: Path) -> None:
    with holder(tmp_path / "adt") as process:
        before = sorted(tmp_path.iterdir())
        owner = f"process {process.pid} on {socket.gethostname()} is writing there"
        for _ in range(2):  # the first one does not wipe out the name
            with pytest.raises(StorageError, match=owner), sole_writer(tmp_path / "adt"):
                pass
        assert sorted(tmp_path.iterdir()) == before == [lock_file(tmp_path / "adt")]


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs POSIX signals")
def test_a_killed_owner_holds_nobody_up_and_its_leftovers_go(tmp_path: Path) -> None:
    with holder(tmp_path / "adt") as process:
        (tmp_path / ".adt-abcd1234.partial").mkdir()
        process.kill()
        process.wait()
        assert lock_file(tmp_path / "adt").exists()
        with sole_writer(tmp_path / "adt"):
            pass
    assert not list(tmp_path.iterdir())


def test_who_waits_says_for_whom_and_goes_on_when_the_other_is_through(tmp_path: Path) -> None:
    said: list[str] = []
    with holder(tmp_path / "adt") as process:

        def let_go_when_told() -> None:
            while not said:
                time.sleep(0.01)
            process.communicate("\n")

        other = threading.Thread(target=let_go_when_told)
        other.start()
        with in_turn(tmp_path / "adt", said.append):
            assert process.poll() == 0 or not process.wait(5)
        other.join()
    assert len(said) == 1
    assert said[0].endswith(f"waiting until process {process.pid} on {socket.gethostname()} has written it.")


def test_folders_made_for_a_lock_go_with_it_unless_something_was_written(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError), sole_writer(tmp_path / "a/b/adt"):
        raise RuntimeError
    assert not list(tmp_path.iterdir())
    with sole_file(tmp_path / "a/b/c.txt") as temporary:
        temporary.write_text("x")
    assert [path.name for path in (tmp_path / "a/b").iterdir()] == ["c.txt"]


def test_where_no_file_can_stand_beside_the_result_the_lock_is_in_the_cache(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))
    lock_file(tmp_path / "adt").mkdir()  # in its way
    with holder(tmp_path / "adt") as process:
        message = f"process {process.pid} on"
        with pytest.raises(StorageError, match=message), sole_writer(tmp_path / "adt"):
            pass


def test_without_any_place_for_a_lock_the_work_is_done_without(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv("PRBENCH_CACHE", os.devnull)
    lock_file(tmp_path / "adt").mkdir()
    with sole_writer(tmp_path / "adt"):
        (tmp_path / "adt").touch()


def test_two_drawings_of_one_name_and_two_kinds_do_not_disturb_each_other(tmp_path: Path) -> None:
    with sole_file(tmp_path / "figure.png") as picture, sole_file(tmp_path / "figure.svg") as vector:
        picture.write_text("png")
        vector.write_text("svg")
    assert (tmp_path / "figure.png").read_text() == "png"


def test_a_name_in_a_lock_file_cannot_steer_the_terminal(tmp_path: Path) -> None:
    with holder(tmp_path / "adt"):
        lock_file(tmp_path / "adt").write_bytes(b"\0" + b"7 \x1b[31mevil\n")
        with pytest.raises(StorageError) as refused, sole_writer(tmp_path / "adt"):
            pass
    assert "\x1b" not in str(refused.value)
