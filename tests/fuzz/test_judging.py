"""The judge of the damages finds what it is there for."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.fuzz.judging import Outcome, Seen, verdict

ROOT = Path(__file__).parents[2]
BEFORE = Seen("values", ("remark",))

_LOOKS = {
    "read": "lambda: Seen('values')",
    "refused": "lambda: fail(InputFileError('a.csv', 'line 1', expected='x', found='y'))",
    "unforeseen": "lambda: fail(UnforeseenInput('a.csv', '', expected='x', found='y'))",
    "traceback": "lambda: fail(KeyError('x'))",
    "hang": "lambda: time.sleep(60)",
    "memory": "lambda: np.zeros(2**31, dtype=np.uint8) + 1",
    "died": "lambda: os._exit(3)",
}


def test_every_ending_is_recognised():
    looks = ", ".join(f"{name!r}: {look}" for name, look in _LOOKS.items())
    script = f"""
import os, time
import numpy as np
from prbench.errors import InputFileError, UnforeseenInput
from tests.fuzz.judging import Looker, Seen
def fail(error):
    raise error
for name, look in {{{looks}}}.items():
    print(name, Looker(look, seconds=5.0 if name != "hang" else 0.5, memory=2**30)().ending)
"""
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True)
    assert [line.split() for line in done.stdout.splitlines()] == [[name, name] for name in _LOOKS]


@pytest.mark.parametrize(
    ("after", "must_be_told", "expected"),
    [
        (Outcome("read", BEFORE), True, "same"),
        (Outcome("read", Seen("others", ("remark",))), True, "silent"),
        (Outcome("read", Seen("others", ("remark",))), False, "unseen"),
        (Outcome("read", Seen("others", ("remark", "cut off"))), True, "told"),
        (Outcome("refused", message="a.csv: expected x, found y."), False, "refused"),
        (Outcome("refused", message="a.csv: \x1b[31m"), False, "message"),
        (Outcome("refused", message="x" * 9_000), False, "message"),
        (Outcome("hang"), False, "hang"),
        (Outcome("traceback"), False, "traceback"),
    ],
)
def test_a_change_must_be_told_where_it_can_be_known(after, must_be_told, expected):
    assert verdict(BEFORE, after, must_be_told=must_be_told) == expected
