"""Run, score, compare: the values of the commands, and their messages."""

from __future__ import annotations

import contextlib
import inspect
import re

import numpy as np
import pandas as pd
import pytest

import prbench
from prbench.contract import Condition
from prbench.harness.run_folder import DatasetSummary
from prbench.harness.score_predictions import ScoreRequest, score_predictions
from prbench.metrics import MAIN_METRICS


@pytest.fixture(scope="module")
def motions(runs) -> dict[str, np.ndarray]:
    return {name: runs[1].motion(name) for name in runs[1].to_pandas().sequence_id.unique()}


def test_a_run_has_summary_scores_and_motions(table, runs):
    run = runs[1]
    assert run.method == "scripted"
    assert run.datasets == ("synthetic-adt",)
    assert run.folder.name == "scripted"
    assert isinstance(run.summary, pd.DataFrame)
    stored = DatasetSummary.read(run.folder / "synthetic-adt")
    assert run.summaries == (stored,)
    assert run.summary["mean"].tolist() == [metric.mean for metric in stored.metrics]
    scores = run.to_pandas()
    assert list(scores) == ["sequence_id", "dataset", "sample", "metric", "value", "flag"]
    assert scores.sequence_id.nunique() == 6
    means = scores.groupby("metric").value.mean()
    for row in run.summary.itertuples():
        assert row.mean == pytest.approx(means[row.metric])
    name = scores.sequence_id[0]
    motion = run.motion(name)
    assert motion.shape == table.sequence(name).joints.shape
    assert not motion.flags.writeable
    np.testing.assert_array_equal(runs[0].motion(name), table.sequence(name).joints)


def test_a_run_notes_what_the_command_notes(table, runs):
    assert runs[0].notes == ()
    again = prbench.run("scripted", condition="goal-loc", data=table, limit=6, out=runs[1].folder)
    assert again.notes == ("1 batches were taken over from an earlier run.",)
    assert again.notes[0] in again._repr_html_()


def test_an_opened_run_is_the_run(runs):
    for path in (runs[1].folder, str(runs[1].folder)):
        opened = prbench.open_run(path)
        assert opened.record == runs[1].record
        pd.testing.assert_frame_equal(opened.to_pandas(), runs[1].to_pandas())
        pd.testing.assert_frame_equal(opened.summary, runs[1].summary)
    assert runs[1].tables
    assert prbench.open_run(runs[1].folder).tables == ()


def test_a_motionless_method_gets_no_foot_skating(table, tmp_path):
    run = prbench.run("static", data=table, limit=3, out=tmp_path / "static")
    assert "foot_skating" not in set(run.summary.metric)
    assert "Foot Skating" not in run._repr_html_()


def test_options_and_single_values(table, tmp_path):
    name = table.sequence_ids(split="test")[0]
    run = prbench.run("ground-truth", data=[table], sequence=name, samples=2, out=tmp_path / "one")
    assert run.to_pandas()["sample"].unique().tolist() == [0, 1]
    assert run.motion(name, sample=1).shape == run.motion(name).shape
    with pytest.raises(prbench.PrbenchError, match="expected a sample from 0 to 1, found 2"):
        run.motion(name, sample=2)
    with pytest.raises(prbench.PrbenchError, match="no sequence 'elsewhere' among the 1 of"):
        run.motion("elsewhere")


