"""``prbench export-conditions`` and ``prbench score`` as a program reads them."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.harness.offline import read_conditions_file
from prbench.harness.run_folder import DatasetSummary
from tests.cli.reports import printed_document, refused, reported
from tests.fakes import fake_dataset


@pytest.fixture
def data(tmp_path):
    return fake_dataset(tmp_path / "table", 24).folder


def test_from_conditions_to_scores_everything_is_reported(data, tmp_path, capsys):
    conditions = tmp_path / "conditions.npz"
    asked = ["export-conditions", "--data", str(data), "--condition", "goal-loc", "--out", str(conditions)]
    exported = reported([*asked, "--samples", "2"], capsys)
    assert (exported.out, list(exported.sequences)) == (conditions, ["synthetic-adt"])
    assert exported.rows == 2 * exported.sequences["synthetic-adt"]

    given = read_conditions_file(conditions)
    assert given.initial_joints is not None
    longest = int(given.n_frames.max())
    joints = np.repeat(given.initial_joints[:, None], longest, axis=1)
    predictions = tmp_path / "predictions.npz"
    np.savez(
        predictions, joints=joints, n_frames=given.n_frames, opaque_id=given.opaque_id, sample=np.asarray(given.sample)
    )
    out = tmp_path / "scores"
    words = ["score", str(predictions), "--conditions", str(conditions), "--data", str(data), "--out", str(out)]
    (dataset,) = reported([*words, "--name", "still"], capsys)
    scores = dataset.scores
    assert dataset.origin == "file predictions.npz"
    summary = DatasetSummary.read(out / "synthetic-adt")
    assert (scores.method, scores.condition, scores.samples) == ("still", "goal-loc", 2)
    assert scores.sequences == summary.sequences == exported.sequences["synthetic-adt"]
    assert {each.metric: (each.mean, each.low) for each in scores.metrics} == {
        each.metric: (each.mean, each.low) for each in summary.metrics
    }


def test_what_is_said_beside_the_report_is_listed_in_the_document(data, tmp_path, capsys):
    words = ["export-conditions", "--data", str(data), "--condition", "text", "--out", str(tmp_path / "c.npz")]
    document = printed_document(words, capsys, code=0)
    assert document.command == "export-conditions"
    assert any(note.startswith("then: prbench score PREDICTIONS --conditions") for note in document.notes)


def test_mistakes_are_errors_in_the_document(data, tmp_path, capsys):
    words = ["export-conditions", "--data", str(data), "--condition", "none", "--out", str(tmp_path / "c.csv")]
    refused(words, capsys, code=2, message="ends in .npz")
    words = ["score", str(tmp_path / "gone.npz"), "--data", str(data)]
    refused(words, capsys, code=6, message="gone.npz")
