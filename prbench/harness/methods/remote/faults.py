"""Faults of a program, each as half a sentence that begins after its name."""

from __future__ import annotations

import signal
import sys


class Fault(Exception):
    """A program did not do its part. The text completes "its program …"."""


class Ended(Fault):
    """It is gone, or has closed one of its pipes; starting it again may help."""


class TimedOut(Fault):
    """It has not done in time what it was asked for."""


class CutShort(Fault):
    """It has announced a payload and not written all of it in time."""


class BrokenProtocol(Fault):
    """It wrote to stdout what is no message, or not the message that was due."""


class ReportedError(Fault):
    """It says itself that it failed, and goes on waiting."""


def excerpt(found: bytes | bytearray, limit: int = 80) -> str:
    r"""Return the first characters of what was found, in quotes, whatever bytes they are.

    >>> excerpt(b"epoch 1\r\n")
    "'epoch 1'"
    """
    text = found[: 4 * limit].decode(errors="backslashreplace").rstrip("\r\n")
    shown = "".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in text)
    return f"'{shown[:limit]}'" + ("…" if len(shown) > limit or len(found) > 4 * limit else "")


def exit_story(status: int) -> str:
    """Say how a process ended, from its return code.

    >>> exit_story(1)
    'ended with exit status 1'
    >>> exit_story(-9)
    'was ended by signal 9 (SIGKILL; often the system that ran out of memory)'
    """
    if sys.platform == "win32" and status > 255:
        return f"ended with exit status 0x{status:08X}"
    if status < 0:
        return f"was ended by signal {-status} ({_signal_name(-status)})"
    if 128 < status < 160 and sys.platform != "win32":  # how shells, fences and containers pass a signal on
        return f"ended with exit status {status} (128 + {status - 128}: {_signal_name(status - 128)})"
    return f"ended with exit status {status}"


def _signal_name(number: int) -> str:
    try:
        name = signal.Signals(number).name
    except ValueError:
        return "unknown"
    return f"{name}; often the system that ran out of memory" if name == "SIGKILL" else name
