"""The official folder of HumanML3D as a corpus."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from prbench.errors import InputFileError, UsageError
from prbench.sequences import CorpusTable
from prbench_adapters.corpora.build import build_corpus
from prbench_adapters.corpora.humanml3d import files as layout
from prbench_adapters.corpora.humanml3d.files import read_texts
from prbench_adapters.corpora.humanml3d.source import HumanML3DSource
from prbench_adapters.corpora.sources import CorpusOptions
from tests.fakes import smooth_motion


@pytest.fixture(scope="module")
def built(humanml3d_tree, tmp_path_factory):
    return build_corpus("humanml3d", humanml3d_tree, tmp_path_factory.mktemp("built") / "corpus")


def folder(tmp_path, texts: str, *, n: int = 120):
    """One motion with the given text file."""
    root = tmp_path / "HumanML3D"
    for part in (layout.JOINTS_FOLDER, layout.TEXTS_FOLDER):
        (root / part).mkdir(parents=True)
    np.save(root / layout.JOINTS_FOLDER / "000000.npy", smooth_motion("h", n))
    (root / layout.TEXTS_FOLDER / "000000.txt").write_text(texts)
    (root / "train.txt").write_text("000000\n")
    return root


def rows_of(root, out, **more):
    table = CorpusTable.open(build_corpus("humanml3d", root, out, **more).folder)
    return table, table.scalars().to_pylist()


def test_whole_captions_share_a_clip_and_parts_have_their_own(tmp_path):
    texts = "a man walks.#a/DET man/NOUN walk/VERB#0.0#0.0\nhe strolls.#he/PRON#0.0#0.0\nhe stops.#he/PRON#1.0#4.0\n"
    table, rows = rows_of(folder(tmp_path, texts), tmp_path / "out")
    whole, part = rows
    assert whole["sequence_id"] == "humanml3d/000000/caption/0-6000000/humanml3d"
    assert [caption["text"] for caption in whole["captions"]] == ["a man walks.", "he strolls."]
    assert whole["captions"][0]["tokens"] == "a/DET man/NOUN walk/VERB"
    assert (whole["n_frames"], whole["kind"], whole["cut"]) == (120, "caption", False)
    assert (part["kind"], part["start_time"], part["n_frames"]) == ("sub_caption", 1.0, 60)
    joints = next(table.chunks(columns=["joints"])).joints
    motion = np.load(folder_joints(tmp_path))
    shape = motion[0] - motion[0, 0]
    np.testing.assert_allclose(
        np.linalg.norm(joints[0] - joints[0, 0], axis=1), np.linalg.norm(shape, axis=1), atol=1e-5
    )


def folder_joints(tmp_path):
    return tmp_path / "HumanML3D" / layout.JOINTS_FOLDER / "000000.npy"


def test_parts_that_cannot_be_clips_are_accounted_for(tmp_path):
    lines = [
        "x.#x/X#0.0#0.0",
        "short.#x/X#1.0#2.9",
        "back.#x/X#3.0#2.0",
        "late.#x/X#9.0#12.0",
        "#x/X#0.0#0.0",
        "x.#x/X#0.0#0.0",
    ]
    table, rows = rows_of(folder(tmp_path, "\n".join(lines)), tmp_path / "out")
    assert len(rows) == 1
    outcomes = {row["annotation_id"].rsplit("/", 1)[1]: row["outcome"] for row in table.annotations().to_pylist()}
    assert outcomes == {
        "1": "clip", "2": "too_short", "3": "end_before_start", "4": "outside_motion", "5": "no_text", "6": "duplicate",
    }  # fmt: skip


def test_long_motions_are_cut_at_the_loaders_limit(tmp_path):
    _, (row,) = rows_of(folder(tmp_path, "x.#x/X#0.0#0.0\n", n=260), tmp_path / "out")
    assert (row["n_frames"], row["cut"]) == (200, True)


def test_captions_with_the_separator_inside_and_nan_times_are_read(tmp_path):
    path = tmp_path / "t.txt"
    path.write_text("number #1 walks.#number/NOUN#nan#nan\n\nthen.#x/X#0.5#2\n")
    (first, *times), (second, start, end) = read_texts(path)
    assert (first.text, first.kind, times) == ("number #1 walks.", "caption", [0.0, 0.0])
    assert (second.kind, start, end) == ("sub_caption", 0.5, 2.0)


def test_mirrored_copies_stay_with_their_motion(built):
    rows = CorpusTable.open(built.folder).scalars().to_pylist()
    by_id = {row["recording_id"]: row for row in rows if row["kind"] == "caption"}
    assert len(by_id) > 10
    for name, row in by_id.items():
        twin = by_id[name.removeprefix("M")]
        assert row["mirrored"] == name.startswith("M")
        assert (row["split"], row["split_group"]) == (twin["split"], name.removeprefix("M"))


def test_the_official_lists_are_the_splits(built, humanml3d_tree):
    rows = CorpusTable.open(built.folder).recordings().to_pylist()
    for split, name in layout.SPLIT_FILES.items():
        listed = set((humanml3d_tree / name).read_text().split())
        assert listed == {row["recording_id"] for row in rows if row["split"] == split}


def test_features_alone_are_answered_with_what_is_missing(humanml3d_tree, tmp_path):
    tree = tmp_path / "tree"
    shutil.copytree(humanml3d_tree, tree)
    shutil.move(tree / layout.JOINTS_FOLDER, tree / layout.FEATURES_FOLDER)
    with pytest.raises(InputFileError, match=r"new_joints.*files of features.*notebooks"):
        build_corpus("humanml3d", tree, tmp_path / "out")


def test_packed_texts_and_missing_lists_are_named(humanml3d_tree, tmp_path):
    tree = tmp_path / "tree"
    shutil.copytree(humanml3d_tree, tree)
    shutil.rmtree(tree / layout.TEXTS_FOLDER)
    (tree / layout.TEXTS_ARCHIVE).write_bytes(b"")
    with pytest.raises(InputFileError, match=r"texts\.zip, not unpacked"):
        build_corpus("humanml3d", tree, tmp_path / "out")
    shutil.copytree(humanml3d_tree / layout.TEXTS_FOLDER, tree / layout.TEXTS_FOLDER)
    for name in layout.SPLIT_FILES.values():
        (tree / name).unlink()
    with pytest.raises(InputFileError, match="official lists"):
        build_corpus("humanml3d", tree, tmp_path / "out")


def test_a_motion_in_two_lists_is_refused(tmp_path):
    root = folder(tmp_path, "x.#x/X#0.0#0.0\n")
    (root / "test.txt").write_text("000000\n")
    with pytest.raises(InputFileError, match="one split"):
        build_corpus("humanml3d", root, tmp_path / "out")


def test_there_is_one_rate(humanml3d_tree, tmp_path):
    with pytest.raises(UsageError, match="20 frames a second"):
        build_corpus("humanml3d", humanml3d_tree, tmp_path / "out", options=CorpusOptions(fps=30.0))


@pytest.mark.parametrize("times", [1, 2])
def test_a_group_for_which_the_memory_does_not_suffice_is_tried_again_then_told(
    times, built, humanml3d_tree, tmp_path, monkeypatch
):
    read, missing = HumanML3DSource.read, [MemoryError("8 GB wanted")] * times

    def short(recording):
        if missing:
            raise missing.pop()
        return read(recording)

    monkeypatch.setattr(HumanML3DSource, "read", short)
    report = build_corpus("humanml3d", humanml3d_tree, tmp_path / "c")
    failed = [record for record in report.records if record.status == "failed"]
    assert bool(failed) == (times == 2)
    assert all("does not suffice (8 GB wanted)" in record.message for record in failed)
    if times == 1:
        assert (tmp_path / "c/corpus.json").read_bytes() == (built.folder / "corpus.json").read_bytes()
