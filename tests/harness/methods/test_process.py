"""Programs start and end: nothing is inherited or held up, and nothing stays behind, whoever dies first."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_info

from prbench.errors import AdapterError
from prbench.harness.methods import process
from prbench.harness.methods.process import python_words
from tests.harness.methods.made_programs import MARK, Workshop, standard_batch, standing_motions, started

BATCH = standard_batch()
POSIX = pytest.mark.skipif(sys.platform == "win32", reason="signals and process groups of POSIX")


@POSIX
@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"words": ("no-such-python", "made.py")}, "expected the command 'no-such-python', found none on PATH"),
        ({"directory": Path("/gone")}, "expected the folder /gone to start in, found none"),
        ({"words": ("made.py",)}, r"made.py' may not be executed. Make it executable, or name its interpreter"),
    ],
)
def test_what_cannot_be_started_is_named(changes: dict[str, Any], told: str, workshop: Workshop) -> None:
    program = workshop.program("")
    if changes.get("words") == ("made.py",):
        changes = {"words": (str(workshop.folder / "made.py"),)}
    with pytest.raises(AdapterError, match=told):
        started(replace(program, **changes))


@pytest.mark.skipif(not Path("/dev/fd").is_dir(), reason="needs /dev/fd to list open files")
def test_a_program_inherits_its_three_pipes_and_its_environment_and_nothing_else(workshop: Workshop) -> None:
    source = """
        before = os.open(os.devnull, os.O_RDONLY)  # the lowest number that is free; GOOD is closed by now
        hello(version=json.dumps([before, sorted(os.environ)]))
        read()
    """
    with open(workshop.folder / "table.parquet", "wb") as table:
        os.set_inheritable(table.fileno(), True)
        lowest_free, variables = json.loads(workshop.start(source).version)
    assert lowest_free == 3
    assert set(variables) - {"LC_CTYPE"} == {"PATH", MARK}  # Python itself sets the former


def test_only_the_newest_logs_are_kept(workshop: Workshop, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process, "_KEPT_LOGS", 2)
    folder = workshop.cache / "logs"
    folder.mkdir(parents=True)
    for age in range(4):
        (folder / f"old-{age}.log").touch()
        os.utime(folder / f"old-{age}.log", (0, 1000 - age))
    workshop.start("print('hello', file=sys.stderr, flush=True); hello(); read()").close()
    names = sorted(path.name for path in folder.iterdir())
    assert [name[:8] for name in names] == ["cmd-made", "old-0.lo", "old-1.lo"]


def test_a_program_without_a_log_leaves_no_file(workshop: Workshop) -> None:
    workshop.start("hello(); read()").close()
    assert not (workshop.cache / "logs").exists()


def test_an_answer_may_come_before_the_request_was_read(workshop: Workshop) -> None:
    source = """
        hello()
        header = json.loads(stdin.readline())
        motions(header)
        time.sleep(0.2)
        stdin.read(header["bytes"])
        motions(read()[0])
        read()
    """
    adapter = workshop.start(source)
    for _ in range(2):
        np.testing.assert_array_equal(adapter.generate(BATCH, seed=0).ragged(), standing_motions(BATCH).ragged())


def test_what_is_sent_unasked_is_not_piled_up_in_memory(workshop: Workshop) -> None:
    source = """
        hello()
        motions(read()[0])
        for _ in range(40):
            stdout.write(b"x" * 100_000)
            stdout.flush()
            open("written", "ab").write(b"x")
    """
    adapter = workshop.start(source)
    adapter.generate(BATCH, seed=0)
    time.sleep(0.4)
    assert (workshop.folder / "written").stat().st_size < 30, "4 MB were sent, about 1 MB is taken in"
    with pytest.raises(AdapterError, match="without being asked, behind its last answer: 'xxx"):
        adapter.generate(BATCH, seed=0)


@POSIX
@pytest.mark.parametrize("ending", ["time-out", "closing"])
def test_a_program_that_ignores_sigterm_is_killed(ending: str, workshop: Workshop) -> None:
    source = "import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN); hello(); time.sleep(60)"
    adapter = workshop.start(source, batch_timeout=0.2)
    begun = time.monotonic()
    if ending == "closing":
        adapter.close()
    else:
        with pytest.raises(AdapterError, match="did not answer"):
            adapter.generate(BATCH, seed=0)
    assert time.monotonic() - begun < 3
    assert not workshop.left_behind()


CHILD = "subprocess.Popen([sys.executable, '-S', '-c', 'import time; time.sleep(60)'])"


@pytest.mark.parametrize(
    ("source", "says"),
    [
        (f"{CHILD}; hello(); read(); time.sleep(60)", "did not answer within 1 s"),
        (f"{CHILD}; hello(); read(); os._exit(3)", "ended with exit status 3"),
        (f"{CHILD}; hello(); motions(read()[0]); read(); os._exit(0)", None),
    ],
    ids=["waits", "crashes", "ends well"],
)
def test_children_that_hold_the_pipes_open_end_with_their_program(
    source: str, says: str | None, workshop: Workshop
) -> None:
    if sys.platform == "win32" and "_exit" in source:
        pytest.skip("Windows does not tell whose child it was once the program is gone")
    adapter = workshop.start(source, batch_timeout=1.0)
    if says is None:
        adapter.generate(BATCH, seed=0)
        adapter.close()
    else:
        with pytest.raises(AdapterError, match=says):
            adapter.generate(BATCH, seed=0)
    assert not workshop.left_behind()


@POSIX
def test_a_child_in_a_session_of_its_own_ends_with_its_program(workshop: Workshop) -> None:
    adapter = workshop.start(CHILD.replace("])", "], start_new_session=True)") + "; hello(); read()")
    adapter.close()
    assert not workshop.left_behind()


HARNESS = """
import sys, os, signal, time
from pathlib import Path
from tests.harness.methods.made_programs import Workshop, started, standard_batch
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it
workshop = Workshop(Path(sys.argv[1]), sys.argv[2])
adapter = started(workshop.program(sys.argv[3]))
print("ready", flush=True)
{then}
"""


@pytest.fixture
def harness(workshop: Workshop) -> Callable[[str, str], subprocess.Popen[str]]:
    """Another process that starts a program, says that it is ready, and then does something."""

    def _start(source: str, then: str) -> subprocess.Popen[str]:
        words = [sys.executable, "-c", HARNESS.format(then=then), str(workshop.folder), workshop.mark, source]
        popen = subprocess.Popen(
            words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
        )
        assert popen.stdout is not None
        assert popen.stdout.readline() == "ready\n"
        return popen

    return _start


WAITS = """
hello()
import atexit
atexit.register(lambda: open("ended", "w").close())
read()
read()
"""


def _gone(workshop: Workshop, seconds: float = 5.0) -> bool:
    until = time.monotonic() + seconds
    while workshop.left_behind() and time.monotonic() < until:
        time.sleep(0.02)
    return not workshop.left_behind()


@pytest.mark.parametrize("then", ["", "sys.exit(1)", "raise KeyError"], ids=["returns", "exits", "raises"])
def test_a_harness_that_ends_without_closing_ends_its_program_well(
    then: str, workshop: Workshop, harness: Callable[[str, str], subprocess.Popen[str]]
) -> None:
    harness(WAITS, then).communicate(timeout=20)
    assert (workshop.folder / "ended").exists()
    assert not workshop.left_behind()


@POSIX
def test_a_harness_that_is_killed_takes_its_program_along(
    workshop: Workshop, harness: Callable[[str, str], subprocess.Popen[str]]
) -> None:
    popen = harness(WAITS, "time.sleep(60)")
    popen.kill()
    popen.communicate()
    assert _gone(workshop)
    assert (workshop.folder / "ended").exists(), "it saw the end of its stdin"


@POSIX
def test_ctrl_c_is_for_the_harness_which_then_ends_its_program(
    workshop: Workshop, harness: Callable[[str, str], subprocess.Popen[str]]
) -> None:
    source = "hello(); read(); open('asked', 'w').close(); time.sleep(60)"
    popen = harness(source, "adapter.generate(standard_batch(), seed=0)")
    until = time.monotonic() + 10
    while not (workshop.folder / "asked").exists() and time.monotonic() < until:
        time.sleep(0.02)
    os.killpg(popen.pid, signal.SIGINT)  # what a terminal does: to all of its foreground group
    _, errors = popen.communicate(timeout=20)
    assert errors.rstrip().endswith("KeyboardInterrupt")
    assert "made.py" not in errors
    assert not workshop.left_behind()
    assert not (workshop.cache / "logs").exists(), "the program was not interrupted: its log is empty"


_DUMPS = "import json, os, sys; json.dump(dict(os.environ), open(sys.argv[1], 'w')); sys.exit(3)"
_ADDED_BY_INTERPRETERS = {"LC_CTYPE", "__CF_USER_TEXT_ENCODING"}


def prbench(*words: str, environment: dict[str, str], folder: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "prbench", *words]
    return subprocess.run(command, env=environment, cwd=folder, capture_output=True, text=True, timeout=100)


@pytest.fixture
def mine(tmp_path: Path) -> dict[str, str]:
    """The environment of a user who has set nothing for Python, but a variable of their own and one of prbench's."""
    kept = {name: os.environ[name] for name in ("PATH", "HOME", "SYSTEMROOT", "TEMP", "TMP") if name in os.environ}
    return kept | {"MY_BODY_MODELS": "/models", "PRBENCH_CACHE": str(tmp_path / "cache")}


