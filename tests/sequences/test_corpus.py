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
    CorpusRecord,
    corpus_batch,
    write_corpus,
)
from prbench.sequences.dataset_info import CorpusCounts, CorpusInfo
from prbench.sequences.schema import SEQUENCES
from tests.fakes import smooth_motion

SHARED = (
    "sequence_id", "dataset", "recording_id", "participant_id", "split", "split_group", "text", "fps", "n_frames",
    "start_time", "pose_source", "head_tilt_deg", "joints", "previous_joints", "previous_source", "next_joints",
    "next_source", "world_from_canonical", "extra",
)  # fmt: skip


def fake_clip(number: int, n: int = 60) -> Clip:
    joints = smooth_motion(f"clip{number}", n)
    return Clip(
        sequence_id=f"nymeria/seq/atomic_action/{number:03d}/suit", dataset="nymeria", recording_id="seq",
        participant_id="p", split=("train", "test")[number % 2], split_group="p", kind="atomic_action",
        captions=(Caption(f"C does {number}.", "atomic_action"), Caption("C moves.", "atomic_action", "C/X")),
        fps=20.0, n_frames=n, start_time=1.0, end_time=4.0, text_start=0.5, text_end=3.5, cut=False, mirrored=False,
        clock_method="file", clock_offset=0.5, clock_quality=None, approximate=False, pose_source="suit",
        head_tilt_deg=20.0, joints=joints, previous_joints=joints[0], previous_source="copied", next_joints=joints[-1],
        next_source="copied", world_from_canonical=np.eye(4),
    )  # fmt: skip


def fake_info() -> CorpusInfo:
    counts = CorpusCounts(
        recordings_found=1, recordings_read=1, recordings_failed=0, recordings_skipped=0, annotations=1, clips=1,
        captions=1, approximate_clips=0, frames=60,
    )  # fmt: skip
    return CorpusInfo(
        schema_version=1, protocol_version=1, protocol_digest="p", dataset="nymeria", title="t", synthetic=True,
        prbench_version="0", manifest_digest="m", input_digest="i", options={}, counts=counts, outcomes={},
        quarantine=(), identity_digest="", content_digest="", licence="", redistribution="yes", homepage="",
        citation="",
    )  # fmt: skip


def write(folder, clips) -> CorpusInfo:
    annotation = Annotation("a", "seq", None, "atomic_action", "", 0.0, 1.0, "no_text")
    record = CorpusRecord("seq", "p", "train", "p", 60.0, {"no_text": 1}, "file", None, "read", "", {"k": "v"})
    tables = {
        "clips": [corpus_batch("clips", clips)] if clips else [],
        "annotations": [corpus_batch("annotations", [annotation])],
        "recordings": [corpus_batch("recordings", [record])],
    }
    return write_corpus(folder, fake_info(), tables)


def test_shared_columns_are_those_of_the_sequence_table():
    for name in SHARED:
        assert CLIPS.field(name).type == SEQUENCES.field(name).type, name


def test_what_is_written_is_read(tmp_path):
    clips = [fake_clip(number, 50 + number) for number in range(5)]
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
    clips = [fake_clip(number) for number in range(4)]
    first = write(tmp_path / "a", clips).content_digest
    batches = [corpus_batch("clips", clips[:1]), corpus_batch("clips", clips[1:])]
    record = CorpusRecord("seq", "p", "train", "p", 60.0, {}, "file", None, "read", "")
    tables = {"clips": batches, "annotations": [], "recordings": [corpus_batch("recordings", [record])]}
    assert write_corpus(tmp_path / "b", fake_info(), tables).content_digest == first
    clips[2].joints[7, 3, 1] += 0.001
    assert write(tmp_path / "c", clips).content_digest != first
    clips[2].joints[7, 3, 1] -= 0.001
    other = fake_clip(0)
    object.__setattr__(other, "captions", (Caption("C does 0!", "atomic_action"), *other.captions[1:]))
    assert write(tmp_path / "d", [other, *clips[1:]]).content_digest != first


def test_empty_damaged_and_foreign_corpora_are_refused(tmp_path):
    with pytest.raises(TableError, match="build-corpus"):
        CorpusTable.open(tmp_path / "nowhere")
    write(tmp_path / "empty", [])
    with pytest.raises(TableError, match="no clips"):
        CorpusTable.open(tmp_path / "empty")
    write(tmp_path / "c", [fake_clip(0)])
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
    write(tmp_path / "c", [fake_clip(0)])
    path = tmp_path / "c" / "corpus.json"
    entries = json.loads(path.read_text())
    path.write_text(json.dumps(entries | {"content_digest": "0" * 64}))
    with pytest.raises(TableError, match="changed after the build"):
        _ = CorpusTable.open(tmp_path / "c").content


def test_only_a_corpus_is_replaced(tmp_path):
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / "thesis.txt").write_text("mine")
    with pytest.raises(StorageError, match=r"corpus\.json"):
        write(tmp_path / "c", [fake_clip(0)])
    assert (tmp_path / "c" / "thesis.txt").read_text() == "mine"