def test_without_data_the_embedded_tables_are_run(table, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("prbench.api.runs.embedded_tables", lambda workers: (table,))
    run = prbench.run("ground-truth")
    assert run.record.limit == 10
    assert run.record.tables[0].batch_plan.batch_size == 5
    assert run.folder.parent.name == "runs"
    name = table.sequence_ids(split="test")[0]
    assert prbench.run("ground-truth", sequence=name).record.limit is None


@pytest.mark.parametrize(
    ("method", "changes", "message"),
    [
        ("sttic", {}, "adapter 'sttic' is not installed. Did you mean 'static'"),
        ("static", {"condition": "goal_loc"}, "unknown condition 'goal_loc'.*Did you mean 'goal-loc'"),
        ("static", {"split": "tst"}, "unknown split 'tst'"),
        ("static", {"limit": 0}, "limit: expected a whole number of at least 1, found '0'"),
        ("static", {"option": "a=b"}, "option: expected a dict"),
        ("static", {"control": "other"}, "unknown control 'other'"),
        ("scripted", {"option": {"a": 1}}, "takes neither --weights nor --option"),
        ("all", {}, "'all' stands for many runs"),
        ("static", {"condition": "all"}, "'all' stands for many runs"),
        ("static", {"data": "nowhere"}, "nowhere: expected a built dataset"),
    ],
)
def test_a_run_that_cannot_be_is_refused_as_on_the_command_line(table, tmp_path, method, changes, message):
    with pytest.raises(prbench.PrbenchError, match=message):
        prbench.run(method, **({"data": table, "out": tmp_path / "run"} | changes))
    assert not (tmp_path / "run").exists()


def test_an_unfinished_run_says_so(runs, tmp_path):
    (tmp_path / "run.json").write_bytes((runs[0].folder / "run.json").read_bytes())
    run = prbench.open_run(tmp_path)
    assert "not finished" in repr(run)
    with pytest.raises(prbench.PrbenchError, match="the run is not finished"):
        _ = run.summary
    with pytest.raises(prbench.PrbenchError, match="expected a run folder"):
        prbench.open_run(tmp_path / "nowhere")


def test_a_dictionary_is_scored_as_its_file_is(table, runs, motions, tmp_path):
    scores = prbench.score(motions, table, limit=6, name="mine", condition="goal-loc", out=tmp_path / "mine")
    values = scores.to_pandas().drop(columns="flag")
    pd.testing.assert_frame_equal(values, runs[1].to_pandas().drop(columns="flag"))
    lengths = np.array([len(motion) for motion in motions.values()])
    joints = np.concatenate(list(motions.values()))
    np.savez(tmp_path / "mine.npz", sequence_id=np.array(list(motions)), n_frames=lengths, joints=joints)
    request = ScoreRequest(
        predictions=tmp_path / "mine.npz", data=(table.folder,), limit=6, condition=Condition.GOAL_LOCATION
    )
    (report,) = score_predictions(request)
    assert report.scores["value"].to_pylist() == values.value.tolist()
    assert scores.summaries[0].method == report.summary.method == "mine"
    assert scores.folder == tmp_path / "mine"
    assert {path.name for path in scores.folder.rglob("*")} >= {"run.json", "scores.parquet", "summary.json"}
    assert prbench.open_run(scores.folder).record.method.kind == "file"
    again = prbench.score(tmp_path / "mine.npz", str(table.folder), limit=6, condition="goal-loc")
    pd.testing.assert_frame_equal(again.to_pandas(), scores.to_pandas())
    pd.testing.assert_frame_equal(prbench.score(runs[1].folder, [table]).to_pandas().drop(columns="flag"), values)


def test_other_forms_of_motions_get_the_same_scores(table, motions):
    expected = prbench.score(motions, table, limit=6).to_pandas()
    flat = {name: motion.reshape(-1, 66).astype(np.float64) for name, motion in reversed(motions.items())}
    pd.testing.assert_frame_equal(prbench.score(flat, table, limit=6).to_pandas(), expected)
    twice = prbench.score(
        {name: np.stack([motion] * 2) for name, motion in motions.items()}, table, limit=6
    ).to_pandas()
    for sample in (0, 1):
        assert twice[twice["sample"] == sample].value.tolist() == expected.value.tolist()
    torch = pytest.importorskip("torch")
    tensors = {name: torch.tensor(motion) for name, motion in motions.items()}
    pd.testing.assert_frame_equal(prbench.score(tensors, table, limit=6).to_pandas(), expected)


def _without_first(motions):
    return dict(list(motions.items())[1:])


def _renamed(motions):
    return {**_without_first(motions), "synthetic-adt/x": next(iter(motions.values()))}


def _changed(change):
    def make(motions):
        first = next(iter(motions))
        return {**motions, first: change(motions[first])}

    return make


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (_without_first, r"expected the 6 test sequences of synthetic-adt, found 5: missing 1 \(.*test is scored"),
        (_renamed, r"missing 1 \(synthetic-adt/rec.*unknown 1 \(synthetic-adt/x\)"),
        (lambda motions: {}, "found none"),
        (lambda motions: dict(enumerate(motions.values())), "expected sequence ids as keys, found 0"),
        (_changed(lambda motion: motion[:-1]), "frames, found .*There is one frame too few"),
        (_changed(lambda motion: motion[:, :5]), r"\(n, 22, 3\) of metres.*found the shape \(\d+, 5, 3\)"),
        (_changed(lambda motion: motion[:0]), "expected a motion, found no frames"),
        (_changed(lambda motion: motion[:1]), "frames, found 1"),
        (_changed(lambda motion: motion * np.nan), "frame 0: expected finite positions"),
        (_changed(lambda motion: motion * 1000), "positions are in millimetres"),
        (_changed(lambda motion: "text"), "found str"),
        (_changed(lambda motion: None), r"found the shape \(\)"),
    ],
)
def test_motions_that_cannot_be_scored_are_named(table, motions, make, message):
    with pytest.raises(prbench.PrbenchError, match=message):
        prbench.score(make(motions), table, limit=6)


