"""Building a dataset: from native files, in shards, over an earlier table, and after a kill."""

from __future__ import annotations

import errno
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from prbench.curation import BuildOptions, CurationOptions, build_dataset, build_from_sources, funnel_rows, plan_build
from prbench.curation.build import build_all, build_shard_from_sources, merge_dataset_shards
from prbench.curation.job import chosen_ids, funnel_counts
from prbench.engine.shards import Shard, require_whole
from prbench.errors import (
    InputFileError,
    MemoryFullError,
    PrbenchError,
    RecordingsWouldBeLost,
    ShardError,
    StorageError,
    UsageError,
)
from prbench.files.storage import read_json
from prbench.recording import Recording
from prbench.sequences import DatasetInfo, SequenceTable
from prbench.sequences.parts import work_folder
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
    assert chosen_ids(names, "a_*", 2, where="here") == ["a_1", "a_2"]
    with pytest.raises(InputFileError, match="matches 'c\\*', found 4 others"):
        chosen_ids(names, "c*", None, where="here")


@pytest.mark.parametrize("name", ["a\x1b[2J", "a\udcff", "a\nb"])
def test_a_recording_whose_name_no_table_can_hold_is_named(name):
    with pytest.raises(InputFileError, match=r"here: expected recordings whose names can be shown, found 'a\\"):
        chosen_ids(["b", name], "*", None, where="here")


def test_two_recordings_of_one_name_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match="different names"):
        build_from_sources([SceneSource("a"), SceneSource("a")], tmp_path / "adt")


def test_a_full_disk_leaves_nothing_half_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(path: Path, value: object) -> None:
        raise OSError(errno.ENOSPC, "no space left")

    monkeypatch.setattr("prbench.files.storage.write_json", full)
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
    assert "do less at once (--batch-size, --limit, --workers)" in message
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


def test_a_synthetic_tree_is_named_and_split_as_its_mark_says(adt_tree: Path, tmp_path: Path) -> None:
    build_dataset("adt", adt_tree, tmp_path / "table")
    table = SequenceTable.open(tmp_path / "table")
    assert (table.info.dataset, table.info.synthetic, table.info.redistribution) == ("synthetic-adt", True, "yes")
    splits = dict(zip(*(table.recordings()[name].to_pylist() for name in ("recording_id", "split")), strict=True))
    mark = read_json(adt_tree / "synthetic.json")
    assert isinstance(mark, dict)
    assert splits == mark["split"]


def test_where_the_files_lie_leaves_no_trace(adt_tree: Path, tmp_path: Path) -> None:
    shutil.copytree(adt_tree, tmp_path / "elsewhere" / "copy")
    build_dataset("adt", adt_tree, tmp_path / "one")
    build_dataset("adt", tmp_path / "elsewhere" / "copy", tmp_path / "two")
    assert folder_bytes(tmp_path / "one") == folder_bytes(tmp_path / "two")
    assert str(tmp_path).encode() not in b"".join(folder_bytes(tmp_path / "one").values())


def test_the_dry_run_counts_and_writes_nothing(adt_tree: Path, tmp_path: Path) -> None:
    before = sorted(adt_tree.rglob("*"))
    plan = plan_build("adt", adt_tree)
    assert len(plan.recordings) == 2
    assert plan.input_bytes > 1e6
    assert plan.estimated_seconds > 0
    assert sorted(adt_tree.rglob("*")) == before
    assert len(plan_build("adt", adt_tree, BuildOptions(recordings="*seq001*")).recordings) == 1
    assert list(tmp_path.iterdir()) == []


def test_known_bad_and_damaged_recordings_are_named_and_the_others_built(adt_tree: Path, tmp_path: Path) -> None:
    copy = tmp_path / "tree"
    shutil.copytree(adt_tree, copy)
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


ROOT = Path(__file__).parents[2]


def start(out: Path, workers: int = 1) -> subprocess.Popen:
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "tests.curation.sources", str(out), str(workers)]
    return subprocess.Popen(command, cwd=ROOT, env=environment)


