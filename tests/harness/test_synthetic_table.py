"""Synthetic tables: named as such, and the same for any number of workers or recordings."""

from __future__ import annotations

from pathlib import Path

import pytest

from prbench.engine import ProcessPool
from prbench.errors import UsageError
from prbench.harness.synthetic_table import build_synthetic_table
from prbench.sequences import SequenceTable
from tests.curation.sources import folder_bytes


def build(out: Path, recordings: int = 2, **options) -> SequenceTable:
    build_synthetic_table("adt", recordings, 5, out, n_events=4, **options)
    return SequenceTable.open(out)


def test_it_is_named_synthetic_and_carries_the_splits_of_its_people(tmp_path: Path) -> None:
    seen: list[tuple[int, int, str]] = []
    table = build(tmp_path / "t", progress=lambda *step: seen.append(step))
    assert (table.info.dataset, table.info.synthetic) == ("synthetic-adt", True)
    assert set(table.scalars()["dataset"].to_pylist()) == {"synthetic-adt"}
    assert [step[:2] for step in seen] == [(1, 2), (2, 2)]
    splits = dict(zip(*(table.recordings()[name].to_pylist() for name in ("recording_id", "split")), strict=True))
    assert all(splits[row["recording_id"]] == row["split"] for row in table.scalars().to_pylist())


def test_workers_change_no_byte(tmp_path: Path) -> None:
    build(tmp_path / "one")
    build(tmp_path / "two", engine=ProcessPool(2))
    assert folder_bytes(tmp_path / "one") == folder_bytes(tmp_path / "two")


def test_a_recording_does_not_depend_on_how_many_there_are(tmp_path: Path) -> None:
    few, more = build(tmp_path / "few", 1), build(tmp_path / "more", 2)
    one = next(iter(few.chunks()))
    same = next(iter(more.chunks(ids=frozenset(one.sequence_ids))))
    assert same.sequence_ids == one.sequence_ids
    assert (same.joints == one.joints).all()


def test_a_preset_without_sensors_and_an_empty_table_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="kitchen"):
        build_synthetic_table("kitchen", 1, 0, tmp_path / "t")
    with pytest.raises(UsageError, match="at least one"):
        build_synthetic_table("adt", 0, 0, tmp_path / "t")