def test_scores_that_follow_are_compared(table, runs, motions, tmp_path):
    scores = prbench.score(motions, table, limit=6, name="mine", out=tmp_path / "mine")
    found = prbench.compare(runs[0], scores)
    assert (found.first, found.second) == (runs[0].folder, tmp_path / "mine")
    frame = found.to_pandas()
    assert set(frame.metric) <= {info.id for info in MAIN_METRICS}
    assert (frame.set_index("metric").difference.loc["mpjpe"]) < 0
    assert len(found.summary.splitlines()) == len(frame)
    assert "MPJPE" in found._repr_html_()
    assert [line for line in found.unverified if "mine" in line]
    assert prbench.compare(str(runs[0].folder), runs[1].folder, data=table).unverified == ()
    assert prbench.compare(*runs).unverified == (), "runs remember their tables"
    with pytest.raises(prbench.PrbenchError, match="were not written: give score"):
        prbench.compare(runs[0], prbench.score(motions, table, limit=6))


def test_results_show_themselves(table, runs, motions):
    for shown in (*runs, prbench.score(motions, table, limit=6), prbench.compare(*runs)):
        assert "<table" in shown._repr_html_()
    assert "never compare them with published ones" in runs[0]._repr_html_()


def test_pictures_of_a_run(table, runs, tmp_path):
    name = table.sequence_ids(split="test", limit=6)[0]
    picture = runs[1].plot(name)
    assert picture._repr_png_().startswith(b"\x89PNG")
    assert [scene.sequence_id for scene in picture.scenes] == [name]
    assert len(runs[1].plot(limit=2).scenes) == 2
    opened = prbench.open_run(runs[1].folder)
    assert opened.plot(name, data=table.folder).png == picture.png
    assert picture.save(str(tmp_path / "run.png")).read_bytes() == picture.png
    kinds = r"expected a file that ends in \.html, \.png, \.svg, \.pdf or \.mp4"
    with pytest.raises(prbench.PrbenchError, match=kinds):
        picture.save(tmp_path / "run.jpg")
    with pytest.raises(prbench.PrbenchError, match="no sequence 'elsewhere'"):
        runs[1].plot("elsewhere")
    with pytest.raises(TypeError, match=r"'sequences'; its parameters are: sequence, data, limit, sample, permission"):
        opened.plot(sequences=name)
    with pytest.raises(prbench.PrbenchError, match="data=FOLDER"):
        opened.plot(limit=1)


_COMMANDS = [
    (("build-dataset",), prbench.build_dataset),
    (("synthesize",), prbench.synthesize),
    (("run",), prbench.run),
    (("score",), prbench.score),
    (("view",), prbench.Run.plot),
    (("leaderboard", "compare"), prbench.compare),
]


@pytest.mark.parametrize(("command", "function"), _COMMANDS, ids=[command[-1] for command, _ in _COMMANDS])
def test_arguments_are_options_of_the_command(command, function, capsys, monkeypatch):
    from prbench.cli import main

    monkeypatch.setenv("COLUMNS", "200")
    with contextlib.suppress(SystemExit):
        main([*command, "--help"])
    options = set(re.findall(r"--([a-z][a-z-]+)", capsys.readouterr().out))
    keywords = {
        name.replace("_", "-")
        for name, argument in inspect.signature(function).parameters.items()
        if argument.kind is inspect.Parameter.KEYWORD_ONLY
    }
    assert keywords
    assert keywords - options == set()
