"""A build over an earlier table: what it may replace, and what it leaves as it is."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from prbench.curation import BuildOptions, build_from_sources
from prbench.errors import RecordingsWouldBeLost
from prbench.recording import Recording
from prbench.sequences import DatasetInfo, SequenceTable
from prbench.sequences.parts import work_folder
from tests.curation.sources import SceneSource, folder_bytes, some_sources

REPLACE = BuildOptions(replace=True)


def broken(sources: list[SceneSource]) -> list[SceneSource]:
    return [replace(source, problem="file") for source in sources]


@dataclass(frozen=True)
class CutScene(SceneSource):
    """A scene of which a file ends early: its objects are known for so many seconds only."""

    objects_until: float = 60.0
    message: str = "objects (o.csv) ends 9.0 s before the recording does"

    def read(self) -> Recording:
        recording = super().read()
        (track,) = recording.objects
        kept = track.times <= self.objects_until
        names = ("times", "position", "rotation", "valid")
        cut = replace(track, **{name: getattr(track, name)[kept] for name in names})
        return replace(recording, objects=(cut,), shortfalls=(self.message,))


@pytest.fixture
def table(tmp_path: Path) -> Path:
    build_from_sources(some_sources(4), tmp_path / "adt")
    return tmp_path / "adt"


def test_a_root_whose_recordings_all_fail_replaces_nothing(table: Path) -> None:
    before = folder_bytes(table)
    sequences = DatasetInfo.read(table).counts.sequences
    with pytest.raises(RecordingsWouldBeLost) as refused:
        build_from_sources(broken(some_sources(4)), table)
    assert folder_bytes(table) == before
    message = str(refused.value)
    assert f"it holds 4 recordings with {sequences} sequences, the new one 0 with 0" in message
    assert "room_0 (failed: a.csv, row 3: expected a number, found text.)" in message
    assert "room_2" in message
    assert "; and 1 more." in message
    assert "`--replace`" in message
    assert "another --out" in message
    assert refused.value.exit_code != 0


@pytest.mark.parametrize("lost", ["missing", "failed", "skipped"])
def test_one_recording_less_is_enough_to_refuse(table: Path, lost: str) -> None:
    sources = some_sources(4)
    if lost == "missing":
        sources = [*sources[1:], SceneSource("room_new")]
    if lost == "failed":
        sources[0] = replace(sources[0], problem="defect")
    if lost == "skipped":
        sources[0] = replace(sources[0], skip_reason="known to be bad")
    before = folder_bytes(table)
    with pytest.raises(RecordingsWouldBeLost, match=r"room_0 \((not found|failed: .*|skipped: .*)\)"):
        build_from_sources(sources, table)
    assert folder_bytes(table) == before
    report = build_from_sources(sources, table, options=REPLACE)
    assert DatasetInfo.read(table) == report.info
    assert "room_0" not in [r.recording_id for r in report.records if r.status == "read"]


def test_a_copy_that_grows_and_one_of_which_a_known_failure_stays_are_no_loss(tmp_path: Path) -> None:
    first = [*some_sources(2), SceneSource("room_8", problem="file")]
    build_from_sources(first, tmp_path / "adt")
    second = [*some_sources(3), SceneSource("room_8", problem="defect"), SceneSource("room_9", problem="file")]
    build_from_sources(second, tmp_path / "adt")
    assert DatasetInfo.read(tmp_path / "adt").counts.recordings_read == 3


def test_what_was_worked_out_before_the_refusal_is_taken_over_by_the_next_try(table: Path) -> None:
    sources = [replace(source, version=source.version + 1) for source in some_sources(3)]
    with pytest.raises(RecordingsWouldBeLost):
        build_from_sources(sources, table)
    assert build_from_sources(sources, table, options=REPLACE).reused == 3
    assert not work_folder(table).exists()


def test_a_recording_of_which_a_file_ends_early_now_is_a_loss_where_it_costs_sequences(table: Path) -> None:
    whole = some_sources(4)
    harmless = [*whole[:3], CutScene("room_3", version=3)]
    build_from_sources(harmless, table)
    harmful = [*whole[:3], CutScene("room_3", version=3, objects_until=5.0)]
    before = folder_bytes(table)
    with pytest.raises(
        RecordingsWouldBeLost, match=r"room_3 \(\d of \d sequences: a part of it is missing or ends early"
    ):
        build_from_sources(harmful, table)
    assert folder_bytes(table) == before


def test_recordings_that_are_cut_short_are_counted_and_told(tmp_path: Path) -> None:
    report = build_from_sources([CutScene("room_a"), SceneSource("room_b")], tmp_path / "adt")
    assert report.info.counts.recordings_cut_short == 1
    first, second = report.records
    assert first.shortfalls == ("objects (o.csv) ends 9.0 s before the recording does",)
    rows = SequenceTable.open(tmp_path / "adt").recordings().to_pylist()
    assert rows[0]["message"].startswith("objects (o.csv) ends 9.0 s before the recording does")
    assert second.shortfalls == ()
    assert "ends" not in rows[1]["message"]


@pytest.mark.parametrize("victim", ["dataset.json", "recordings.parquet", "sequences.parquet"])
def test_a_table_of_which_a_file_is_damaged_still_tells_what_would_be_lost(table: Path, victim: str) -> None:
    (table / victim).write_bytes(b"{ damaged")
    before = folder_bytes(table)
    with pytest.raises(RecordingsWouldBeLost):
        build_from_sources(some_sources(3), table)
    assert folder_bytes(table) == before
    build_from_sources(some_sources(4), table)
    assert DatasetInfo.read(table).counts.recordings_read == 4


def test_a_table_that_tells_nothing_at_all_is_replaced_by_a_whole_one_only(table: Path) -> None:
    for name in ("dataset.json", "recordings.parquet"):
        (table / name).write_bytes(b"")
    with pytest.raises(RecordingsWouldBeLost, match="cannot be listed"):
        build_from_sources(broken(some_sources(1)) + some_sources(3)[1:], table)
    build_from_sources(some_sources(1), table)
    assert DatasetInfo.read(table).counts.recordings_read == 1
