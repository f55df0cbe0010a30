"""A conditions file holds exactly what a method may see; the method on the page turns it into scores."""

from __future__ import annotations

import ast
import json
import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import msgspec
import numpy as np
import pytest

from prbench.cli import main
from prbench.contract import GIVEN, Condition
from prbench.errors import RedistributionError, TableError, UsageError
from prbench.harness.conditions import opaque_ids, run_salt
from prbench.harness.offline import ExportRequest, export_conditions, read_conditions_file
from prbench.harness.run_folder import DatasetSummary
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
        "max_frames": 110, "native_fps": None, "protocol_version": 4,
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


PAGE = (Path(__file__).parents[3] / "docs/offline.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def shown() -> str:
    (code,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    return code


def test_the_method_needs_numpy_only_and_an_old_python_will_do(shown):
    tree = ast.parse(shown, feature_version=(3, 8))
    imported = [name.name for node in ast.walk(tree) if isinstance(node, ast.Import) for name in node.names]
    assert imported == ["numpy"]
    assert not [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]


def test_the_method_goes_from_conditions_to_scores(shown, table, tmp_path, capsys):
    other = fake_dataset(tmp_path / "other", 24, dataset="synthetic-gimo")
    data = ["--data", str(table.folder), str(other.folder)]
    conditions, predictions, out = (str(tmp_path / name) for name in ("conditions.npz", "predictions.npz", "scores"))
    exported = ["export-conditions", *data, "--condition", "goal-loc", "--samples", "3", "--out", conditions]
    assert main(exported) == 0
    assert "63 motions to generate" in capsys.readouterr().out

    (tmp_path / "generate.py").write_text(shown)
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    subprocess.run([sys.executable, "generate.py"], cwd=tmp_path, env=environment, check=True)
    assert main(["score", predictions, "--conditions", conditions, *data, "--name", "glide", "--out", out]) == 0
    printed = capsys.readouterr().out
    assert (
        "Made up (synthetic): glide (file predictions.npz), condition goal-loc; 15 sequences of 3 recordings" in printed
    )
    sentence = "These are scores on synthetic data: never compare them with published ones."
    assert printed.count(sentence) == 2
    assert main(["run", "--method", "ground-truth", *data[:2], "--limit", "3", "--out", str(tmp_path / "one")]) == 0
    assert capsys.readouterr().out.count(sentence) == 1
    for dataset in ("synthetic-adt", "synthetic-gimo"):
        summary = DatasetSummary.read(tmp_path / "scores" / dataset)
        assert (summary.method, summary.condition, summary.samples) == ("glide", "goal-loc", 3)
    with np.load(predictions) as made, np.load(conditions) as given:
        assert np.array_equal(made["joints"][:, 0], given["initial_joints"])


def test_the_page_lists_the_arrays_that_there_are(table, tmp_path):
    for condition in ("goal-loc", "goal-pose"):
        path = tmp_path / f"{condition}.npz"
        assert (
            main(["export-conditions", "--data", str(table.folder), "--condition", condition, "--out", str(path)]) == 0
        )
        with np.load(path) as arrays:
            assert all(f"`{name}`" in PAGE for name in arrays.files)


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["export-conditions", "--condition", "none", "--out", "{tmp}/c.csv"], 2, "ends in .npz"),
        (["score", "{tmp}/gone.npz"], 6, "gone.npz: expected an .npz file, found no file"),
        (["score", "{tmp}/gone.npz", "--conditions", "{tmp}/none.npz"], 3, "none.npz: expected an .npz file"),
        (["score", "{tmp}", "--name", " "], 2, "--name: expected a name of 1 to 100 characters"),
    ],
)
def test_a_mistake_gives_one_line_and_its_exit_code(table, tmp_path, capsys, arguments, code, message):
    words = [word.format(tmp=tmp_path) for word in arguments]
    assert main([*words, "--data", str(table.folder)]) == code
    errors = capsys.readouterr().err.strip().splitlines()
    assert len(errors) == 1
    assert message in errors[0]
