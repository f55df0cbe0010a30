from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path

import msgspec
import numpy as np
import pytest

from prbench.cli.main import main
from prbench.contract import Condition, Motions
from prbench.errors import AdapterError, InputFileError, PredictionsError, RunError, TableError, UsageError
from prbench.geometry.skeleton import canonical_frame, invert_rigid, transform_points
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.run_folder import PredictionRows, Predictions, RunFolder
from prbench.harness.run_folder.predictions import write_part
from prbench.protocol.manifests import load_protocol
from prbench.representation import encode
from prbench_benchmarks.text_to_motion import evaluate
from prbench_benchmarks.text_to_motion.clips import EvaluatedClips, Pass, draw, recorded_features
from prbench_benchmarks.text_to_motion.evaluate import (
    MISMATCHED,
    REAL,
    TextEvaluationRequest,
    evaluate_text,
    generated_features,
)
from prbench_benchmarks.text_to_motion.networks import EvaluatorConfiguration
from prbench_benchmarks.text_to_motion.report import TextEvaluation
from prbench_benchmarks.text_to_motion.training import load_evaluator
from tests.benchmarks.text_to_motion.corpora import TINY
from tests.benchmarks.text_to_motion.test_training import trained
from tests.cli.reports import plain, refused, reported
from tests.fakes import fake_dataset, smooth_motion

CONFIGURATION = EvaluatorConfiguration(**{key: TINY[key] for key in TINY})  # type: ignore[arg-type]


class Swaying:
    """Moves by text and noise seed alone."""

    name = "swaying"
    conditions = frozenset({Condition.TEXT})
    max_frames = 36
    calls: list[int]

    def __init__(self):
        self.calls = []

    def generate(self, batch, *, seed):
        self.calls.append(len(batch))
        longest = int(batch.n_frames.max())
        joints = [smooth_motion(f"{text}{noise}", 60)[:longest] for text, noise in zip(batch.text, batch.noise_seed)]
        return Motions(np.stack(joints), batch.n_frames)


@pytest.fixture
def swaying(monkeypatch):
    method = Swaying()
    monkeypatch.setattr(evaluate, "load_adapter", lambda *_: method)
    return method


@pytest.fixture
def request_for(build, saved, corpus):
    """A request with an untrained evaluator."""

    def made(**more):
        defaults = {"repetitions": 2, "diversity_pairs": 20}
        return TextEvaluationRequest(evaluator=saved(build()), corpus=corpus.folder, **(defaults | more))

    return made


def test_a_trained_evaluator_ranks_real_pairs_above_shuffled_ones(build, batch, saved, corpus):
    """Trained on eight pairs until it knows them; asked about these and others of the training split."""
    module = build(autoencoder_batches=20)
    trained(module, batch, 80)
    loaded = load_evaluator(saved(module), [corpus])
    features = [batch.features[i, : int(n)].numpy() for i, n in enumerate(batch.n_frames)]
    text, motion = loaded.embed_texts(batch.text), loaded.embed_motions(features)
    own = np.linalg.norm(text - motion, axis=1).mean()
    assert own < 0.7 * np.linalg.norm(text - np.roll(motion, 1, axis=0), axis=1).mean()


