"""The frame rate is stated, told by the primed frames, or has to be given; actions come from the prompts."""

from __future__ import annotations

import dataclasses

import pytest

from prbench.errors import InputFileError
from prbench.release.reading import ImportOptions
from prbench.sequences import SequenceTable
from tests.release.imports import imported, value
from tests.release.releases import plain_entry, rows

ROWS = rows(6)


@pytest.mark.parametrize("rate", [20, 25, 30])
def test_primes_two_seconds_after_the_start_tell_the_rate(rate, tmp_path) -> None:
    moved = [dataclasses.replace(row, prime_frame=min(2 * rate, row.n_frames - 1)) for row in ROWS]
    moved[0] = dataclasses.replace(moved[0], prime_frame=7)
    assert value(imported(tmp_path, moved), "fps") == (str(rate), "assumed")


def test_a_stated_rate_counts_and_two_are_refused(tmp_path) -> None:
    def entry(row, style):
        return plain_entry(row, style) | {"fps": 24}

    assert value(imported(tmp_path / "one", entry=entry), "fps") == ("24", "certain")

    def another(row, style):
        rate = 20 if row.sequence_id == ROWS[0].sequence_id else 24
        return plain_entry(row, style) | {"fps": rate}

    with pytest.raises(InputFileError, match=r"the rates \[20\.0, 24\.0\]\. .*--fps"):
        imported(tmp_path / "two", entry=another)


def test_an_untold_rate_has_to_be_given(tmp_path) -> None:
    moved = [dataclasses.replace(row, prime_frame=int(5 + 3 * i)) for i, row in enumerate(ROWS)]
    with pytest.raises(InputFileError, match=r"frame rate.*--fps"):
        imported(tmp_path / "without", moved)
    assert not (tmp_path / "without" / "table").exists()
    report = imported(tmp_path / "with", moved, options=ImportOptions(fps=20.0))
    assert value(report, "fps") == ("20", "certain")


@pytest.mark.parametrize(
    ("text", "action"),
    [
        ("The person picks up a cup.", "pick"), ("A person puts the cup down", "put"), ("someone places it", "put"),
        ("picks/puts an object", "unknown"), ("walks around", "unknown"), ("she grabbed the pan", "pick"),
        ("returning the bowl", "put"), ("sets down the tray", "put"), ("output device", "unknown"),
    ],
)  # fmt: skip
def test_actions_are_read_from_prompts(text, action, tmp_path) -> None:
    def entry(row, style):
        return {name: each for name, each in plain_entry(row, style).items() if name != "action"} | {
            "text_prompt": text
        }

    imported(tmp_path, ROWS[:1], entry=entry)
    assert SequenceTable.open(tmp_path / "table").scalars()["action"].to_pylist() == [action]