def finished_parts(out: Path) -> int:
    work = work_folder(out)
    return len([path for path in work.iterdir() if not path.name.startswith(".")]) if work.is_dir() else 0


def kill_after(process: subprocess.Popen, out: Path, parts: int, delay: float) -> None:
    """Kill a build some time after it has finished so many parts."""
    while process.poll() is None and finished_parts(out) < parts:
        time.sleep(0.002)
    time.sleep(delay)
    process.send_signal(signal.SIGKILL)
    process.wait()


@pytest.mark.slow
def test_killed_with_workers_it_leaves_none_of_them_at_work(tmp_path: Path) -> None:
    out = tmp_path / "adt"
    kill_after(start(out, workers=2), out, parts=2, delay=0.0)
    time.sleep(0.5)
    left = finished_parts(out)
    time.sleep(0.5)
    assert 2 <= finished_parts(out) == left < 8
    assert start(out, workers=2).wait() == 0
    build_from_sources(some_sources(8), tmp_path / "undisturbed")
    assert folder_bytes(out) == folder_bytes(tmp_path / "undisturbed")


class Interrupted(Exception):
    """Stands for a kill between two recordings."""


def interrupt_after(parts: int):
    def progress(done, total, last) -> None:
        if done == parts:
            raise Interrupted

    return progress


def interrupted_build(out: Path, sources: list[SceneSource], parts: int) -> None:
    try:
        build_from_sources(sources, out, progress=interrupt_after(parts))
    except Interrupted:
        return
    raise AssertionError("the build was not interrupted")


def test_only_what_is_missing_or_changed_is_curated_again(tmp_path: Path) -> None:
    interrupted_build(tmp_path / "whole", some_sources(5), 3)
    assert build_from_sources(some_sources(5), tmp_path / "whole").reused == 3
    interrupted_build(tmp_path / "adt", some_sources(5), 3)
    changed = some_sources(5)
    changed[1] = SceneSource("room_1", version=7)
    report = build_from_sources(changed, tmp_path / "adt")
    assert report.reused == 2
    build_from_sources(changed, tmp_path / "afresh")
    assert folder_bytes(tmp_path / "adt") == folder_bytes(tmp_path / "afresh")


def test_half_written_folders_of_this_dataset_are_removed_and_of_others_kept(tmp_path: Path) -> None:
    kept = [tmp_path / ".adt-2-abcdefgh.partial", tmp_path / ".adtx-abcdefgh.partial", tmp_path / "adt-2"]
    removed = tmp_path / ".adt-abcd_123.partial"
    for folder in (*kept, removed):
        folder.mkdir()
    build_from_sources(some_sources(1), tmp_path / "adt")
    assert not removed.exists()
    assert all(folder.exists() for folder in kept)


def make_shards(folder: Path, sources, count: int, **settings) -> list[Path]:
    folders = [folder / f"shard-{number}" for number in range(1, count + 1)]
    for number, out in enumerate(folders, start=1):
        build_shard_from_sources(sources, out, Shard(number, count), **settings)
    return folders


def merged(folders: list[Path], out: Path, *, replace: bool = False) -> Path:
    merge_dataset_shards(require_whole(folders), out, replace=replace)
    return out


def test_a_shard_that_was_interrupted_goes_on(tmp_path):
    class Interrupted(Exception):
        pass

    def stop(*step) -> None:
        raise Interrupted

    build_from_sources(some_sources(5), tmp_path / "whole")
    folders = make_shards(tmp_path, some_sources(5), 2)
    again = tmp_path / "again"
    with pytest.raises(Interrupted):
        build_shard_from_sources(some_sources(5), again, Shard(1, 2), progress=stop)
    with pytest.raises(ShardError, match=r"again: shard 1/2 is not finished. Run its command \(--shard 1/2\) again"):
        merged([again, folders[1]], tmp_path / "early")
    assert not (tmp_path / "early").exists()
    assert build_shard_from_sources(some_sources(5), again, Shard(1, 2)).reused == 1
    assert folder_bytes(again) == folder_bytes(folders[0])
    assert folder_bytes(merged([again, folders[1]], tmp_path / "merged")) == folder_bytes(tmp_path / "whole")


