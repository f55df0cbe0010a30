"""Synthetic tables: named as such, and the same for any number of workers or recordings."""

from __future__ import annotations

from pathlib import Path

from prbench.harness.synthetic_table import build_synthetic_table
from prbench.protocol.manifests import load_manifest
from prbench.sequences import SequenceTable


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


def test_people_of_the_second_world_are_others_by_name_too(tmp_path: Path) -> None:
    table, usual = build(tmp_path / "second", 1, world="second"), build(tmp_path / "t", 1)
    assert (table.info.dataset, table.info.synthetic) == ("synthetic-second-adt", True)
    assert all(name.startswith("synthetic-second-adt/") for name in table.sequence_ids())
    assert set(table.scalars()["dataset"].to_pylist()) == {"synthetic-second-adt"}
    assert table.info.options["synthetic_world"] == "second"
    assert load_manifest(table.info.dataset).name == "adt"
    assert table.info.identity_digest != usual.info.identity_digest


def test_a_recording_does_not_depend_on_how_many_there_are(tmp_path: Path) -> None:
    few, more = build(tmp_path / "few", 1), build(tmp_path / "more", 2)
    one = next(iter(few.chunks()))
    same = next(iter(more.chunks(ids=frozenset(one.sequence_ids))))
    assert same.sequence_ids == one.sequence_ids
    assert (same.joints == one.joints).all()
