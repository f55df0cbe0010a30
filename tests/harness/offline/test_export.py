"""A conditions file holds exactly what a method may see: the columns, the values, and nothing that names the data."""

from __future__ import annotations

import json
import zipfile

import msgspec
import numpy as np
import pytest

from prbench.contract import GIVEN, Condition
from prbench.errors import RedistributionError, TableError, UsageError
from prbench.harness.conditions import opaque_ids, run_salt
from prbench.harness.offline import ExportRequest, export_conditions, read_conditions_file
from prbench.randomness import noise_seed
from prbench.sequences import DatasetInfo
from tests.fakes import fake_dataset, fake_sequence
from tests.harness.offline.method import batches_of

ALWAYS = {"opaque_id", "sample", "noise_seed", "n_frames", "fps"}


@pytest.fixture(scope="module")
def other(tmp_path_factory):
    return fake_dataset(tmp_path_factory.mktemp("other") / "table", 24, dataset="synthetic-gimo")


def export(tables, out, condition="goal-loc", **changes):
    folders = tuple(table.folder for table in tables)
    return export_conditions(ExportRequest(data=folders, condition=Condition(condition), out=out, **changes))


def with_terms(table, redistribution):
    msgspec.structs.replace(DatasetInfo.read(table.folder), redistribution=redistribution).write(table.folder)
    return table


@pytest.mark.parametrize("condition", Condition)
def test_the_columns_are_those_of_the_condition_and_no_others(table, tmp_path, condition):
    export([table], tmp_path / "c.npz", condition)
    expected = ALWAYS | GIVEN[condition]
    with np.load(tmp_path / "c.npz") as arrays:  # pickles are off by default
        assert set(arrays.files) == expected | {"prbench_conditions"}
        assert {name: arrays[name].dtype.kind for name in ALWAYS} == {
            "opaque_id": "U", "sample": "i", "noise_seed": "i", "n_frames": "i", "fps": "f",
        }  # fmt: skip


def test_the_file_says_how_it_was_made_and_nothing_more(table, other, tmp_path):
    path = tmp_path / "c.npz"
    export([table, other], path, seed=3, samples=2, limit=5, max_frames=110)
    with np.load(path) as arrays:
        text = str(arrays["prbench_conditions"])
    said = json.loads(text)
    tables = said.pop("tables")
    assert said == {
        "format_version": 1, "condition": "goal-loc", "seed": 3, "samples": 2, "split": "test", "limit": 5,
        "max_frames": 110, "native_fps": None, "protocol_version": 2,
    }  # fmt: skip
    assert len(tables) == 2
    assert all(len(digest) == 64 for digest in tables)
    assert not {table.identity, other.identity} & set(tables), (
        "else whoever knows the ids has the key of the opaque ones"
    )


def test_nothing_in_the_file_names_dataset_recording_object_or_folder(table, other, tmp_path):
    path = tmp_path / "c.npz"
    export([table, other], path, "goal-pose")
    with zipfile.ZipFile(path) as archive:
        names = " ".join(archive.namelist()).encode()
        content = names + b"".join(archive.read(name).replace(b"\0", b"") for name in archive.namelist())
    assert b"goal-pose" in content, "the search looks at what is there"
    for told in ("synthetic", "rec001", "450846385587", "WoodenBowl", "fake", str(tmp_path), str(table.folder.parent)):
        assert told.encode() not in content


def test_values_are_those_of_the_sequences(table, tmp_path):
    path = tmp_path / "c.npz"
    export([table], path, "goal-pose", seed=9, samples=2)
    conditions = read_conditions_file(path)
    truths = [fake_sequence(index) for index in range(60)]
    truths = [truth for truth in truths if truth.split == "test"]
    names = opaque_ids([truth.sequence_id for truth in truths], run_salt(9, table.identity))
    truth_of = dict(zip(names, truths))
    assert len(conditions) == 30
    for row, (name, sample) in enumerate(zip(conditions.opaque_id, conditions.sample)):
        truth = truth_of[name]
        assert conditions.noise_seed[row] == noise_seed(9, truth.sequence_id, int(sample))
        assert (conditions.n_frames[row], conditions.fps[row], conditions.text[row]) == (
            truth.n_frames,
            20.0,
            truth.text,
        )
        assert np.array_equal(conditions.initial_joints[row], truth.joints[0])
        assert np.array_equal(conditions.previous_joints[row], truth.previous_joints)
        assert np.array_equal(conditions.goal_joints[row], truth.joints[-1])