def test_what_failed_is_tried_again_and_what_changed_is_made_anew(tmp_path):
    broken = [SceneSource("a", problem="file"), SceneSource("b", version=1)]
    build_shard_from_sources(broken, tmp_path / "shard", Shard(1, 1))
    mended = [SceneSource("a"), SceneSource("b", version=2)]
    assert build_shard_from_sources(mended, tmp_path / "shard", Shard(1, 1)).reused == 0
    build_from_sources(mended, tmp_path / "whole")
    assert len(list((tmp_path / "shard" / "parts").iterdir())) == 2
    assert folder_bytes(merged([tmp_path / "shard"], tmp_path / "merged")) == folder_bytes(tmp_path / "whole")


def test_a_folder_of_something_else_is_no_shard(tmp_path):
    build_from_sources(some_sources(1), tmp_path / "table")
    with pytest.raises(StorageError, match=r"holds no shard.json, so it is no shard"):
        build_shard_from_sources(some_sources(1), tmp_path / "table", Shard(1, 1))
    build_shard_from_sources(some_sources(2), tmp_path / "shard", Shard(1, 2))
    with pytest.raises(ShardError, match="shard: expected 2/2, found 1/2"):
        build_shard_from_sources(some_sources(2), tmp_path / "shard", Shard(2, 2))
    with pytest.raises(StorageError, match=r"holds no dataset.json"):
        build_from_sources(some_sources(2), tmp_path / "shard")


def test_nodes_that_see_other_recordings_are_named(tmp_path):
    one, two = tmp_path / "one", tmp_path / "two"
    build_shard_from_sources(some_sources(3), one, Shard(1, 2))
    build_shard_from_sources(some_sources(2), two, Shard(2, 2))
    with pytest.raises(ShardError, match=r"two.shard.json, plan: expected 3 items, found 2, without 'room_2'"):
        merged([one, two], tmp_path / "merged")


def test_nodes_with_other_options_are_named(tmp_path):
    one, two = tmp_path / "one", tmp_path / "two"
    build_shard_from_sources(some_sources(2), one, Shard(1, 2))
    options = BuildOptions(CurationOptions(in_hand="wrist"))
    build_shard_from_sources(some_sources(2), two, Shard(2, 2), options=options)
    with pytest.raises(ShardError, match=r"options.curation.in_hand: expected nothing, found wrist, unlike .*one"):
        merged([one, two], tmp_path / "merged")


@pytest.mark.parametrize("damage", ["truncated", "one bit", "gone"])
def test_a_damaged_file_of_a_shard_is_named(tmp_path, damage):
    folders = make_shards(tmp_path, some_sources(2), 2)
    file = next((folders[1] / "parts").glob("*/sequences.arrow"))
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    if damage == "gone":
        file.unlink()
    else:
        file.write_bytes(bytes(content) if damage == "one bit" else file.read_bytes()[:-9])
    with pytest.raises(ShardError, match=r"sequences.arrow: expected the file that shard 2/2 has written"):
        merged(folders, tmp_path / "merged")
    assert not (tmp_path / "merged").exists()


def test_a_list_of_parts_that_is_not_the_shards_is_refused(tmp_path):
    one, two = make_shards(tmp_path, some_sources(4), 2)
    (two / "finished.json").write_bytes((one / "finished.json").read_bytes())
    with pytest.raises(ShardError, match="does not list the parts of shard 2/2"):
        merged([one, two], tmp_path / "merged")


def test_a_merge_never_replaces_a_table_by_less(tmp_path):
    build_from_sources(some_sources(3), tmp_path / "table")
    before = folder_bytes(tmp_path / "table")
    folders = make_shards(tmp_path, some_sources(2), 2)
    with pytest.raises(RecordingsWouldBeLost, match="room_2"):
        merged(folders, tmp_path / "table")
    assert folder_bytes(tmp_path / "table") == before
    merged(folders, tmp_path / "table", replace=True)
    assert folder_bytes(tmp_path / "table") != before
