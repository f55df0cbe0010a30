"""Corrections by a person: read from a file, applied before priming, kept in the table, told by explain and diff."""

from __future__ import annotations

from pathlib import Path

import pytest

from prbench.curation import BuildOptions, CurationOptions, build_from_sources
from prbench.curation.build import build_shard_from_sources
from prbench.curation.corrections import Correction, Corrections, UnknownEventError, read_corrections
from prbench.curation.differences import compare_builds
from prbench.curation.events import Decision, PickPutEvent
from prbench.engine.shards import Shard
from prbench.sequences import SequenceTable
from prbench.viewing.explain import explain_event
from tests.curation.sources import SceneSource, some_sources
from tests.shared import made_once

ROOM = "adt/room_0/1"
HEADER = "event_id,change,value,reason,author\n"


def written(folder: Path, *rows: str, name: str = "c.csv") -> Path:
    path = folder / name
    path.write_text(HEADER + "".join(f"{row},seen,MM\n" for row in rows), encoding="utf-8")
    return path


def build(folder: Path, *rows: str, sources=None, **options) -> SequenceTable:
    corrections = read_corrections(written(folder, *rows))
    build_from_sources(
        sources or some_sources(2), folder / "table", options=BuildOptions(corrections=corrections, **options)
    )
    return SequenceTable.open(folder / "table")


def plain() -> Path:
    """The table without corrections."""
    return made_once("uncorrected", lambda folder: build_from_sources(some_sources(2), folder))


def event(table: SequenceTable, name: str) -> dict:
    (row,) = (row for row in table.events().to_pylist() if row["event_id"] == name)
    return row


@pytest.fixture(scope="module")
def pick() -> str:
    table = SequenceTable.open(plain())
    return next(name for name in table.events()["event_id"].to_pylist() if name.startswith(f"{ROOM}/pick"))


def test_a_moved_event_is_primed_anew_and_keeps_its_id(tmp_path: Path, pick: str) -> None:
    table = build(tmp_path, f"{pick},move,-3.20")
    before = event(SequenceTable.open(plain()), pick)
    after = event(table, pick)
    assert after["event_time"] == pytest.approx(before["event_time"] - 3.2)
    assert (before["outcome"], after["outcome"]) == ("sequence", "not_primed")  # the look comes 3.17 s before
    assert after["corrected"] == "move -3.20: seen (MM)"
    again = build(tmp_path, f"{pick},move,-2.0")
    assert event(again, pick)["prime_time"] == before["prime_time"]
    ((ends,),) = (row.values() for row in again.scalars(columns=["event_time"]).to_pylist() if row["event_time"] < 13)
    assert ends == pytest.approx(before["event_time"] - 2.0)


def test_another_goal_is_hit_tested_anew_and_its_box_moves_with_it(tmp_path: Path, pick: str) -> None:
    before = event(SequenceTable.open(plain()), pick)
    missed = event(build(tmp_path, f"{pick},goal,3.0 0.9 1.5"), pick)
    assert (missed["outcome"], missed["location"]) == ("not_primed", [3.0, 0.9, 1.5])
    near = event(build(tmp_path, f"{pick},goal,0.5 0.93 1.5"), pick)
    assert near["outcome"] == "sequence"
    assert near["box_min"] == pytest.approx([x + y for x, y in zip(before["box_min"], (0, 0.03, 0), strict=True)])


def test_a_dropped_event_is_counted_and_never_lost(tmp_path: Path, pick: str) -> None:
    table = build(tmp_path, f"{pick},drop,", f"{pick},note,")
    row = event(table, pick)
    assert (row["outcome"], row["sequence_id"], row["stage"]) == ("dropped_by_person", None, "correction")
    assert table.info.outcomes["dropped_by_person"] == 1
    assert table.info.counts.events == table.info.counts.located + 1 == 4
    assert explain_event(table.folder, pick).stages[0].verdict == "stopped here"


def test_hand_and_name_are_those_that_a_person_says(tmp_path: Path, pick: str) -> None:
    table = build(tmp_path, f"{pick},hand,right", f"{pick},rename,mug")
    row = event(table, pick)
    assert (row["hand"], row["hand_source"], row["object_name"]) == ("right", "person", "mug")
    assert "the right hand, by a person's correction" in explain_event(table.folder, pick).text()
    sequence = next(iter(table.chunks(ids={row["sequence_id"]}))).batch.to_pylist()[0]
    assert sequence["object_name"] == "mug"
    assert {"key": "corrected", "value": row["corrected"]} in sequence["extra"]


def test_accepting_settles_doubt_and_changes_nothing_else(tmp_path: Path, pick: str) -> None:
    table = build(tmp_path, f"{pick},accept,", f"{pick},note,", curation=CurationOptions(min_confidence=1.0))
    before = event(SequenceTable.open(plain()), pick)
    assert before["event_confidence"] < 1
    assert event(table, pick) == before | {"corrected": "accept: seen (MM); note: seen (MM)"}
    assert table.info.outcomes["low_confidence"] > 0
    assert table.info.options["corrections"] == "2"
    assert table.info.options["corrections_digest"] == read_corrections(tmp_path / "c.csv").digest


def test_diff_says_that_a_correction_decided(tmp_path: Path, pick: str) -> None:
    build(tmp_path, f"{pick},move,1.5")  # farther than two events that diff takes for one may lie apart
    (there,) = compare_builds(plain(), tmp_path / "table").changes
    (back,) = compare_builds(tmp_path / "table", plain()).changes
    assert (there.kind, there.decided_by) == ("moved", "correction: move 1.5: seen (MM); event +1.500 s")
    assert back.decided_by.startswith("correction: taken back: move 1.5: seen (MM); event -1.500 s")