def test_rows_of_all_tables_stand_by_opaque_id_then_sample(table, other, tmp_path):
    report = export([table, other], tmp_path / "c.npz", "none", samples=3)
    rows = read_conditions_file(tmp_path / "c.npz")
    keys = list(zip(rows.opaque_id, rows.sample.tolist()))
    assert keys == sorted(keys)
    assert len(keys) == report.rows == 3 * (15 + 6)
    assert report.sequences == {"synthetic-adt": 15, "synthetic-gimo": 6}


def test_split_limit_and_max_frames_choose_as_a_run_does(table, tmp_path):
    assert export([table], tmp_path / "a.npz", split="validation").sequences == {"synthetic-adt": 15}
    assert export([table], tmp_path / "b.npz", limit=4).rows == 4
    report = export([table], tmp_path / "c.npz", max_frames=80)
    conditions = read_conditions_file(tmp_path / "c.npz")
    assert 0 < len(conditions) < 15
    assert conditions.n_frames.max() <= 80
    assert report.left_out == {"synthetic-adt": 15 - len(conditions)}


def test_batches_are_what_a_method_gets_and_never_repeat_a_sequence(table, tmp_path):
    export([table], tmp_path / "c.npz", samples=2)
    batches = [batch for _, batch in batches_of(read_conditions_file(tmp_path / "c.npz"), 4)]
    assert [len(batch) for batch in batches] == [4, 4, 4, 3] * 2
    for batch in batches:
        assert len(set(batch.opaque_id)) == len(batch)
        assert all(isinstance(seed, int) for seed in batch.noise_seed)
    assert {seed for batch in batches[:4] for seed in batch.noise_seed}.isdisjoint(
        seed for batch in batches[4:] for seed in batch.noise_seed
    )


@pytest.mark.parametrize(("condition", "said"), [("none", 0), ("text", 0), ("goal-loc", 1)])
def test_only_recorded_poses_come_with_the_terms_of_their_dataset(tmp_path, condition, said):
    report = export([with_terms(fake_dataset(tmp_path / "t", 12), "non-commercial")], tmp_path / "c.npz", condition)
    assert ["non-commercial" in notice for notice in report.notices] == [True] * said
    assert [path.read_text() for path in tmp_path.glob("c.NOTICE.txt")] == [f"{each}\n" for each in report.notices]


@pytest.mark.parametrize("condition", ["goal-loc", "goal-pose"])
def test_terms_that_keep_recorded_poses_need_permission(tmp_path, condition):
    kept = with_terms(fake_dataset(tmp_path / "t", 12), "none")
    with pytest.raises(RedistributionError, match=r"cmd:.*--permission synthetic-adt"):
        export([kept], tmp_path / "c.npz", condition)
    assert not list(tmp_path.glob("c*"))
    report = export([kept], tmp_path / "c.npz", condition, permitted=["synthetic-adt"])
    assert "by permission" in report.notices[0]
    assert (tmp_path / "c.NOTICE.txt").read_text() == f"{report.notices[0]}\n"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"out": "c.csv"}, r"expected a name that ends in .npz, found '.csv'"),
        ({"condition": "text", "control": "shuffled-goal"}, "condition 'text' gives no goal to shuffle"),
        ({"samples": 0}, "--samples: expected 1 or more, found 0"),
        ({"seed": -1}, "--seed: expected 0 or more"),
        ({"native_fps": float("nan")}, "--native-fps: expected above 0"),
    ],
)
def test_requests_that_do_not_fit_together_are_refused(table, tmp_path, changes, message):
    changes = {"out": "c.npz", **changes}
    out = tmp_path / changes.pop("out")
    with pytest.raises(UsageError, match=message):
        export([table], out, **changes)


def test_a_dataset_given_twice_or_an_empty_split_is_refused(table, tmp_path):
    with pytest.raises(UsageError, match="found synthetic-adt more than once"):
        export([table, table], tmp_path / "c.npz")
    with pytest.raises(TableError, match="expected sequences in split 'test', found none"):
        export([fake_dataset(tmp_path / "t", 4, recordings=1)], tmp_path / "c.npz")
