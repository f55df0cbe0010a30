"""Commands that end in different ways; a child process imports them from here."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Sequence


def returns(arguments: Sequence[str]) -> int:
    return int(arguments[0])


def leaves(arguments: Sequence[str]) -> int:
    os._exit(int(arguments[0]))


def leaves_a_child_behind(arguments: Sequence[str]) -> int:
    subprocess.Popen([sys.executable, "-c", "import time; time.sleep(20)"], close_fds=False)
    os._exit(0)


def is_killed(arguments: Sequence[str]) -> int:
    os.kill(os.getpid(), getattr(signal, arguments[0]))
    return 0


def raises(arguments: Sequence[str]) -> int:
    raise RuntimeError("a defect of prbench")
