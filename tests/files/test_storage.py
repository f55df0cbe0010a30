"""Files are written whole or not at all, by one process at a time."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from prbench.board.comparison import compare_runs
from prbench.checking.examine_file import DoctorRequest
from prbench.checking.inspection import inspect_folder
from prbench.contract import Condition
from prbench.curation import build_dataset, plan_build
from prbench.curation.build import build_all
from prbench.curation.differences import compare_builds
from prbench.datasets import readable_datasets
from prbench.errors import InputFileError, PrbenchError, StorageError
from prbench.files.storage import (
    atomic_folder,
    atomic_path,
    file_digest,
    in_turn,
    inside,
    lock_file,
    read_json,
    remove_folder,
    remove_leftovers,
    sole_file,
    sole_writer,
    text_digest,
    turn_into_paths,
    write_json,
)
from prbench.harness.offline import ExportRequest
from prbench.harness.request import RunRequest
from prbench.harness.run_folder.folder import RunFolder
from prbench.harness.run_folder.predictions import Predictions
from prbench.harness.score_predictions import ScoreRequest
from prbench.readers import reader_for
from prbench.release.exporting import export_release
from prbench.release.importing import import_release
from prbench.sequences import CorpusInfo, CorpusTable, DatasetInfo, SequenceTable
from prbench.viewing.explain import explain_event
from prbench.viewing.view import ViewRequest
from prbench_adapters.corpora.build import build_corpus, plan_corpus
from prbench_benchmarks.motion_prediction.anchored import build_anchored_windows
from prbench_benchmarks.motion_prediction.table import WindowsTable
from prbench_benchmarks.motion_prediction.windows import plan_windows


def write_half(path):
    with atomic_path(path) as temporary:
        temporary.write_text("half")
        raise RuntimeError("killed here")


def fill_half(folder):
    with atomic_folder(folder) as temporary:
        (temporary / "two").write_text("2")
        raise RuntimeError("killed here")


def test_a_failed_write_leaves_the_old_file_and_no_trace(tmp_path):
    path = tmp_path / "a.json"
    write_json(path, {"old": 1})
    with pytest.raises(RuntimeError):
        write_half(path)
    assert json.loads(path.read_text()) == {"old": 1}
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.json"]


def test_a_full_disk_is_one_clear_error(tmp_path):
    with pytest.raises(StorageError, match=r"a\.parquet: no space left"), atomic_path(tmp_path / "a.parquet"):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (OSError(errno.EFBIG, "File too large"), "larger than a file may be here"),
        (OSError(errno.EDQUOT, "Disk quota exceeded"), "the disk quota is used up"),
        (OSError(errno.EROFS, "Read-only file system"), "cannot be written"),
        (OSError("7854 requested and 2016 written"), "no more could be written"),
    ],
)
def test_a_file_that_may_not_grow_is_one_clear_error(error, said, tmp_path):
    with pytest.raises(StorageError, match=rf"a\.parquet: {said}"), atomic_path(tmp_path / "a.parquet"):
        raise error
    assert list(tmp_path.iterdir()) == []


def test_an_unwritable_place_is_one_clear_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="Choose another folder"), atomic_path(tmp_path / "file" / "x.json"):
        pass


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="needs a place where no folder can be made")
def test_a_place_where_nothing_can_be_made_is_one_clear_error():
    with pytest.raises(StorageError, match="Choose another folder"), atomic_path(Path("/proc/nope/x.json")):
        pass


def test_a_folder_takes_the_place_of_the_old_one_only_when_complete(tmp_path):
    folder = tmp_path / "d"
    with atomic_folder(folder) as temporary:
        (temporary / "one").write_text("1")
    with pytest.raises(RuntimeError):
        fill_half(folder)
    assert [entry.name for entry in folder.iterdir()] == ["one"]
    with atomic_folder(folder) as temporary:
        (temporary / "three").write_text("3")
    assert [entry.name for entry in folder.iterdir()] == ["three"]
    assert [entry.name for entry in tmp_path.iterdir()] == ["d"]


def _killed(target, name: str, *, moment: str) -> None:
    """Write in a process of its own that dies at a moment, as ``kill -9`` would have it."""
    script = (
        "import os, pathlib\n"
        "from prbench.files import storage\n"
        f"target = pathlib.Path({str(target)!r})\n"
        f"with storage.{name}(target) as temporary:\n"
        "    (temporary / 'new' if temporary.is_dir() else temporary).write_text('new')\n"
        "    if " + repr(moment) + " == 'between':\n"
        "        (target).replace(temporary.with_suffix('.replaced'))\n"
        "    os._exit(9)\n"
    )
    assert subprocess.run([sys.executable, "-c", script], cwd=Path(__file__).parents[2]).returncode == 9


def test_leftovers_of_a_killed_writer_are_cleared_and_only_those(tmp_path):
    neighbour = tmp_path / ".d-wrist-abcdefgh.partial"  # somebody writes a folder d-wrist right now
    neighbour.mkdir()
    _killed(tmp_path / "d", "atomic_folder", moment="while writing")
    _killed(tmp_path / "scores.parquet", "atomic_path", moment="while writing")
    assert len(list(tmp_path.iterdir())) == 3
    remove_leftovers(tmp_path / "d")
    remove_leftovers(tmp_path / "scores.parquet")
    assert list(tmp_path.iterdir()) == [neighbour]


def test_a_folder_that_was_about_to_be_replaced_gets_its_name_back(tmp_path):
    folder = tmp_path / "tables.v1"
    folder.mkdir()
    (folder / "old").write_text("old")
    _killed(folder, "atomic_folder", moment="between")
    assert not folder.exists()
    remove_leftovers(folder)
    assert [entry.name for entry in tmp_path.iterdir()] == ["tables.v1"]
    assert [entry.name for entry in folder.iterdir()] == ["old"]


def test_a_folder_that_was_replaced_and_half_deleted_never_comes_back(tmp_path):
    folder = tmp_path / "table"
    folder.mkdir()
    script = (
        "import os, shutil\n"
        "from pathlib import Path\n"
        "from prbench.files.storage import atomic_folder\n"
        "shutil.rmtree = lambda *_, **__: os._exit(9)\n"
        f"with atomic_folder(Path({str(folder)!r})):\n"
        "    pass\n"
    )
    assert subprocess.run([sys.executable, "-c", script], cwd=Path(__file__).parents[2]).returncode == 9
    assert len(list(tmp_path.iterdir())) == 2
    folder.rmdir()
    remove_leftovers(folder)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_is_deleted_whole_or_found_whole(tmp_path):
    folder = tmp_path / ".tables.work"
    (folder / "one").mkdir(parents=True)
    (folder / "one" / "file").write_text("1")
    script = (
        "import os, shutil\n"
        "from pathlib import Path\n"
        "from prbench.files.storage import remove_folder\n"
        "shutil.rmtree = lambda *_, **__: os._exit(9)\n"
        f"remove_folder(Path({str(folder)!r}))\n"
    )
    assert subprocess.run([sys.executable, "-c", script], cwd=Path(__file__).parents[2]).returncode == 9
    assert not folder.exists()
    assert len(list(tmp_path.iterdir())) == 1
    remove_leftovers(folder)
    assert list(tmp_path.iterdir()) == []


def test_deleting_a_folder_leaves_nothing(tmp_path):
    (tmp_path / "work" / "part").mkdir(parents=True)
    remove_folder(tmp_path / "work")
    remove_folder(tmp_path / "work")  # none there
    assert list(tmp_path.iterdir()) == []


def test_equal_values_give_equal_json_bytes(tmp_path):
    write_json(tmp_path / "a.json", {"x": 1, "a": [1.5, "é"]})
    write_json(tmp_path / "b.json", {"a": [1.5, "é"], "x": 1})
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()
    assert file_digest(tmp_path / "a.json") == file_digest(tmp_path / "b.json")


def test_nan_never_reaches_json(tmp_path):
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(tmp_path / "a.json", {"x": float("nan")})
    assert list(tmp_path.iterdir()) == []


def test_a_truncated_json_names_line_and_remedy(tmp_path):
    path = tmp_path / "a.json"
    path.write_text('{"x": 1,\n "y"')
    with pytest.raises(InputFileError, match=r"a\.json, line 2 column \d+: expected valid JSON.*truncated"):
        read_json(path)


def test_paths_never_lead_out_of_their_root(tmp_path):
    assert inside(tmp_path, "a/b") == (tmp_path / "a" / "b").resolve()
    for wrong in ("../x", "/etc/passwd", "a/../../x"):
        with pytest.raises(InputFileError, match="leads out of it"):
            inside(tmp_path, wrong)


def test_text_digest_keeps_borders():
    assert text_digest("ab", "c") != text_digest("a", "bc")


NOWHERE = "nowhere/at all"

CALLS = {
    "build_dataset": lambda out: build_dataset("adt", NOWHERE, out),
    "plan_build": lambda _: plan_build("adt", NOWHERE),
    "build_corpus": lambda out: build_corpus("nymeria", NOWHERE, out),
    "plan_windows": lambda _: plan_windows("adt", NOWHERE),
    "build_anchored_windows": lambda out: build_anchored_windows(NOWHERE, out),
    "WindowsTable": lambda _: WindowsTable.open(NOWHERE),
    "plan_corpus": lambda _: plan_corpus("nymeria", NOWHERE),
    "build_all": lambda out: build_all(NOWHERE, out),
    "inspect_folder": lambda _: inspect_folder(NOWHERE),
    "import_release": lambda out: import_release(NOWHERE, out),
    "export_release": lambda out: export_release([NOWHERE], out),
    "compare_builds": lambda _: compare_builds(NOWHERE, NOWHERE),
    "compare_runs": lambda _: compare_runs(NOWHERE, NOWHERE),
    "explain_event": lambda _: explain_event(NOWHERE, "pick"),
    "SequenceTable": lambda _: SequenceTable.open(NOWHERE),
    "CorpusTable": lambda _: CorpusTable.open(NOWHERE),
    "DatasetInfo": lambda _: DatasetInfo.read(NOWHERE),
    "CorpusInfo": lambda _: CorpusInfo.read(NOWHERE),
    "RunFolder": lambda _: RunFolder.open(NOWHERE),
    "Predictions": lambda _: Predictions.open(NOWHERE),
    **{f"reader of {name}": lambda _, name=name: reader_for(name).find(NOWHERE) for name in readable_datasets()},
}


@pytest.mark.parametrize("name", CALLS)
def test_a_folder_that_is_missing_is_told_the_same_when_it_is_text(name, tmp_path) -> None:
    with pytest.raises(PrbenchError, match="nowhere"):
        CALLS[name](str(tmp_path / "out"))


@pytest.mark.unchecked_shapes  # fields are annotated as what they hold afterwards
def test_requests_hold_paths_whatever_they_were_given() -> None:
    tables: Any = ("tables/adt", Path("tables/gimo"))
    run: Any = "r"
    file: Any = "p.npz"
    paths = (Path("tables/adt"), Path("tables/gimo"))
    assert RunRequest(method="static", data=tables, out=run).data == paths
    assert ExportRequest(data=tables, condition=Condition.TEXT, out=file).out == Path("p.npz")
    assert ScoreRequest(predictions=file, data=tables).predictions == Path("p.npz")
    assert ViewRequest(out=file, data=tables).data == paths
    assert DoctorRequest(path=file, data=tables).data == paths


def test_what_is_none_stays_none() -> None:
    @dataclass(frozen=True)
    class Request:
        one: Path | str | None = None

        def __post_init__(self) -> None:
            turn_into_paths(self, "one")

    assert Request().one is None
    assert Request("a").one == Path("a")


def _made(temporary, receipt):
    (temporary / "receipt").write_text(receipt)
    (temporary / "rows").write_text(receipt)


def test_a_folder_that_another_machine_has_made_meanwhile_stays(tmp_path):
    folder = tmp_path / "part"
    with atomic_folder(folder, told_by="receipt") as slower:
        _made(slower, "same")
        with atomic_folder(folder, told_by="receipt") as faster:
            _made(faster, "same")
        first = folder.stat().st_ino
    assert folder.stat().st_ino == first
    assert [entry.name for entry in tmp_path.iterdir()] == ["part"]


def test_a_folder_that_another_machine_has_made_at_the_very_same_moment_stays(tmp_path, monkeypatch):
    folder = tmp_path / "part"
    exists = Path.exists

    def made_after_the_look(path):
        found = exists(path)
        if path == folder and not found:
            folder.mkdir()
            _made(folder, "same")
        return found

    with atomic_folder(folder, told_by="receipt") as slower:
        _made(slower, "same")
        monkeypatch.setattr(Path, "exists", made_after_the_look)
    assert [entry.name for entry in tmp_path.iterdir()] == ["part"]


def test_a_folder_with_another_receipt_is_replaced(tmp_path):
    folder = tmp_path / "part"
    for receipt in ("failed", "read"):
        with atomic_folder(folder, told_by="receipt") as temporary:
            _made(temporary, receipt)
    assert (folder / "rows").read_text() == "read"
    assert [entry.name for entry in tmp_path.iterdir()] == ["part"]


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
