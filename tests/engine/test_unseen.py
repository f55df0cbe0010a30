"""A hidden process tells other processes of its user nothing; the tests ask as a user without privileges."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="/proc is Linux's")

AS_NOBODY = """
import ctypes, os, sys
from pathlib import Path
from prbench.engine.unseen import hide_process, is_hidden, start_bare_tracker

if os.geteuid() == 0:  # root reads everything
    os.setgid(65534)
    os.setuid(65534)
    ctypes.CDLL(None).prctl(4, 1, 0, 0, 0)  # a change of user hides a process, too
"""
HELD = AS_NOBODY + "if sys.argv[1] == 'hidden': hide_process()\nprint(is_hidden(), flush=True)\nsys.stdin.read()"
LOOK = """
place = Path("/proc", sys.argv[1])
looks = {
    "cmdline": lambda: b"secret" in (place / "cmdline").read_bytes(),
    "environ": lambda: b"secret" in (place / "environ").read_bytes(),
    "cwd": (place / "cwd").readlink,
    "fd": (place / "fd" / "0").readlink,
    "maps": (place / "maps").read_bytes,
    "mem": lambda: (place / "mem").open("rb"),
}
for name, look in looks.items():
    try:
        print(name if look() else "")
    except OSError:
        pass
"""


def seen_of(*words: str) -> set[str]:
    """What a stranger of the same user learns of a process that was called with these words."""
    environment = {**os.environ, "TABLE": "/secret"}
    command = [sys.executable, "-c", HELD, *words]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment, text=True) as held:
        assert held.stdout is not None
        assert held.stdout.readline().strip() == str(words[0] == "hidden")
        look = [sys.executable, "-c", AS_NOBODY + LOOK, str(held.pid)]
        found = subprocess.run(look, capture_output=True, text=True, check=True).stdout
        shown = subprocess.run(["ps", "-ww", "-o", "args=", "-p", str(held.pid)], capture_output=True, text=True).stdout
        assert ("secret" in shown) == ("cmdline" in found)
        held.kill()
    return set(found.split())


def test_a_hidden_process_tells_nothing_that_others_tell():
    assert seen_of("plain", "--data", "/secret") == {"cmdline", "environ", "cwd", "fd", "maps", "mem"}
    assert seen_of("hidden", "--data", "/secret") == set()


def test_the_helper_process_of_multiprocessing_starts_bare_and_the_caller_keeps_everything(tmp_path):
    code = """
import os, time
from multiprocessing import resource_tracker
from pathlib import Path
from prbench.engine.unseen import start_bare_tracker
before = dict(os.environ), os.getcwd()
start_bare_tracker()
assert (dict(os.environ), os.getcwd()) == before
place = Path("/proc", str(resource_tracker._resource_tracker._pid))
for _ in range(100):  # until the shell has become the helper
    time.sleep(0.0 if b"python" in (place / "cmdline").read_bytes().split(b"\\0")[0] else 0.05)
print((place / "cwd").readlink(), b"secret" in (place / "environ").read_bytes())
"""
    environment = {**os.environ, "TABLE": "/secret"}
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["/", "False"]
