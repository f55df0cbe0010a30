"""Plain recordings are written whole, as they are stated."""

from __future__ import annotations

import tomllib

import msgspec
import numpy as np
import pandas as pd
import pytest

from prbench.errors import StorageError, UsageError
from prbench.readers.own import format as own
from prbench.readers.own.write import write_recording

ABOUT = own.About(participant="p01", units=own.Units(length="cm", time="ms"), axes=own.Axes(up="z"))
EVENTS = {"time": [1.0], "action": ["pick"], "object": ["cup"]}


@pytest.mark.parametrize("suffix", own.SUFFIXES)
def test_values_and_statements_come_back_as_they_were_given(tmp_path, suffix) -> None:
    gaze = {"time": [0.1, 0.2], "dx": [0.0, np.nan], "dy": [0.6, np.nan], "dz": [0.8, np.nan], "note": ["a", "b"]}
    empty = {name: [] for name in own.TABLES["head"][0]}
    write_recording(tmp_path / "one", ABOUT, {"gaze": gaze, "head": empty}, suffix=suffix)
    assert sorted(path.name for path in (tmp_path / "one").iterdir()) == sorted([f"gaze{suffix}", "recording.toml"])
    about = msgspec.convert(tomllib.loads((tmp_path / "one" / "recording.toml").read_text()), own.About)
    assert about == ABOUT
    file = tmp_path / "one" / f"gaze{suffix}"
    written = pd.read_csv(file) if suffix == ".csv" else pd.read_parquet(file)
    pd.testing.assert_frame_equal(written, pd.DataFrame(gaze))


@pytest.mark.parametrize(
    ("tables", "told"),
    [
        ({"gazes": {}}, "no table 'gazes'. Did you mean 'gaze'?"),
    ],
)
def test_what_is_no_plain_recording_is_not_written(tmp_path, tables, told) -> None:
    with pytest.raises(UsageError, match=told.replace("?", r"\?")):
        write_recording(tmp_path / "one", ABOUT, {"events": EVENTS, **tables})
    assert not (tmp_path / "one").exists()


def test_an_earlier_recording_is_replaced_and_nothing_else_is(tmp_path) -> None:
    write_recording(tmp_path / "one", ABOUT, {"events": EVENTS})
    write_recording(tmp_path / "one", ABOUT, {"events": EVENTS}, suffix=".csv")
    assert not (tmp_path / "one" / "events.parquet").exists()
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.tex").write_text("years of work")
    with pytest.raises(StorageError, match=r"holds no recording\.toml"):
        write_recording(tmp_path / "other", ABOUT, {"events": EVENTS})
