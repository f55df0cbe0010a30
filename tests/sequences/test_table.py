"""Writing a dataset and reading it back: every column, every id, digests, statistics, and the page that explains it."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
from collections import Counter
from pathlib import Path
from typing import get_args

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from prbench.cli.main import main
from prbench.curation.job import native_sources
from prbench.curation.options import NO_OPTIONS
from prbench.errors import InputFileError, RunError, StorageError, TableError, UsageError
from prbench.files.storage import is_path_part
from prbench.harness.run_folder.scores import SCORES, read_scores, write_scores
from prbench.protocol.published import QUANTITIES
from prbench.recording import HandSource
from prbench.sequences import SequenceTable
from prbench.sequences.folds import write_fold
from prbench.sequences.schema import (
    ADDED_COLUMNS,
    DATASET_TABLES,
    OPTIONAL_TABLES,
    check_schema,
    digests_of_files,
    identity_of_rows,
)
from prbench.sequences.sequence import (
    EVENTS,
    OUTCOMES,
    RECORDINGS,
    SCENES,
    SEQUENCES,
    sequence_batch,
)
from prbench.sequences.table import by_share, find_sequence_id, table_statistics
from prbench.sequences.write import write_table_in_parts
from tests.fakes import fake_box, fake_dataset, fake_sequence, write_rows
from tests.laws.curation_cases import edit


def test_every_column_comes_back_as_it_was_written(tmp_path):
    table = fake_dataset(tmp_path / "d", 10)
    rows = {row.sequence_id: row for row in (fake_sequence(i) for i in range(10))}
    for chunk in table.chunks():
        offsets = chunk.offsets
        for i, name in enumerate(chunk.sequence_ids):
            row, part = rows[name], slice(offsets[i], offsets[i + 1])
            assert np.array_equal(chunk.joints[part], row.joints)
            assert np.array_equal(chunk.frames("gaze_direction")[part], row.gaze_direction.astype(np.float32))
            assert np.array_equal(chunk.frames("gaze_valid")[part], row.gaze_valid)
            assert np.array_equal(chunk.poses("previous_joints")[i], row.previous_joints)
            assert np.array_equal(chunk.vectors("goal_location")[i], row.goal_location)
            assert np.array_equal(chunk.vectors("world_from_canonical")[i].reshape(4, 4), row.world_from_canonical)
            assert chunk.numbers("prime_time")[i] == row.prime_time
            assert chunk.strings("hand")[i] == (row.hand or "")
            assert chunk.strings("object_id")[i] == row.object_id
            assert {pair["key"]: pair["value"] for pair in chunk.batch.column("extra")[i].as_py()} == dict(row.extra)
            assert chunk.batch.column("head_position")[i].is_valid is (row.head_position is not None)


def test_a_split_and_a_choice_of_ids_leave_only_those_rows(tmp_path):
    table = fake_dataset(tmp_path / "d", 48)
    test_ids = [name for chunk in table.chunks(split="test", columns=[]) for name in chunk.sequence_ids]
    assert 0 < len(test_ids) < 48
    chosen = frozenset(test_ids[:3])
    assert [name for c in table.chunks(split="test", ids=chosen) for name in c.sequence_ids] == sorted(chosen)


def test_many_parts_read_like_one_file(tmp_path):
    one = fake_dataset(tmp_path / "one", 40)
    rows = sorted((fake_sequence(i) for i in range(40)), key=lambda row: row.sequence_id)
    many = fake_dataset(tmp_path / "many", 40)
    batches = [sequence_batch(rows[i : i + 7]) for i in range(0, 40, 7)]
    write_table_in_parts(many.folder, "sequences", batches, SEQUENCES, protocol_version=1, largest_part=1)
    assert not (many.folder / "sequences.parquet").exists()
    many = SequenceTable.open(many.folder)
    assert many.content == one.content
    assert many.identity == one.identity


def test_content_digest_sees_a_tenth_of_a_millimetre_and_identity_does_not(tmp_path):
    table = fake_dataset(tmp_path / "d", 6)
    identity = table.identity
    data = pq.read_table(table.folder / "sequences.parquet").combine_chunks()
    joints = data["joints"].combine_chunks()
    numbers = joints.flatten().flatten().to_numpy().copy()
    numbers[17] += 1e-4
    values = pa.FixedSizeListArray.from_arrays(pa.array(numbers), type=joints.type.value_type)
    moved = pa.ListArray.from_arrays(joints.offsets, values, type=joints.type)
    index = data.schema.get_field_index("joints")
    pq.write_table(data.set_column(index, data.schema.field(index), moved), table.folder / "sequences.parquet")
    assert SequenceTable(table.folder, table.info).identity == identity
    with pytest.raises(TableError, match=r"sequences\.parquet: .* changed after the build"):
        SequenceTable.open(table.folder)


def test_encoding_is_byte_stream_split_and_zstd(tmp_path):
    table = fake_dataset(tmp_path / "d", 300)
    metadata = pq.ParquetFile(table.folder / "sequences.parquet").metadata
    assert metadata.num_row_groups == 2
    group = metadata.row_group(0)
    columns = {group.column(i).path_in_schema: group.column(i) for i in range(group.num_columns)}
    joints = next(column for path, column in columns.items() if path.startswith("joints."))
    assert group.num_rows == 256
    assert joints.compression == "ZSTD"
    assert "BYTE_STREAM_SPLIT" in joints.encodings


def test_a_table_is_opened_by_the_name_of_its_folder(tmp_path):
    fake_dataset(tmp_path / "d", 3)
    table = SequenceTable.open(str(tmp_path / "d"))
    assert table.folder == tmp_path / "d"
    assert table.with_sequences().scalars().num_rows == 3
    with pytest.raises(TableError, match="expected a built dataset"):
        SequenceTable.open(str(tmp_path / "nowhere"))


def test_a_folder_of_several_datasets_is_answered_with_their_names(tmp_path):
    folder = fake_dataset(tmp_path / "adt", 1).folder
    with pytest.raises(TableError, match=f"Did you mean {folder}\\?"):
        SequenceTable.open(tmp_path)


def test_a_folder_with_other_files_is_never_replaced(tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(StorageError, match="not empty"):
        fake_dataset(tmp_path, 4)
    assert (tmp_path / "thesis.tex").read_text() == "years of work"


def test_a_limit_takes_the_same_sequences_whatever_their_order():
    names = [f"d/r{i % 7}/{i}" for i in range(200)]
    recordings = [name.split("/")[1] for name in names]
    order = by_share(names, recordings)
    assert sorted(order) == sorted(names)
    assert by_share(names[::-1], recordings[::-1]) == order


def test_every_recording_has_its_share_at_any_limit():
    sizes = {"a": 3, "b": 30, "c": 60, "d": 90}
    names = [f"d/{recording}/{i}" for recording, size in sizes.items() for i in range(size)]
    order = by_share(names, [name.split("/")[1] for name in names])
    for limit in (1, 10, 61, 120, 183):
        taken = Counter(name.split("/")[1] for name in order[:limit])
        for recording, size in sizes.items():
            assert taken[recording] == pytest.approx(limit * size / len(names), abs=2)


def test_all_sequences_are_equally_likely_to_be_chosen_whatever_the_size_of_their_recording():
    chosen: Counter[str] = Counter()
    for trial in range(2_000):
        names = [f"d/{trial}-small/{i}" for i in range(2)] + [f"d/{trial}-large/{i}" for i in range(8)]
        order = by_share(names, [name.split("/")[1] for name in names])
        chosen.update(name.split("-")[1].split("/")[0] for name in order[:5])
    assert chosen["small"] / 2 == pytest.approx(chosen["large"] / 8, rel=0.05)


IDS = ["adt/rec_1/cup/pick/10.5/suit", "adt/rec_1/cup/put/12.25/suit", "adt/rec_2/cup/pick/10.75/egoallo"]


@pytest.mark.parametrize(
    ("wanted", "found"),
    [(IDS[1], 1), ("egoallo", 2), ("adt/rec_2", 2), ("12.25/suit", 1), ("put", 1), ("pick/10.5/", 0)],
)
def test_an_id_or_a_part_that_fits_one_only(wanted, found):
    assert find_sequence_id(wanted, IDS, among="adt") == IDS[found]
    assert find_sequence_id("a", ["a/b", "c/a/d"], among="x") == "a/b", "a beginning goes before a part inside"


@pytest.mark.parametrize(
    ("wanted", "known", "message"),
    [
        ("suit", IDS, r"'suit' fits 2 sequences of adt(.|\n)*10\.5/suit(.|\n)*12\.25/suit"),
        ("a", [f"a{number}" for number in range(20)], "and 12 more"),
        ("put/12.52", IDS, r"no sequence 'put/12\.52'(.|\n)*Near it:\n  adt/rec_1/cup/put/12\.25/suit"),
        ("", IDS, "no sequence ''"),
    ],
)
def test_an_id_that_fits_none_or_several_is_answered_with_the_nearest(wanted, known, message):
    with pytest.raises(UsageError, match=message):
        find_sequence_id(wanted, known, among="adt")


# Every command that opens a table. DATA, EVENT, P (a file of motions) and OUT (a new folder or file) are filled in.
OPEN_A_TABLE = (
    "inspect DATA",
    "explain EVENT --data DATA",
    "diff DATA DATA",
    "review DATA --root DATA --out OUT.html",
    "view --data DATA --out OUT.png",
    "run --method static --condition none --data DATA --out OUT",
    "run --method static --condition none --data DATA --fold 1/2 --out OUT",
    "run --method static --condition none --data DATA --folds participant --out OUT",
    "export-conditions --condition none --data DATA --out OUT.npz",
    "score P --data DATA",
    "doctor P --data DATA",
    "train --method mdm --config smoke --data DATA --out OUT",
    "export-release DATA --out OUT",
    "datasets --cite DATA",
    "adapters check static --data DATA",
    "audit --data DATA --out OUT",
    "build-windows --data DATA --out OUT",
    "study table-1 DATA",
    "study table-s2 DATA",
    "validate hd-epic --data DATA",
)


@pytest.fixture(scope="module")
def edited(tmp_path_factory) -> dict[str, Path]:
    """Two tables: one with an edited file, and one whose description was remade after a value was edited."""
    made = {name: fake_dataset(tmp_path_factory.mktemp(name) / "d", 6) for name in ("events", "sequences")}
    for name, column in (("events", "event_time"), ("sequences", "goal_location")):
        folder = made[name].folder
        path = folder / f"{name}.parquet"
        if column == "event_time":
            edit(path, column)
            continue
        rows = pq.read_table(path)
        place = rows.schema.get_field_index(column)
        moved = np.array(rows[column].to_pylist())
        moved[0, 0] += 0.01
        kind = rows.schema.field(place)
        pq.write_table(rows.set_column(place, kind, pa.array(moved.tolist(), kind.type)), path)
        digests = digests_of_files(folder, DATASET_TABLES)
        msgspec.structs.replace(made[name].info, file_digests=digests).write(folder)
    return {name: table.folder for name, table in made.items()}


@pytest.mark.parametrize("command", OPEN_A_TABLE)
def test_every_command_that_opens_a_table_refuses_an_edited_one(command, edited, tmp_path, capsys) -> None:
    np.savez(tmp_path / "p.npz", joints=np.zeros((1, 40, 22, 3), dtype=np.float32))
    for name, said in (
        ("events", "events.parquet: expected the file that dataset.json describes"),
        ("sequences", "sequences.parquet: the values are not the ones that dataset.json describes"),
    ):
        words = {"DATA": str(edited[name]), "EVENT": fake_sequence(0).sequence_id, "P": str(tmp_path / "p.npz")}
        out = {f"OUT{end}": str(tmp_path / f"out{end}") for end in ("", ".html", ".png", ".npz")}
        before = sorted(tmp_path.iterdir())
        assert main([(words | out).get(word, word) for word in command.split()]) == TableError.exit_code
        assert said in capsys.readouterr().err
        assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize(
    ("column", "value", "said"),
    [
        ("goal_location", [np.nan] * 3, "numbers within 1e+10"),
        ("start_time", 1e300, "numbers within 1e+10"),
        ("fps", 0.0, "a rate above 0"),
        ("n_frames", -5, "1 or more"),
        ("n_frames", 10**9, "as many values as frames"),
        ("gaze_direction", [], "as many values as frames"),
    ],
)
def test_values_that_no_build_writes_are_refused_whatever_their_digests(column, value, said, tmp_path) -> None:
    table = fake_dataset(tmp_path / "d", 6)
    path = table.folder / "sequences.parquet"
    rows = pq.read_table(path)
    values = rows[column].to_pylist()
    values[2] = value
    place = rows.schema.get_field_index(column)
    kind = rows.schema.field(place)
    pq.write_table(rows.set_column(place, kind, pa.array(values, kind.type)), path)
    with pytest.raises(TableError, match=re.escape(f": expected {said}")):
        SequenceTable.open(table.folder)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"sequences": 7}, "counts.sequences: expected 6, as the table has it, found 7"),
        ({"sequences": -1}, "Expected `int` >= 0 - at `$.counts.sequences`"),
        ({"events": 10**15}, "Expected `int` <= 1000000000000 - at `$.counts.events`"),
    ],
)
def test_numbers_of_a_description_fit_the_table(change, said, tmp_path) -> None:
    path = fake_dataset(tmp_path / "d", 6).folder / "dataset.json"
    told = json.loads(path.read_text())
    path.write_text(json.dumps(told | {"counts": told["counts"] | change}))
    with pytest.raises(TableError, match=re.escape(said)):
        SequenceTable.open(tmp_path / "d")


def test_a_main_table_written_anew_with_equal_values_is_the_same(tmp_path: Path) -> None:
    table = fake_dataset(tmp_path / "d", 6)
    path = table.folder / "sequences.parquet"
    pq.write_table(pq.read_table(path), path, compression="snappy")
    assert SequenceTable.open(table.folder).content == table.content


@pytest.mark.parametrize("version", ["1", "2", "6"])
def test_a_table_of_another_version_is_refused(tmp_path, version) -> None:
    table = fake_dataset(tmp_path / "d", 6)
    path = table.folder / "events.parquet"
    data = pq.read_table(path)
    pq.write_table(data.replace_schema_metadata({**data.schema.metadata, b"prbench_schema_version": version}), path)
    with pytest.raises(TableError, match=f"expected schema version 3 to 5, found {version}"):
        table.events()


@pytest.mark.parametrize("version", ["3", "4"])
def test_a_table_of_an_older_version_is_read_with_what_it_lacks_left_open(tmp_path, version) -> None:
    table = fake_dataset(tmp_path / "d", 6)
    expected = {name: getattr(table, name)() for name in ("events", "recordings")}
    for name in ("sequences", "events", "recordings"):
        path = table.folder / f"{name}.parquet"
        data = pq.read_table(path)
        data = data.drop_columns([each for each in data.column_names if each in ADDED_COLUMNS[version]])
        pq.write_table(data.replace_schema_metadata({**data.schema.metadata, b"prbench_schema_version": version}), path)
    digests = digests_of_files(table.folder, ["sequences", "events", "recordings"])
    msgspec.structs.replace(table.info, schema_version=int(version), file_digests=digests).write(table.folder)
    old = SequenceTable.open(table.folder)
    assert old.content == table.content
    assert {name: getattr(old, name)() for name in ("events", "recordings")} == expected
    assert old.events()["event_confidence"].null_count == old.events().num_rows
    assert old.events()["video"].null_count == old.events().num_rows
    assert set(old.recordings()["low_confidence"].to_pylist()) == {0}


def test_the_identity_of_sequences_outlives_columns_of_other_tables() -> None:
    of_version_1 = hashlib.sha256(b"prbench schema 1 protocol 1\nd/r/o/pick/1/egoallo\ttest\tpick\t7\n").hexdigest()
    rows = pa.table({"sequence_id": ["d/r/o/pick/1/egoallo"], "split": ["test"], "action": ["pick"], "n_frames": [7]})
    assert identity_of_rows(rows, protocol_version=1) == of_version_1


BOXES = (fake_box("rec000", entered=None), fake_box("rec001", entered=0.3))


@pytest.fixture
def table(tmp_path):
    return fake_dataset(tmp_path / "table", 24, boxes=BOXES)


def test_boxes_come_back_as_they_were_written(table):
    rows = table.scenes().to_pylist()
    assert [row["recording_id"] for row in rows] == ["rec000", "rec001"]
    assert rows[0]["half_extents"] == [2.0, 0.45, 2.0]
    assert [row["entered"] for row in rows] == [None, 0.3]
    described = json.loads((table.folder / "croissant.json").read_text())
    assert {record["name"] for record in described["recordSet"]} >= {"scenes"}


def test_a_table_without_boxes_has_no_such_file_and_the_same_digests(table, tmp_path):
    plain = fake_dataset(tmp_path / "plain", 24)
    assert not plain.has_scenes
    assert plain.scenes().num_rows == 0
    assert not (plain.folder / "scenes.parquet").exists()
    assert (plain.identity, plain.content) == (table.identity, table.content)


def test_folds_keep_the_boxes(table, tmp_path):
    write_fold(table, tmp_path / "fold", fold=1, folds=2)
    assert SequenceTable.open(tmp_path / "fold").scenes().equals(table.scenes())


def statistics_of(folder, rows):
    return table_statistics(write_rows(folder, rows))


def test_means_and_spreads_are_those_of_the_columns(tmp_path) -> None:
    table = fake_dataset(tmp_path / "t", n=20)
    statistics, scalars = table_statistics(table), table.scalars()
    assert statistics.sequences == 20
    assert statistics.by_split == {s: scalars["split"].to_pylist().count(s) for s in ("train", "validation", "test")}
    for name in QUANTITIES:
        assert statistics.spread(name).mean == pytest.approx(float(np.mean(getattr(statistics, name))))
    assert statistics.spread("prime_gap").mean == pytest.approx(np.mean(scalars["prime_gap"].to_pylist()))


def test_people_on_both_sides_of_the_split_are_counted(tmp_path) -> None:
    rows = [
        dataclasses.replace(fake_sequence(index), split=split, participant_id=person)
        for index, (split, person) in enumerate([("train", "a"), ("test", "a"), ("train", "b"), ("validation", "b")])
    ]
    assert statistics_of(tmp_path / "t", rows).participants_in_two_splits == 1


def test_the_goal_is_seen_from_the_pelvis_of_the_first_frame(tmp_path) -> None:
    row = fake_sequence(0)
    pelvis = row.joints[0, 0]
    left_and_up = pelvis + np.array([2.0, np.sqrt(8.0), 2.0])
    statistics = statistics_of(tmp_path / "t", [dataclasses.replace(row, goal_location=left_and_up)])
    assert statistics.goal_distance == pytest.approx([4.0])
    assert statistics.goal_elevation_deg == pytest.approx([45.0])
    assert statistics.goal_azimuth_deg == pytest.approx([45.0])


def test_gaze_on_the_goal_has_no_shift_and_invalid_gaze_does_not_count(tmp_path) -> None:
    row = fake_sequence(0)
    towards = row.goal_location - row.gaze_origin
    towards = towards / np.linalg.norm(towards, axis=1, keepdims=True)
    after = np.arange(row.n_frames) / row.fps >= row.preroll
    aside = np.cross(towards, np.array([0.0, 1.0, 0.0]))
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    direction = np.where(after[:, None], towards, aside)
    valid = np.arange(row.n_frames) >= 4  # at 20 frames a second two frames fall into each tenth of a second
    statistics = statistics_of(tmp_path / "t", [dataclasses.replace(row, gaze_direction=direction, gaze_valid=valid)])
    median = statistics.gaze_shift_deg[:, 1]
    assert median[(statistics.gaze_shift_times >= 0) & np.isfinite(median)] == pytest.approx(0.0, abs=0.1)
    before = median[(statistics.gaze_shift_times < -0.2) & np.isfinite(median)]
    assert before == pytest.approx(90.0, abs=0.1)
    first_bin = int(np.floor((-row.preroll + 2.0) / 0.1 + 1e-6))
    assert np.isnan(median[first_bin])
    assert np.isfinite(median[first_bin + 3])


PAGE = (Path(__file__).parents[2] / "docs" / "table.md").read_text(encoding="utf-8")


def _columns(section: str) -> set[str]:
    text = PAGE.split(f"\n## {section}\n", 1)[1].split("\n## ")[0]
    cells = [line.split("|")[1] for line in text.splitlines() if line.startswith("| `")]
    return {name for cell in cells for name in re.findall(r"`(\w+)`", cell)}


@pytest.mark.parametrize(
    ("section", "columns"),
    [
        ("sequences", set(SEQUENCES.names)),
        ("events", set(EVENTS.names)),
        ("scenes", set(SCENES.names)),
        ("recordings", set(RECORDINGS.names) - set(OUTCOMES) | {"sequence", "dropped_by_person"}),
    ],
)
def test_every_column_is_explained(section, columns):
    assert _columns(section) == columns


@pytest.mark.parametrize("name", ["sequences", "events", "recordings", "scenes"])
def test_every_field_of_the_files_carries_its_meaning_and_its_unit(table, name) -> None:
    written = pq.read_schema(table.folder / f"{name}.parquet")
    expected = {**DATASET_TABLES, **OPTIONAL_TABLES}[name]
    for found, field in zip(written, expected, strict=True):
        told = {key: text for key, text in found.metadata.items() if key in (b"description", b"unit")}
        assert told == field.metadata, field.name
        assert len(told[b"description"]) > 8
        leaf = found.type
        while pa.types.is_list(leaf) or pa.types.is_fixed_size_list(leaf):
            leaf = leaf.value_type
        is_number = pa.types.is_floating(leaf) or pa.types.is_integer(leaf)
        assert (told[b"unit"] != b"none") == is_number, field.name
    bare = pa.schema([field.remove_metadata() for field in written], metadata=written.metadata)
    check_schema(bare, expected, source="a file that another program has written")


@pytest.mark.parametrize(
    ("schema", "units"),
    [
        (SEQUENCES, {"fps": "Hz", "preroll": "s", "joints": "m", "gaze_direction": "1", "head_tilt_deg": "deg"}),
        (EVENTS, {"event_time": "s", "prime_margin": "m", "event_confidence": "1", "box_min": "m", "outcome": "none"}),
        (RECORDINGS, {"duration": "s", "low_confidence": "1", "message": "none"}),
        (SCENES, {"centre": "m", "rotation": "1", "entered": "m"}),
    ],
)
def test_units_by_hand(schema, units) -> None:
    assert {name: schema.field(name).metadata[b"unit"].decode() for name in units} == units


def test_every_outcome_is_listed():
    assert all(f"`{outcome}`" in PAGE for outcome in OUTCOMES)


def test_everything_that_tells_a_hand_is_explained():
    assert _columns("Which hand reached") == set(get_args(HandSource)) | {"hand_source"}


@pytest.mark.parametrize("name", ["../../evil", "y" * 100_000])
def test_a_dataset_whose_name_leads_elsewhere_leaves_nothing_behind(tmp_path: Path, capsys, name: str) -> None:
    tables = [fake_dataset(tmp_path / "deep" / "down" / part, 4).folder for part in "ab"]
    info = json.loads((tables[1] / "dataset.json").read_text())
    (tables[1] / "dataset.json").write_text(json.dumps(info | {"dataset": name}))
    before = {path.relative_to(tmp_path) for path in tmp_path.rglob("*")}
    run = ["run", "--method", "static", "--condition", "none", "--out", str(tmp_path / "deep" / "down" / "run")]
    assert main([*run, "--data", *map(str, tables)]) == TableError.exit_code
    said = capsys.readouterr().err
    assert "dataset: expected a name that a folder can have" in said
    assert len(said) < 1000
    assert {path.relative_to(tmp_path) for path in tmp_path.rglob("*")} == before


@pytest.mark.parametrize("name", ["adt", "synthetic-hot3d", "My Data 2", "hd_epic.v2"])
def test_ordinary_names_are_fine(name: str) -> None:
    assert is_path_part(name)


@pytest.mark.parametrize("name", ["/tmp/evil", "..", "", "-rf", ".hidden", "a\\b", "a:b", "x\x1b", "y" * 200])
def test_other_names_are_not(name: str) -> None:
    assert not is_path_part(name)


@pytest.mark.parametrize("name", ["sequences", "events", "recordings"])
def test_a_table_with_an_id_twice_is_refused_and_the_id_named(tmp_path: Path, name: str, monkeypatch) -> None:
    monkeypatch.setattr("prbench.sequences.table.require_unchanged", lambda *_, **__: None)  # forged with its digests
    folder = fake_dataset(tmp_path / "d", 6).folder
    path = folder / f"{name}.parquet"
    rows = pq.read_table(path)
    if len(rows) == 0:
        pytest.skip("the table of this kind is empty here")
    pq.write_table(pa.concat_tables([rows, rows.slice(0, 1)]), path)
    first = rows.column(0)[0].as_py()
    with pytest.raises(TableError, match=f"{name}: expected rows with different ids, found '{first}' twice"):
        getattr(SequenceTable.open(folder), name)()


def test_scores_with_a_value_twice_are_refused(tmp_path: Path) -> None:
    row = {"sequence_id": "a/b", "dataset": "adt", "sample": 0, "metric": "mpjpe", "value": 0.5, "flag": None}
    write_scores(tmp_path / "scores.parquet", [pa.Table.from_pylist([row, row], SCORES)])
    with pytest.raises(RunError, match=r"expected one value for each .*, found more: adt, a/b, sample 0, mpjpe"):
        read_scores(tmp_path / "scores.parquet")


def test_one_recording_in_two_folders_is_refused_and_both_are_named(tmp_path: Path, monkeypatch) -> None:
    class Twice:
        dataset = "adt"

        def find(self, root: Path):
            from prbench.readers import RecordingFiles

            return tuple(RecordingFiles("adt", "kitchen", root / part, ()) for part in ("one", "two"))

    monkeypatch.setattr("prbench.curation.job.reader_for", lambda *_: Twice())
    with pytest.raises(InputFileError, match=r"'kitchen' in .*one and .*two"):
        native_sources("adt", tmp_path, NO_OPTIONS)


def test_a_message_that_quotes_a_header_of_100_000_characters_is_cut(tmp_path: Path, capsys) -> None:
    folder = fake_dataset(tmp_path / "d", 2).folder
    rows = pq.read_table(folder / "sequences.parquet")
    pq.write_table(rows.rename_columns(["x" * 100_000, *rows.column_names[1:]]), folder / "sequences.parquet")
    assert main(["inspect", str(folder)]) == TableError.exit_code
    assert len(capsys.readouterr().err) < 5_000
