"""Building a dataset from several recordings."""

from __future__ import annotations

import errno
from dataclasses import replace
from pathlib import Path

import pytest

from prbench.curation import BuildOptions, CurationOptions, build_from_sources, funnel_rows
from prbench.curation.job import chosen_ids, funnel_counts
from prbench.engine import InProcess, ProcessPool
from prbench.errors import InputFileError, MemoryFullError, PrbenchError, StorageError, UsageError
from prbench.sequences import SequenceTable
from tests.curation.sources import SceneSource, folder_bytes, some_sources


def test_a_build_holds_all_sequences_in_order_and_leaves_nothing_beside_it(tmp_path: Path) -> None:
    report = build_from_sources(some_sources(), tmp_path / "adt")
    table = SequenceTable.open(tmp_path / "adt")
    ids = table.scalars()["sequence_id"].to_pylist()
    assert ids == sorted(ids)
    assert len(ids) == report.info.counts.sequences == 10
    assert table.content == report.info.content_digest
    assert [path.name for path in tmp_path.iterdir()] == ["adt"]


def test_names_that_begin_alike_come_out_sorted(tmp_path: Path) -> None:
    names = ["room", "room-b", "room_c", "room1"]
    build_from_sources([SceneSource(name) for name in names], tmp_path / "adt")
    ids = SequenceTable.open(tmp_path / "adt").scalars()["sequence_id"].to_pylist()
    assert ids == sorted(ids)


def test_failed_and_skipped_recordings_are_counted_named_and_free_of_places(tmp_path: Path) -> None:
    sources = [
        *some_sources(2),
        SceneSource("broken", problem="file"),
        SceneSource("odd", problem="defect"),
        SceneSource("noisy", problem="defect", skip_reason="damaged IMU data"),
    ]
    seen = []
    report = build_from_sources(sources, tmp_path / "adt", progress=lambda *step: seen.append(step[:2]))
    counts = report.info.counts
    assert (counts.recordings_found, counts.recordings_read, counts.recordings_failed, counts.recordings_skipped) == (
        5, 2, 2, 1,
    )  # fmt: skip
    messages = {item.recording_id: (item.status, item.message) for item in report.info.quarantine}
    assert messages["broken"] == ("failed", "a.csv, row 3: expected a number, found text.")
    assert messages["odd"] == ("failed", "unexpected KeyError: 'left'")
    assert messages["noisy"] == ("skipped", "damaged IMU data")
    assert len(SequenceTable.open(tmp_path / "adt").recordings()) == 5
    assert seen == [(index + 1, 5) for index in range(5)]
    assert b"/home/" not in b"".join(folder_bytes(tmp_path / "adt").values())


def test_on_error_stop_ends_the_build_with_the_error(tmp_path: Path) -> None:
    options = BuildOptions(on_error="fail")
    with pytest.raises(InputFileError, match="row 3"):
        build_from_sources([SceneSource("broken", problem="file")], tmp_path / "adt", options=options)
    with pytest.raises(PrbenchError, match="odd: unexpected KeyError"):
        build_from_sources([SceneSource("odd", problem="defect")], tmp_path / "adt", options=options)
    assert not (tmp_path / "adt").exists()


def test_the_funnel_loses_nothing(tmp_path: Path) -> None:
    options = BuildOptions(CurationOptions(minimum_movement="pelvis_displacement"))
    info = build_from_sources(some_sources(3), tmp_path / "adt", options=options).info
    rows = {stage: rest for stage, *rest in funnel_rows(info)}
    assert (rows["candidate events"][0], rows["long enough"][0]) == (6, 6)
    assert rows["moved enough"][:2] == [0, 6]
    assert "6 minimum_movement" in rows["moved enough"][2]
    assert rows["sequences"][0] == 0
    assert info.options["minimum_movement"] == "pelvis_displacement"


def test_every_outcome_leaves_the_funnel_at_its_stage() -> None:
    dropped = ("other_wearer", "excluded_category", "no_location", "tracking_lost", "not_primed", "too_short",
               "no_body", "minimum_movement")  # fmt: skip
    outcomes = {name: 2**power for power, name in enumerate(dropped)} | {"sequence": 1000}
    counts = funnel_counts({"read": 3, "failed": 2, "skipped": 1}, outcomes)
    assert counts.recordings_found == 6
    assert counts.events == 1255
    assert (counts.located, counts.primed, counts.long_enough, counts.moved_enough, counts.sequences) == (
        1240, 1224, 1128, 1000, 1000,
    )  # fmt: skip