def test_an_evaluator_read_from_its_file_embeds_as_it_did_in_training(build, batch, saved, corpus):
    module = build().eval()
    loaded = load_evaluator(saved(module), [corpus])
    assert (loaded.vectorisation, loaded.words_digest) == ("hashed-ngrams", "")
    features = [batch.features[i, : int(n) // 4 * 4].numpy() for i, n in enumerate(batch.n_frames)]
    counts = batch.n_frames // 4
    standardised = (batch.features - module.mean) / module.std
    snippets = module.movement(standardised[..., :259][:, : int(counts.max()) * 4], counts * 4)
    expected = module.motion(snippets, counts).detach().numpy()
    np.testing.assert_allclose(loaded.embed_motions(features), expected, atol=1e-5)


def test_recorded_motions_and_a_method_get_their_rows(request_for, swaying, tmp_path):
    result = evaluate_text(request_for(method="swaying", batch_size=16, prompts=34, seed=3))
    assert [row.source for row in result.rows] == [REAL, MISMATCHED, "swaying"]
    real, mismatched, made = result.rows
    pairs = {"r_precision_top_1", "r_precision_top_2", "r_precision_top_3", "multimodal_distance"}
    assert set(real.metrics) == set(made.metrics) == pairs | {"fid", "diversity"}
    assert set(mismatched.metrics) == pairs
    assert (real.motions, real.ranked_pairs, real.dropped_pairs) == (44, 32, 12)
    assert (made.motions, made.ranked_pairs, made.dropped_pairs) == (34, 32, 2)
    assert (made.unsupported, result.clips) == (8, 44)  # of 40 frames or more
    assert made.metrics["fid"].mean > real.metrics["fid"].mean > 0
    assert all(len(metric.values) == 2 for row in result.rows for metric in row.metrics.values())
    assert result.vectorisation == "hashed-ngrams"
    assert any("biased upwards" in note for note in result.notes)
    result.write(tmp_path / "out.json")
    assert TextEvaluation.read(tmp_path / "out.json") == result


def test_the_same_request_gives_the_same_numbers_whatever_the_batches(request_for, swaying):
    first, second = (evaluate_text(request_for(method="swaying", batch_size=size, prompts=34)) for size in (7, 34))
    for name, metric in first.rows[-1].metrics.items():
        assert metric.mean == pytest.approx(second.rows[-1].metrics[name].mean, rel=1e-4)
    other = evaluate_text(request_for(seed=1))
    assert other.rows[0].metrics["multimodal_distance"] != first.rows[0].metrics["multimodal_distance"]


def test_multimodality_takes_thirty_motions_of_each_text(request_for, swaying, monkeypatch):
    monkeypatch.setattr("prbench_benchmarks.text_to_motion.metrics.MULTIMODALITY_PROMPTS", 3)
    result = evaluate_text(request_for(method="swaying", multimodality=True, repetitions=1))
    assert result.rows[-1].metrics["multimodality"].mean > 0
    assert sum(swaying.calls) == 36 + 3 * 30
    assert "multimodality" not in result.rows[0].metrics


def test_retrieval_is_measured_where_asked_for_and_stands_in_the_file(request_for, swaying, tmp_path):
    result = evaluate_text(request_for(method="swaying", prompts=36, retrieval=True))
    for row in result.rows:
        n = row.motions
        keys = [(found.query, found.candidates, found.hit) for found in row.retrieval]
        assert keys == [(query, many, hit) for many in (32, n) for query in ("text", "motion")
                        for hit in ("own", "same caption")]  # fmt: skip
        assert row.retrieval[0].r_at_1 == row.metrics["r_precision_top_1"]
        assert all(len(found.median_rank.values) == 2 for found in row.retrieval)
    result.write(tmp_path / "out.json")
    assert TextEvaluation.read(tmp_path / "out.json") == result
    assert evaluate_text(request_for()).rows[0].retrieval == ()


@pytest.fixture
def run_of(tmp_path):
    """Make a run whose motions are the given ones: one each of the first sequences of a small table."""

    def made(motions):
        data = fake_dataset(tmp_path / "table")
        about = {"limit": len(motions), "data": (data.folder,), "out": tmp_path / "run"}
        asked = RunRequest(method="static", condition=Condition.NONE, **about)
        folder = run_method(asked).folder
        files = folder.dataset("synthetic-adt")
        ids = sorted(Predictions.open(files.predictions).ids)
        for part in files.predictions.glob("*.parquet"):
            part.unlink()
        lengths = [len(joints) for joints in motions]
        rows = PredictionRows(np.concatenate(motions), np.cumsum([0, *lengths]))
        write_part(files.part(0), ids, [[0] * len(ids)], [rows], protocol_version=1)
        return folder.path, ids

    return made


def end_embedded(evaluator, joints):
    """The oracle: the last frames, at most 60 and a multiple of 4, made canonical, encoded, embedded."""
    kept = joints[len(joints) - min(len(joints), 60) // 4 * 4 :].astype(np.float64)
    kept = transform_points(invert_rigid(canonical_frame(kept)), kept).astype(np.float32)
    return evaluator.embed_motions([generated_features(kept, evaluator.configuration, name="x")])[0]


def test_the_clips_nearest_to_the_ends_of_a_runs_motions_are_named_in_order(request_for, corpus, run_of):
    clips = EvaluatedClips.read(corpus.folder, split="test", kinds=frozenset(), fps=20.0).clips
    copied = clips[19].motion.joints  # of 43 frames: the first three are left out
    reach = smooth_motion("reach", 57)
    # The same end behind frames that the evaluator cannot take any more.
    longer = np.concatenate([smooth_motion("something else", 31), smooth_motion("end", 60)])
    run, ids = run_of([copied, reach, longer, longer[-60:]])
    request = request_for(nearest=run, neighbours=44)
    result = evaluate_text(request)
    assert (result.rows, len(result.nearest)) == ((), 4 * 44)
    near = [result.nearest[start : start + 44] for start in range(0, 4 * 44, 44)]
    assert [each[0].sequence_id for each in near] == ids
    assert all([one.rank for one in each] == list(range(1, 45)) for each in near)
    assert near[0][0].clip == clips[19].sequence_id
    assert near[0][0].texts == clips[19].texts
    assert near[0][0].distance == pytest.approx(0.0, abs=1e-5)
    assert near[0][1].distance > 1e-3
    evaluator = load_evaluator(request.evaluator, [corpus])
    recorded = np.stack([end_embedded(evaluator, clip.motion.joints) for clip in clips])
    for each, joints in zip(near[1:], [reach, longer, longer]):
        expected = np.linalg.norm(recorded - end_embedded(evaluator, joints), axis=1)
        np.testing.assert_allclose([one.distance for one in each], np.sort(expected), atol=1e-5)
        np.testing.assert_allclose(expected[[int(one.clip[-3:]) for one in each]], np.sort(expected), atol=1e-5)
    assert [(one.clip, one.texts) for one in near[2]] == [(one.clip, one.texts) for one in near[3]]
    assert "4 motions of static, 1 of them longer than the 60 frames" in result.notes[0]
    few = evaluate_text(request_for(nearest=run, limit=2))
    assert [one.sequence_id for one in few.nearest] == [ids[0]] * 3 + [ids[1]] * 3


def test_runs_whose_motions_cannot_be_compared_are_refused(request_for, run_of, monkeypatch, tmp_path):
    run, ids = run_of([smooth_motion("short", 3), smooth_motion("reach", 40)])
    with pytest.raises(PredictionsError, match=f"{re.escape(ids[0])}: expected 4 frames or more, found 3"):
        evaluate_text(request_for(nearest=run))
    with pytest.raises(RunError, match="expected a run folder"):
        evaluate_text(request_for(nearest=tmp_path / "table"))
    other = msgspec.structs.replace(load_protocol(), fps=30.0)
    with monkeypatch.context() as patched:
        patched.setattr(RunFolder, "protocol", other)
        with pytest.raises(RunError, match=r"expected motions of 20 frames per second, .*, found 30"):
            evaluate_text(request_for(nearest=run))
    for part in (run / "synthetic-adt" / "predictions").iterdir():
        part.unlink()
    with pytest.raises(RunError, match="expected the predictions of a run, found none"):
        evaluate_text(request_for(nearest=run))


def test_the_command_prints_the_nearest_clips_in_place_of_metrics(build, saved, corpus, run_of, tmp_path, capsys):
    run, _ = run_of([smooth_motion("reach", 40)])
    path, out = saved(build()), tmp_path / "near.json"
    command = ["evaluate-text", "--evaluator", str(path), "--corpus", str(corpus.folder), "--out", str(out)]
    assert main([*command, "--nearest", str(run), "--neighbours", "2"]) == 0
    printed = capsys.readouterr().out
    near = TextEvaluation.read(out).nearest
    assert [one.rank for one in near] == [1, 2]
    assert all(text in printed for one in near for text in (one.sequence_id, one.clip, *one.texts))
    assert "R-precision" not in printed
    report = reported([*command, "--nearest", str(run), "--neighbours", "2"], capsys)
    assert plain(report.nearest) == json.loads(out.read_text())["nearest"]
    assert main(["study", "table-s8", str(out)]) == 3
    assert "expected metrics, found none" in capsys.readouterr().err
    for words, message in ((["--nearest", str(run), "--retrieval"], "leave --method"), (["--limit", "2"], "--nearest")):
        assert main([*command, *words]) == 2
        assert message in capsys.readouterr().err


def test_repetitions_default_to_twenty_or_five():
    request = TextEvaluationRequest(evaluator=Path("e"), corpus=Path("c"))
    assert request.chosen_repetitions == 20
    assert dataclasses.replace(request, multimodality=True).chosen_repetitions == 5


def test_captions_of_one_kind_can_be_chosen(corpus):
    clips = EvaluatedClips.read(corpus.folder, split="test", kinds=frozenset({"atomic_action"}), fps=20.0)
    assert all(caption.startswith("C ") for caption in clips.captions())
    with pytest.raises(UsageError, match="there are atomic_action, summary"):
        EvaluatedClips.read(corpus.folder, split="test", kinds=frozenset({"words"}), fps=20.0)


def test_passes_draw_crops_of_four_frame_steps_and_captions_anew(corpus):
    clips = EvaluatedClips.read(corpus.folder, split="test", kinds=frozenset(), fps=20.0).clips
    drawn = [[draw(clip, Pass(0, repetition, "real"), CONFIGURATION) for clip in clips] for repetition in range(3)]
    again = [draw(clip, Pass(0, 0, "real"), CONFIGURATION) for clip in reversed(clips)]
    assert drawn[0] == again[::-1]
    assert drawn[0] != drawn[1]
    for clip, one in zip(clips, drawn[0]):
        whole = clip.motion.n_frames // 4 * 4
        assert one.n_frames in (whole, whole - 4)
        assert 0 <= one.start <= clip.motion.n_frames - one.n_frames
        assert one.caption in clip.texts
        assert recorded_features(clip, one, CONFIGURATION).shape == (one.n_frames, 263)
    shorter = np.mean([one.n_frames % 4 == 0 and one.n_frames < clip.motion.n_frames // 4 * 4
                       for run in drawn for clip, one in zip(clips, run)])  # fmt: skip
    assert shorter == pytest.approx(1 / 3, abs=0.13)


def test_a_generated_motion_keeps_all_its_frames():
    joints = smooth_motion("made", 30)
    features = generated_features(joints, CONFIGURATION, name="x")
    assert features.shape == (30, 263)
    np.testing.assert_allclose(features[:20, 193:259], encode(joints, upright=False)[:20, 193:259], atol=1e-3)
    np.testing.assert_allclose(features[-1, 196:259], features[-2, 196:259], atol=0.02)  # the last step once more


def test_too_few_motions_or_clips_are_refused(request_for, corpus):
    with pytest.raises(UsageError, match="more than 44 motions, found 44"):
        evaluate_text(request_for(diversity_pairs=44))
    with pytest.raises(TableError, match="expected 25 frames per second"):
        EvaluatedClips.read(corpus.folder, split="test", kinds=frozenset(), fps=25.0)


def test_weights_of_something_else_are_refused(build, saved, corpus):
    with pytest.raises(InputFileError, match="'t2m-evaluator'"):
        load_evaluator(saved(build("autoencoder")), [corpus])
    with pytest.raises(UsageError, match="need no word vectors"):
        load_evaluator(saved(build()), [corpus], words=corpus.folder)


def test_a_method_without_texts_is_refused(request_for, swaying):
    swaying.conditions = frozenset({Condition.NONE})
    with pytest.raises(AdapterError, match="does not take the condition 'text'"):
        evaluate_text(request_for(method="swaying"))


def test_the_command_writes_prints_and_refuses(build, saved, corpus, tmp_path, capsys):
    path, out = saved(build()), tmp_path / "text.json"
    command = ["evaluate-text", "--evaluator", str(path), "--corpus", str(corpus.folder), "--out", str(out)]
    assert main([*command, "--repetitions", "1", "--diversity-pairs", "20"]) == 0
    printed = capsys.readouterr()
    assert "R-precision top 3, %" in printed.out
    assert "texts read as hashed-ngrams" in printed.out
    assert "real motion is no upper bound" in printed.err
    assert json.loads(out.read_text())["rows"][0]["source"] == "real"
    words = [*command, "--repetitions", "1", "--diversity-pairs", "20"]
    report = reported(words, capsys)
    written = json.loads(out.read_text())
    assert plain(report.rows) == written["rows"]
    assert (report.clips, report.notes) == (written["clips"], written["notes"])
    assert main([*words, "--retrieval"]) == 0
    assert "R@10, %" in capsys.readouterr().out
    refused([*words, "--corpus", str(tmp_path / "gone")], capsys, code=4, message="gone")
    assert main([*command, "--multimodality"]) == 2
    assert "--multimodality belongs to a method" in capsys.readouterr().err
