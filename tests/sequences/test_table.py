"""Writing a dataset and reading it back."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from prbench.errors import StorageError, TableError, UsageError
from prbench.sequences import SequenceTable
from prbench.sequences.schema import SEQUENCES, with_metadata
from prbench.sequences.sequence import sequence_batch
from prbench.sequences.table import by_share, find_sequence_id
from prbench.sequences.write import write_table_in_parts
from tests.fakes import fake_dataset, fake_sequence


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


def test_joints_are_a_view_of_the_parquet_buffers_not_a_copy(tmp_path):
    chunk = next(fake_dataset(tmp_path / "d", 10).chunks())
    assert not chunk.joints.flags.owndata
    assert np.shares_memory(chunk.joints, chunk.joints)


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


def test_equal_rows_give_equal_bytes(tmp_path):
    first, second = fake_dataset(tmp_path / "a", 12), fake_dataset(tmp_path / "b", 12)
    for name in ("sequences.parquet", "events.parquet", "recordings.parquet", "dataset.json"):
        assert (first.folder / name).read_bytes() == (second.folder / name).read_bytes()


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


def test_an_unknown_schema_version_is_refused_with_both_versions(tmp_path):
    table = fake_dataset(tmp_path / "d", 4)
    path = table.folder / "sequences.parquet"
    data = pq.read_table(path)
    pq.write_table(data.replace_schema_metadata({**data.schema.metadata, b"prbench_schema_version": b"9"}), path)
    with pytest.raises(TableError, match=r"sequences\.parquet: expected schema version 3, found 9"):
        SequenceTable.open(table.folder)


def test_a_missing_column_is_named(tmp_path):
    table = fake_dataset(tmp_path / "d", 4)
    path = table.folder / "sequences.parquet"
    pq.write_table(pq.read_table(path).drop_columns(["prime_kind"]), path)
    with pytest.raises(TableError, match="expected a column 'prime_kind'"):
        SequenceTable.open(table.folder)


@pytest.mark.parametrize("name", ["sequences", "events", "recordings"])
def test_damage_anywhere_in_a_table_is_an_error_that_names_the_file(tmp_path, name):
    fake_dataset(tmp_path / "d")
    path = tmp_path / "d" / f"{name}.parquet"
    content = path.read_bytes()
    damaged = bytes(byte ^ 0xFF for byte in content[4 : len(content) // 3])  # the footer stays whole
    path.write_bytes(content[:4] + damaged + content[len(content) // 3 :])
    with pytest.raises(TableError, match=name):
        _read_everything(SequenceTable.open(tmp_path / "d"))


def _read_everything(table):
    return table.scalars(), table.content, table.events(), table.recordings()


def test_a_table_is_opened_by_the_name_of_its_folder(tmp_path):
    fake_dataset(tmp_path / "d", 3)
    table = SequenceTable.open(str(tmp_path / "d"))
    assert table.folder == tmp_path / "d"
    assert table.with_sequences().scalars().num_rows == 3
    with pytest.raises(TableError, match="expected a built dataset"):
        SequenceTable.open(str(tmp_path / "nowhere"))


def test_a_folder_without_dataset_is_refused(tmp_path):
    with pytest.raises(TableError, match="expected a built dataset"):
        SequenceTable.open(tmp_path)


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


def test_schema_metadata_says_units_and_joint_set():
    metadata = with_metadata(SEQUENCES, protocol_version=1).metadata
    assert metadata[b"joint_set"] == b"humanml3d-22"
    assert metadata[b"unit_length"] == b"m"


IDS = ["adt/rec_1/cup/pick/10.5/suit", "adt/rec_1/cup/put/12.25/suit", "adt/rec_2/cup/pick/10.75/egoallo"]


@pytest.mark.parametrize(
    ("wanted", "found"),
    [(IDS[1], 1), ("egoallo", 2), ("adt/rec_2", 2), ("12.25/suit", 1), ("put", 1), ("pick/10.5/", 0)],
)
def test_an_id_or_a_part_that_fits_one_only(wanted, found):
    assert find_sequence_id(wanted, IDS, among="adt") == IDS[found]


def test_a_beginning_or_end_goes_before_a_part_inside():
    assert find_sequence_id("a", ["a/b", "c/a/d"], among="x") == "a/b"


def test_parts_that_fit_several_are_listed():
    with pytest.raises(UsageError, match=r"'suit' fits 2 sequences of adt(.|\n)*10\.5/suit(.|\n)*12\.25/suit"):
        find_sequence_id("suit", IDS, among="adt")


def test_many_that_fit_are_not_all_listed():
    with pytest.raises(UsageError, match="and 12 more"):
        find_sequence_id("a", [f"a{number}" for number in range(20)], among="x")


def test_an_unknown_id_gets_the_nearest():
    with pytest.raises(UsageError, match=r"no sequence 'put/12\.52'(.|\n)*Near it:\n  adt/rec_1/cup/put/12\.25/suit"):
        find_sequence_id("put/12.52", IDS, among="adt")


def test_nothing_typed_is_nothing_found():
    with pytest.raises(UsageError, match="no sequence ''"):
        find_sequence_id("", IDS, among="adt")
