"""From written files to a corpus: clocks found, equal joints without files, defects, the page."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from prbench.errors import InputFileError, UsageError
from prbench.protocol.manifests import load_manifest
from prbench.sequences import CorpusTable
from prbench.sequences.corpus import ANNOTATION_OUTCOMES, ANNOTATIONS, CLIPS, CORPUS_RECORDINGS
from prbench_adapters.corpora.build import build_corpus, plan_corpus
from prbench_adapters.corpora.nymeria.format import participant_of
from prbench_adapters.corpora.nymeria.source import CORPUS, split_by_participant
from prbench_adapters.corpora.sources import CorpusOptions
from prbench_adapters.corpora.synthetic import synthesize_corpus_tree
from tests.adapters.corpora.humanml3d_defects import DEFECTS as HUMANML3D_DEFECTS
from tests.adapters.corpora.nymeria_defects import DEFECTS as NYMERIA_DEFECTS
from tests.adapters.corpora.suits import SEED
from tests.readers.defects import Defect


def files_of(folder) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def joints_by_span(table: CorpusTable) -> dict[str, np.ndarray]:
    joints = {}
    for chunk in table.chunks(columns=["joints"]):
        parts = np.split(chunk.joints, chunk.offsets[1:-1])
        joints |= {"/".join(name.split("/")[1:4]): part for name, part in zip(chunk.sequence_ids, parts, strict=True)}
    return joints


@pytest.fixture(scope="module")
def built(nymeria_tree, tmp_path_factory):
    return build_corpus("nymeria", nymeria_tree, tmp_path_factory.mktemp("built") / "corpus")


def test_offsets_are_found_and_the_way_is_recorded(built, nymeria_tree):
    truth = json.loads((nymeria_tree / "truth" / "clock_offsets.json").read_text())
    methods = []
    for row in CorpusTable.open(built.folder).recordings().to_pylist():
        found = {item["key"]: item["value"] for item in row["measured"]}
        methods.append(row["clock_method"])
        limit = 1e-3 if row["clock_method"] == "correlation" else 0.05
        assert float(found["clock_offset_s"]) == pytest.approx(truth[row["recording_id"]], abs=limit)
    assert sorted(methods) == ["correlation", "correlation", "start_alignment"]
    clips = CorpusTable.open(built.folder).scalars().to_pylist()
    assert {clip["approximate"] for clip in clips if clip["clock_method"] == "start_alignment"} == {True}
    assert {clip["approximate"] for clip in clips if clip["clock_method"] == "correlation"} == {False}


def test_files_with_a_known_offset_give_the_same_joints_as_no_files_at_all(nymeria_tree, tmp_path):
    tree = tmp_path / "tree"
    shutil.copytree(nymeria_tree, tree)
    shutil.copy(tree / "truth" / "clock_offsets.json", tree / "time_offset.json")
    from_files = build_corpus("nymeria", tree, tmp_path / "files")
    invented = CorpusOptions(source=(("recordings", "3"), ("seed", str(SEED))))
    from_memory = build_corpus("synthetic", None, tmp_path / "memory", options=invented)
    one, other = (joints_by_span(CorpusTable.open(report.folder)) for report in (from_files, from_memory))
    assert one.keys() == other.keys()
    assert len(one) > 30
    for name, joints in one.items():
        np.testing.assert_array_equal(joints, other[name], err_msg=name)
    texts = [CorpusTable.open(report.folder).scalars()["text"].to_pylist() for report in (from_files, from_memory)]
    assert texts[0] == texts[1]


def test_a_build_that_was_interrupted_goes_on_and_ends_in_equal_bytes(built, nymeria_tree, tmp_path):
    class Stopped(Exception):
        pass

    def stop(done: int, total: int, last: str) -> None:
        if done == 2:
            raise Stopped

    with pytest.raises(Stopped):
        build_corpus("nymeria", nymeria_tree, tmp_path / "stopped", progress=stop)
    assert not (tmp_path / "stopped").exists()
    resumed = build_corpus("nymeria", nymeria_tree, tmp_path / "stopped")
    assert resumed.reused == 2
    assert files_of(resumed.folder) == files_of(built.folder)


def test_the_counts_add_up(built):
    counts, table = built.info.counts, CorpusTable.open(built.folder)
    clips = table.scalars()
    assert counts.clips == len(clips) == len(set(clips["sequence_id"].to_pylist()))
    assert counts.frames == sum(clips["n_frames"].to_pylist())
    assert counts.captions == sum(len(captions) for captions in clips["captions"].to_pylist())
    assert counts.annotations == sum(built.info.outcomes.values()) == len(table.annotations())
    assert table.identity == built.info.identity_digest
    assert table.content == built.info.content_digest
    assert clips["sequence_id"].to_pylist() == sorted(clips["sequence_id"].to_pylist())


def test_a_synthetic_tree_is_never_called_nymeria_and_keeps_its_splits(built, nymeria_tree):
    info, marks = built.info, json.loads((nymeria_tree / "synthetic.json").read_text())["split"]
    assert (info.dataset, info.synthetic, info.redistribution, info.citation) == ("synthetic-nymeria", True, "yes", "")
    rows = CorpusTable.open(built.folder).recordings().to_pylist()
    assert {row["recording_id"]: row["split"] for row in rows} == marks


def test_a_synthetic_tree_is_known_from_the_folder_above_and_not_mixed_with_others(nymeria_tree, tmp_path):
    shutil.copytree(nymeria_tree, tmp_path / "above" / "tree")
    marks = json.loads((nymeria_tree / "synthetic.json").read_text())["split"]
    sources = CORPUS.find(tmp_path / "above", CorpusOptions())
    assert {source.identity.dataset for source in sources} == {"synthetic-nymeria"}
    assert {source.identity.recording_id: source.identity.split for source in sources} == marks
    real = tmp_path / "above" / "20230607_s0_james_johnson_act0_e72nhq" / "body"
    shutil.copytree(next((nymeria_tree).glob("*/body")), real)
    with pytest.raises(InputFileError, match="nymeria and synthetic-nymeria together"):
        CORPUS.find(tmp_path / "above", CorpusOptions())


def test_without_the_mark_licence_and_citation_are_those_of_the_dataset(nymeria_tree, tmp_path):
    tree = tmp_path / "tree"
    shutil.copytree(nymeria_tree, tree)
    (tree / "synthetic.json").unlink()
    with pytest.raises(InputFileError, match=r"_invented_.* without it"):
        build_corpus("nymeria", tree, tmp_path / "out", options=CorpusOptions(limit=1))
    for folder in tree.glob("*_invented_*"):
        folder.rename(tree / folder.name.replace("_invented_", "_somebody_"))
    info = build_corpus("nymeria", tree, tmp_path / "out", options=CorpusOptions(limit=1)).info
    assert (info.dataset, info.redistribution, info.licence) == ("nymeria", "non-commercial", "CC BY-NC 4.0")
    assert "ma2024nymeria" in info.citation


def test_rates_and_kinds_can_be_chosen(nymeria_tree, tmp_path):
    source = (("kinds", "activity_summarization"),)
    options = CorpusOptions(fps=30.0, max_frames=150, limit=1, source=source)
    table = CorpusTable.open(build_corpus("nymeria", nymeria_tree, tmp_path / "out", options=options).folder)
    rows = table.scalars().to_pylist()
    assert {(row["kind"], row["fps"], row["n_frames"], row["cut"], row["pose_source"]) for row in rows} == {
        ("activity_summarization", 30.0, 150, True, "nymeria-xsens")
    }


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (CorpusOptions(fps=25.0), "divide the suit's 240 Hz"),
        (CorpusOptions(source=(("kind", "atomic_action"),)), "Did you mean 'kinds'"),
        (CorpusOptions(source=(("kinds", "atomic"),)), "unknown kind of text 'atomic'"),
    ],
)
def test_wrong_options_are_answered_before_anything_is_read(nymeria_tree, tmp_path, options, says):
    with pytest.raises(UsageError, match=says):
        build_corpus("nymeria", nymeria_tree, tmp_path / "out", options=options)


def test_the_dry_run_writes_nothing(nymeria_tree, tmp_path):
    plan = plan_corpus("nymeria", nymeria_tree, CorpusOptions(recordings="*n00001"))
    assert len(plan.recordings) == 1
    assert plan.input_bytes > 1e6
    with pytest.raises(InputFileError, match="whose name matches"):
        plan_corpus("nymeria", nymeria_tree, CorpusOptions(recordings="nothing*"))
    assert list(tmp_path.iterdir()) == []


def test_known_bad_sequences_are_skipped_with_their_reason(nymeria_tree, tmp_path):
    tree = tmp_path / "tree"
    (tree / "20230928_s0_grace_randolph_act2_abc123").mkdir(parents=True)
    source = next(path for path in nymeria_tree.iterdir() if path.is_dir() and path.name != "truth")
    shutil.copytree(source / "body", tree / "20230928_s0_grace_randolph_act2_abc123" / "body")
    shutil.copytree(source, tree / "20230607_s0_james_johnson_act0_e72nhq")
    report = build_corpus("nymeria", tree, tmp_path / "out")
    (left_out,) = report.info.quarantine
    assert left_out.status == "skipped"
    assert "1,689 s" in left_out.message
    assert report.records[0].participant_id == "james_johnson"


def test_participants_decide_the_split_and_sessions_do_not():
    assert participant_of("20230607_s0_james_johnson_act0_e72nhq") == "james_johnson"
    assert participant_of("20231001_s1_james_johnson_act3_zzz000") == "james_johnson"
    manifest = load_manifest("nymeria")
    splits = [split_by_participant(manifest, f"name_{number}") for number in range(2000)]
    shares = [splits.count(split) / 2000 for split in ("train", "validation", "test")]
    np.testing.assert_allclose(shares, [0.80, 0.05, 0.15], atol=0.03)


def test_nothing_to_read_is_said(tmp_path):
    with pytest.raises(UsageError, match="--root"):
        build_corpus("nymeria", None, tmp_path / "out")


def test_a_failure_can_end_the_build(nymeria_tree, tmp_path):
    tree = tmp_path / "tree"
    shutil.copytree(nymeria_tree, tree)
    next(tree.glob("*/body/xdata.npz")).write_bytes(b"no archive")
    report = build_corpus("nymeria", tree, tmp_path / "out")
    assert report.info.counts.recordings_failed == 1
    assert report.info.counts.recordings_read == 2
    assert str(tmp_path) not in report.info.quarantine[0].message
    with pytest.raises(InputFileError, match=r"xdata\.npz"):
        build_corpus("nymeria", tree, tmp_path / "strict", options=CorpusOptions(on_error="fail"))


def damaged(tree, tmp_path, defect: Defect):
    copy = tmp_path / "tree"
    shutil.copytree(tree, copy)
    names = json.loads((copy / "synthetic.json").read_text())["split"]
    first = min(names, key=lambda name: name.rpartition("_n")[2])  # by number: the last has no trajectory
    defect.apply(copy, first)
    return copy, first


def check_defect(name: str, tree, tmp_path, defect: Defect) -> None:
    copy, first = damaged(tree, tmp_path, defect)
    (record,) = build_corpus(name, copy, tmp_path / "out", options=CorpusOptions(recordings=first)).records
    assert record.status == defect.outcome, record.message
    assert defect.says in record.message
    if defect.outcome == "read" and not defect.says:
        assert record.outcomes["clip"] > 0


@pytest.mark.parametrize("defect", NYMERIA_DEFECTS, ids=lambda defect: defect.name)
def test_defects_of_nymeria(nymeria_tree, tmp_path, defect):
    check_defect("nymeria", nymeria_tree, tmp_path, defect)


@pytest.mark.parametrize("defect", HUMANML3D_DEFECTS, ids=lambda defect: defect.name)
def test_defects_of_humanml3d(humanml3d_tree, tmp_path, defect):
    check_defect("humanml3d", humanml3d_tree, tmp_path, defect)


@pytest.mark.parametrize("name", ["unsorted-rows", "no-byte-order-mark", "nested", "by-group", "repeated-row"])
def test_harmless_defects_change_no_clip(nymeria_tree, tmp_path, name):
    defect = next(each for each in NYMERIA_DEFECTS if each.name == name)
    copy, first = damaged(nymeria_tree, tmp_path, defect)
    options = CorpusOptions(recordings=first)
    one = build_corpus("nymeria", nymeria_tree, tmp_path / "one", options=options).info
    other = build_corpus("nymeria", copy, tmp_path / "other", options=options).info
    if name == "repeated-row":
        assert other.outcomes["duplicate"] == 1
    if name == "by-group":  # the trajectory stays with the sequence's name
        assert one.counts == other.counts
    assert one.content_digest == other.content_digest


def test_an_unknown_layout_is_refused(tmp_path):
    with pytest.raises(UsageError, match="nymeria, humanml3d"):
        synthesize_corpus_tree("motionx", tmp_path / "other", recordings=1)


PAGE = (Path(__file__).parents[3] / "docs" / "corpus.md").read_text(encoding="utf-8")


def _columns(section: str) -> set[str]:
    text = PAGE.split(f"\n## {section}\n", 1)[1].split("\n## ")[0]
    cells = [line.split("|")[1] for line in text.splitlines() if line.startswith("| `")]
    return {name for cell in cells for name in re.findall(r"`(\w+)`", cell)}


@pytest.mark.parametrize(
    ("section", "columns"),
    [
        ("clips", set(CLIPS.names)),
        ("annotations", set(ANNOTATIONS.names)),
        (
            "recordings",
            set(CORPUS_RECORDINGS.names) - set(ANNOTATION_OUTCOMES) | {ANNOTATION_OUTCOMES[0], ANNOTATION_OUTCOMES[-1]},
        ),
    ],
)
def test_every_column_is_explained(section, columns):
    assert _columns(section) == columns


def test_every_outcome_is_listed():
    assert all(f"`{outcome}`" in PAGE for outcome in ANNOTATION_OUTCOMES)