@pytest.mark.parametrize("command", ["check", "run"])
def test_a_program_gets_the_users_variables_and_no_others(command, mine, tmp_path, table):
    (tmp_path / "dumps.py").write_text(_DUMPS)
    method = f'cmd:"{sys.executable}" dumps.py seen.json'
    words = ["adapters", "check", method]
    if command == "run":
        words = ["run", "--method", method, "--condition", "none", "--out", "run"]
    words += ["--data", str(table.folder)]
    done = prbench(*words, environment=mine, folder=tmp_path)
    assert "exit status 3" in done.stdout + done.stderr
    seen = json.loads((tmp_path / "seen.json").read_text())
    expected = {name: value for name, value in mine.items() if not name.startswith("PRBENCH_")}
    assert {name: value for name, value in seen.items() if name not in _ADDED_BY_INTERPRETERS} == expected


def test_a_module_started_apart_finds_what_this_process_finds(tmp_path, monkeypatch):
    (tmp_path / "only_here.py").write_text(
        "import os, sys; print(sys.argv[1], sys.path[0], 'PYTHONPATH' in os.environ, __name__,"
        " os.path.basename(sys.argv[0]))"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend("")
    monkeypatch.delenv("PYTHONPATH", raising=False)
    words = python_words("only_here", "word")
    # A relative entry of sys.path means the folder in which this process stood; nothing of another folder is imported.
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere/json.py").write_text("raise SystemExit('not the library')")
    monkeypatch.chdir(tmp_path / "elsewhere")
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["word", str(tmp_path), "False", "__main__", "only_here.py"]


_ASKS = """
import os
from prbench.harness.methods.process import computing_threads, users_environment
with computing_threads(1):
    print(os.environ["KMP_DUPLICATE_LIB_OK"], users_environment().get("KMP_DUPLICATE_LIB_OK"))
"""


@pytest.mark.parametrize(("set_by_the_user", "seen"), [({}, "True None"), ({"KMP_DUPLICATE_LIB_OK": "0"}, "0 0")])
def test_a_variable_that_a_library_sets_is_not_the_users_unless_they_set_it(set_by_the_user, seen, mine):
    environment = {**mine, **set_by_the_user}
    done = subprocess.run([sys.executable, "-c", _ASKS], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == seen


def test_numerical_libraries_compute_with_the_threads_that_were_asked_for(monkeypatch):
    torch = pytest.importorskip("torch")
    asked: list[int] = []
    monkeypatch.setattr(torch, "get_num_threads", lambda: 7)
    monkeypatch.setattr(torch, "set_num_threads", asked.append)
    for threads in (2, 1):
        with process.computing_threads(threads):
            assert {library["num_threads"] for library in threadpool_info()} == {threads}
    assert asked == [2, 1]
