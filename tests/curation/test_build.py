"""Building a dataset from several recordings."""

from __future__ import annotations

import errno
import shutil
from pathlib import Path

import pytest

from prbench.curation import BuildOptions, CurationOptions, build_dataset, build_from_sources, funnel_rows, plan_build
from prbench.curation.build import build_all
from prbench.curation.job import chosen_ids, funnel_counts
from prbench.errors import InputFileError, MemoryFullError, PrbenchError, StorageError, UsageError
from prbench.files.storage import read_json
from prbench.sequences import SequenceTable
from prbench.synthetic.write_tree import synthesize_tree
from tests.curation.sources import SceneSource, folder_bytes, short_of_memory, some_sources
from tests.fakes import fake_dataset


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


def test_one_for_which_it_does_not_suffice_alone_either_is_told_and_the_build_goes_on(tmp_path: Path) -> None:
    report = build_from_sources(short_of_memory(tmp_path / "times", 2), tmp_path / "adt")
    assert [record.status for record in report.records] == ["read", "failed"]
    message = report.info.quarantine[0].message
    assert message.startswith("room_1: the memory of this machine does not suffice (malloc of size 4398046511104")
    assert "fewer --workers" in message
    options = BuildOptions(on_error="fail")
    with pytest.raises(MemoryFullError, match="room_1"):
        build_from_sources(short_of_memory(tmp_path / "again", 2), tmp_path / "other", options=options)


@pytest.fixture
def root(tmp_path, adt_tree) -> Path:
    shutil.copytree(adt_tree, tmp_path / "copies" / "ADT")
    return tmp_path / "copies"


def test_what_is_found_is_built_under_its_name_and_equals_a_build_by_itself(root, tmp_path, adt_tree) -> None:
    from prbench.curation import build_dataset

    steps = []
    (report,), broken = build_all(root, tmp_path / "out", progress=lambda done, total, last: steps.append(done))
    assert (report.info.counts.recordings_failed, broken) == (0, [])
    assert steps == [1, 2]
    alone = build_dataset("adt", adt_tree, tmp_path / "alone")
    assert SequenceTable.open(tmp_path / "out" / "synthetic-adt").info == alone.info


def test_a_recording_that_fails_is_reported_and_the_dataset_is_not_complete(root, tmp_path) -> None:
    victim = sorted(folder for folder in (root / "ADT").iterdir() if (folder / "metadata.json").is_file())[0]
    (victim / "scene_objects.csv").unlink()
    (report,), _ = build_all(root, tmp_path / "out")
    assert report.info.counts.recordings_failed == 1
    with pytest.raises(InputFileError, match=r"scene_objects\.csv"):
        build_all(root, tmp_path / "out2", options=BuildOptions(on_error="fail"))


def test_two_copies_of_one_dataset_are_refused_by_their_places(root, tmp_path, adt_tree) -> None:
    shutil.copytree(adt_tree, root / "ADT-backup")
    with pytest.raises(UsageError, match=r"ADT and .*ADT-backup"):
        build_all(root, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "options", [BuildOptions(reader=(("colour", "red"),)), BuildOptions(CurationOptions(in_hand="wrist"))]
)
def test_options_that_fit_no_dataset_are_refused_before_anything_is_built(root, tmp_path, options) -> None:
    with pytest.raises(UsageError):
        build_all(root, tmp_path / "out", options=options)
    assert not (tmp_path / "out").exists()


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("native") / "tree"
    synthesize_tree("adt", root, recordings=2, seed=8, size="tiny", n_events=4)
    return root


def test_a_synthetic_tree_is_named_and_split_as_its_mark_says(tree: Path, tmp_path: Path) -> None:
    build_dataset("adt", tree, tmp_path / "table")
    table = SequenceTable.open(tmp_path / "table")
    assert (table.info.dataset, table.info.synthetic, table.info.redistribution) == ("synthetic-adt", True, "yes")
    splits = dict(zip(*(table.recordings()[name].to_pylist() for name in ("recording_id", "split")), strict=True))
    mark = read_json(tree / "synthetic.json")
    assert isinstance(mark, dict)
    assert splits == mark["split"]


def test_where_the_files_lie_leaves_no_trace(tree: Path, tmp_path: Path) -> None:
    shutil.copytree(tree, tmp_path / "elsewhere" / "copy")
    build_dataset("adt", tree, tmp_path / "one")
    build_dataset("adt", tmp_path / "elsewhere" / "copy", tmp_path / "two")
    assert folder_bytes(tmp_path / "one") == folder_bytes(tmp_path / "two")
    assert str(tmp_path).encode() not in b"".join(folder_bytes(tmp_path / "one").values())


def test_the_dry_run_counts_and_writes_nothing(tree: Path, tmp_path: Path) -> None:
    before = sorted(tree.rglob("*"))
    plan = plan_build("adt", tree)
    assert len(plan.recordings) == 2
    assert plan.input_bytes > 1e6
    assert plan.estimated_seconds > 0
    assert sorted(tree.rglob("*")) == before
    assert len(plan_build("adt", tree, BuildOptions(recordings="*seq001*")).recordings) == 1
    assert list(tmp_path.iterdir()) == []


def test_known_bad_and_damaged_recordings_are_named_and_the_others_built(tree: Path, tmp_path: Path) -> None:
    copy = tmp_path / "tree"
    shutil.copytree(tree, copy)
    good, other = sorted(path for path in copy.iterdir() if path.name.startswith("Apartment"))
    other.rename(copy / "Apartment_release_clean_seq139_M1292")
    shutil.copytree(good, copy / "Apartment_release_cut_M1292")
    objects = copy / "Apartment_release_cut_M1292" / "scene_objects.csv"
    objects.write_bytes(objects.read_bytes()[:-7])
    report = build_dataset("adt", copy, tmp_path / "table")
    problems = {item.recording_id: item for item in report.info.quarantine}
    assert problems["Apartment_release_clean_seq139_M1292"].status == "skipped"
    assert "IMU" in problems["Apartment_release_clean_seq139_M1292"].message
    assert problems["Apartment_release_cut_M1292"].status == "failed"
    assert problems["Apartment_release_cut_M1292"].message.startswith("Apartment_release_cut_M1292/scene_objects.csv")
    assert report.info.counts.recordings_read == 1
    assert plan_build("adt", copy).skipped == ("Apartment_release_clean_seq139_M1292",)


def test_a_wrong_root_and_an_unknown_dataset_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match="no such folder"):
        build_dataset("adt", tmp_path / "nowhere", tmp_path / "table")
    with pytest.raises(UsageError, match="adt"):
        build_dataset("adtt", tmp_path, tmp_path / "table")


def test_invented_recordings_without_their_mark_are_refused(tmp_path) -> None:
    tree = synthesize_tree("adt", tmp_path / "tree", recordings=1, seed=3, n_events=2)
    (tree.root / "synthetic.json").unlink()
    with pytest.raises(InputFileError, match=r"synthetic\.json"):
        build_dataset("adt", tree.root, tmp_path / "table")
    assert not (tmp_path / "table").exists()


def test_a_table_of_another_dataset_is_not_replaced(tmp_path) -> None:
    tree = synthesize_tree("adt", tmp_path / "tree", recordings=1, seed=3, n_events=2)
    fake_dataset(tmp_path / "table", n=3, dataset="synthetic-mogaze")
    before = (tmp_path / "table" / "dataset.json").read_bytes()
    with pytest.raises(StorageError, match="synthetic-mogaze"):
        build_dataset("adt", tree.root, tmp_path / "table")
    assert (tmp_path / "table" / "dataset.json").read_bytes() == before