def test_a_folder_that_is_no_dataset_is_refused_before_any_work(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(StorageError, match="no dataset that may be replaced"):
        build_from_sources([SceneSource("room", problem="defect")], tmp_path)
    assert (tmp_path / "thesis.tex").exists()


def test_an_earlier_dataset_is_replaced(tmp_path: Path) -> None:
    build_from_sources(some_sources(1), tmp_path / "adt")
    build_from_sources(some_sources(3), tmp_path / "adt")
    assert len(SequenceTable.open(tmp_path / "adt").recordings()) == 3


def test_synthetic_recordings_are_never_called_by_the_datasets_name(tmp_path: Path) -> None:
    sources = [replace(source, dataset="synthetic-adt", split="test") for source in some_sources(2)]
    info = build_from_sources(sources, tmp_path / "out").info
    assert (info.dataset, info.synthetic, info.redistribution) == ("synthetic-adt", True, "yes")


def test_recordings_are_chosen_by_glob_and_limit() -> None:
    names = ["b_2", "a_1", "a_2", "a_3"]
    assert chosen_ids(names, BuildOptions(recordings="a_*", limit=2), where="here") == ["a_1", "a_2"]
    assert chosen_ids(["a", "a-b"], BuildOptions(limit=1), where="here") == ["a-b"], "the order of sequence ids"
    with pytest.raises(InputFileError, match="matches 'c\\*', found 4 others"):
        chosen_ids(names, BuildOptions(recordings="c*"), where="here")


def test_two_recordings_of_one_name_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match="different names"):
        build_from_sources([SceneSource("a"), SceneSource("a")], tmp_path / "adt")


def test_a_full_disk_leaves_nothing_half_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(path: Path, value: object) -> None:
        raise OSError(errno.ENOSPC, "no space left")

    monkeypatch.setattr("prbench.sequences.parts.write_json", full)
    with pytest.raises(StorageError, match="no space left"):
        build_from_sources(some_sources(2), tmp_path / "adt")
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_an_unknown_rule_is_answered_with_the_known_ones(tmp_path: Path) -> None:
    options = BuildOptions(CurationOptions(in_hand="elbow"), on_error="fail")
    with pytest.raises(UsageError, match="wrist"):
        build_from_sources(some_sources(1), tmp_path / "adt", options=options)


def short_of_memory(folder: Path, times: int) -> list[SceneSource]:
    """Two recordings; for one the memory will not suffice so many times."""
    folder.mkdir()
    for index in range(times):
        (folder / str(index)).touch()
    return [some_sources(1)[0], replace(some_sources(2)[1], short=folder)]


@pytest.mark.parametrize("engine", [InProcess(), ProcessPool(2)], ids=["in process", "pool"])
def test_a_recording_for_which_the_memory_did_not_suffice_once_changes_no_byte(engine, tmp_path: Path) -> None:
    build_from_sources(some_sources(2), tmp_path / "undisturbed")
    build_from_sources(short_of_memory(tmp_path / "times", 1), tmp_path / "adt", engine=engine)
    assert not list((tmp_path / "times").iterdir())
    assert folder_bytes(tmp_path / "adt") == folder_bytes(tmp_path / "undisturbed")


def test_one_for_which_it_does_not_suffice_alone_either_is_told_and_the_build_goes_on(tmp_path: Path) -> None:
    report = build_from_sources(short_of_memory(tmp_path / "times", 2), tmp_path / "adt")
    assert [record.status for record in report.records] == ["read", "failed"]
    message = report.info.quarantine[0].message
    assert message.startswith("room_1: the memory of this machine does not suffice (malloc of size 4398046511104")
    assert "fewer --workers" in message
    options = BuildOptions(on_error="fail")
    with pytest.raises(MemoryFullError, match="room_1"):
        build_from_sources(short_of_memory(tmp_path / "again", 2), tmp_path / "other", options=options)
