"""Corpora written and opened: shared columns, digests, and damage told."""

from __future__ import annotations

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from prbench.errors import StorageError, TableError
from prbench.sequences import CorpusTable
from prbench.sequences.corpus import (
    CLIPS,
    Annotation,
    Caption,
    Clip,
    corpus_batch,
    write_corpus,
)
from prbench.sequences.dataset_info import CorpusInfo
from prbench.sequences.schema import SEQUENCES
from tests.fakes import fake_clip, write_clips

SHARED = (
    "sequence_id", "dataset", "recording_id", "participant_id", "split", "split_group", "text", "fps", "n_frames",
    "start_time", "pose_source", "head_tilt_deg", "joints", "previous_joints", "previous_source", "next_joints",
    "next_source", "world_from_canonical", "extra",
)  # fmt: skip


NO_TEXT = Annotation("a", "rec", None, "atomic_action", "", 0.0, 1.0, "no_text")


def captioned(number: int, n: int = 60, words: str = "") -> Clip:
    captions = (Caption(words or f"C does {number}.", "atomic_action"), Caption("C moves.", "atomic_action", "C/X"))
    return fake_clip(number, n, captions=captions, split=("train", "test")[number % 2])


def write(folder, clips) -> CorpusInfo:
    return write_clips(folder, clips, [NO_TEXT], measured={"k": "v"}).info


def test_shared_columns_are_those_of_the_sequence_table():
    for name in SHARED:
        assert CLIPS.field(name).type == SEQUENCES.field(name).type, name


def test_what_is_written_is_read(tmp_path):
    clips = [captioned(number, 50 + number) for number in range(5)]
    write(tmp_path / "c", clips)
    table = CorpusTable.open(tmp_path / "c")
    (chunk,) = table.chunks()
    for clip, part in zip(clips, np.split(chunk.joints, chunk.offsets[1:-1]), strict=True):
        np.testing.assert_array_equal(part, clip.joints)
    assert table.scalars()["captions"].to_pylist()[3][1] == {
        "text": "C moves.",
        "kind": "atomic_action",
        "tokens": "C/X",
    }
    assert [len(part) for part in table.chunks(split="test", columns=["text"])] == [2]
    assert table.recordings()["measured"].to_pylist() == [[{"key": "k", "value": "v"}]]
    assert table.annotations()["outcome"].to_pylist() == ["no_text"]
    assert table.content == table.info.content_digest


def test_the_content_digest_sees_values_and_captions_and_no_batches(tmp_path):
    clips = [captioned(number) for number in range(4)]
    info = write(tmp_path / "a", clips)
    batches = [corpus_batch("clips", clips[:1]), corpus_batch("clips", clips[1:])]
    tables = {"clips": batches, "annotations": [], "recordings": []}
    assert write_corpus(tmp_path / "b", info, tables).content_digest == info.content_digest
    clips[2].joints[7, 3, 1] += 0.001
    assert write(tmp_path / "c", clips).content_digest != info.content_digest
    clips[2].joints[7, 3, 1] -= 0.001
    assert write(tmp_path / "d", [captioned(0, words="C does 0!"), *clips[1:]]).content_digest != info.content_digest


def test_empty_damaged_and_foreign_corpora_are_refused(tmp_path):
    with pytest.raises(TableError, match="build-corpus"):
        CorpusTable.open(tmp_path / "nowhere")
    write(tmp_path / "empty", [])
    with pytest.raises(TableError, match="no clips"):
        CorpusTable.open(tmp_path / "empty")
    write(tmp_path / "c", [captioned(0)])
    path = tmp_path / "c" / "clips.parquet"
    table = pq.read_table(path)
    pq.write_table(table.drop(["captions"]), path)
    with pytest.raises(TableError, match="a column 'captions'"):
        CorpusTable.open(tmp_path / "c")
    metadata = dict(table.schema.metadata) | {b"prbench_corpus_schema_version": b"99"}
    pq.write_table(table.replace_schema_metadata(metadata), path)
    with pytest.raises(TableError, match="found 99"):
        CorpusTable.open(tmp_path / "c")
    narrow = pa.field("cut", pa.int8(), nullable=False)
    index = table.schema.get_field_index("cut")
    pq.write_table(table.set_column(index, narrow, pa.array([1], pa.int8())), path)
    with pytest.raises(TableError, match="'cut'"):
        CorpusTable.open(tmp_path / "c")


def test_a_changed_file_is_noticed(tmp_path):
    write(tmp_path / "c", [captioned(0)])
    path = tmp_path / "c" / "corpus.json"
    entries = json.loads(path.read_text())
    path.write_text(json.dumps(entries | {"content_digest": "0" * 64}))
    with pytest.raises(TableError, match="changed after the build"):
        _ = CorpusTable.open(tmp_path / "c").content


def test_only_a_corpus_is_replaced(tmp_path):
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / "thesis.txt").write_text("mine")
    with pytest.raises(StorageError, match=r"corpus\.json"):
        write(tmp_path / "c", [captioned(0)])
    assert (tmp_path / "c" / "thesis.txt").read_text() == "mine"