@pytest.mark.parametrize(
    ("slip", "nearest"),
    [("pick/14000000", "pick/"), ("pikc/14167034", "pick/"), ("put/14167034", "put/")],
)
def test_an_unknown_event_is_refused_with_the_nearest_and_nothing_is_written(tmp_path, slip, nearest) -> None:
    with pytest.raises(UnknownEventError, match=rf"c\.csv, line 2, event_id: .* The nearest is '{ROOM}/{nearest}"):
        build(tmp_path, f"{ROOM}/{slip},drop,")
    assert not (tmp_path / "table").exists()


@pytest.mark.parametrize("name", ["adt/room_7/1/pick/14167034", "hot3d/room_0/1/pick/14167034"])
def test_an_unknown_recording_is_refused_before_anything_is_read(tmp_path, name) -> None:
    unreadable = [SceneSource("room_0", problem="defect"), SceneSource("room_1", problem="defect")]
    with pytest.raises(UnknownEventError, match=r"an event of a recording of this build .* nearest recording is room_"):
        build(tmp_path, f"{name},drop,", sources=unreadable, on_error="fail")


def test_corrections_of_recordings_that_a_partial_build_lacks_or_cannot_read_wait(tmp_path, pick: str) -> None:
    away = "adt/room_7/1/pick/14167034"
    table = build(tmp_path, f"{away},drop,", f"{pick},drop,", recordings="room_?")
    assert table.info.options["corrections_waiting"] == f"1 (first: {away})"
    assert event(table, pick)["outcome"] == "dropped_by_person"
    broken = [SceneSource("room_0", problem="file"), *some_sources(2)[1:]]
    (tmp_path / "other").mkdir()
    table = build(tmp_path / "other", f"{pick},drop,", sources=broken)
    assert table.info.options["corrections_waiting"] == f"1 (first: {pick})"


def test_a_shard_refuses_an_unknown_event_of_its_own_recordings_alone(tmp_path, pick: str) -> None:
    options = BuildOptions(corrections=read_corrections(written(tmp_path, f"{pick}0,drop,")))
    build_shard_from_sources(some_sources(2), tmp_path / "2", Shard(2, 2), options=options)
    with pytest.raises(UnknownEventError, match=pick):
        build_shard_from_sources(some_sources(2), tmp_path / "1", Shard(1, 2), options=options)


def test_csv_and_toml_say_the_same(tmp_path: Path) -> None:
    rows = (f"{ROOM}/pick/1,move,-0.4", f'{ROOM}/pick/1,rename,"a ""cup"", big"', f"{ROOM}/put/2,goal,0.5 0.9 -1.5")
    text = read_corrections(written(tmp_path, *rows)).rows
    (tmp_path / "c.toml").write_text(
        "".join(
            f'[[correction]]\nevent_id = "{ROOM}/{event}"\nchange = "{change}"\nvalue = {value}\nreason = "seen"\n'
            'author = "MM"\n'
            for event, change, value in (
                ("pick/1", "move", "-0.4"), ("pick/1", "rename", "'a \"cup\", big'"),
                ("put/2", "goal", "[0.5, 0.9, -1.5]"),
            )
        )
    )  # fmt: skip
    toml = read_corrections(tmp_path / "c.toml").rows
    assert [row[:5] for row in toml] == [row[:5] for row in text]
    assert [row.where for row in toml] == ["correction 1", "correction 2", "correction 3"]


@pytest.mark.parametrize("written_as", ["bom", "crlf", "empty columns", "other order"])
def test_what_spreadsheets_write_is_read(tmp_path: Path, written_as: str) -> None:
    text = HEADER + f"{ROOM}/pick/1,move,-0.4,\"'-5 cm, then ''\nmoved\",MM\n\n"
    content = {
        "bom": b"\xef\xbb\xbf" + text.encode(),
        "crlf": text.replace("\n", "\r\n").encode(),
        "empty columns": text.replace("author\n", "author,,\n").replace("MM\n", "MM,,\n").encode(),
        "other order": f"author,{HEADER[:-8]}\nMM,{ROOM}/pick/1,move,-0.4,\"'-5 cm, then ''\nmoved\"\n".encode(),
    }[written_as]
    (tmp_path / "c.csv").write_bytes(content)
    (row,) = read_corrections(tmp_path / "c.csv").rows
    assert row.reason.replace("\r", "") == "-5 cm, then ''\nmoved"  # the apostrophe that keeps it from being a formula
    assert row[:3] == (f"{ROOM}/pick/1", "move", "-0.4")


@pytest.mark.parametrize(
    ("outcome", "change", "value", "left"),
    [
        ("tracking_lost", "move", "0.20", None),
        ("other_wearer", "hand", "left", None),
        ("no_location", "goal", "1 1 1", None),
        ("tracking_lost", "hand", "left", "tracking_lost"),
        ("excluded_category", "move", "0.20", "excluded_category"),
        ("other_wearer", "drop", "", "dropped_by_person"),
        ("other_wearer", "accept", "", "other_wearer"),
    ],
)
def test_a_correction_settles_the_doubt_that_it_answers(outcome, change, value, left) -> None:
    doubted = PickPutEvent(
        "adt/r/1/pick/5", "1", "cup", "pick", 5e-6, None, None, None, None, rejected=Decision(outcome, "location")
    )
    row = Correction(doubted.event_id, change, value, "seen", "MM", "line 2")
    (settled,) = Corrections("c.csv", "", (row,)).settle([doubted])
    assert (settled.rejected and settled.rejected.outcome) == left
    assert (settled.place is None) == (change != "goal")
