"""The log of a training: TensorBoard's files and the picture of the curves."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.image import imread

from prbench_adapters.training import report as log
from prbench_adapters.training.configuration import OptimisationConfiguration
from prbench_adapters.training.report import TrainingLog, draw_curves
from prbench_adapters.training.state import TrainingState
from tests.adapters.training.toy import toy

ROWS = [{"step": step, "loss": 1 / step, "learning_rate": 0.1, "seconds": 2.0 * step} for step in range(1, 9)]


def state():
    made = TrainingState.start(toy(), OptimisationConfiguration(steps=8))
    made.rows = list(ROWS)
    return made


def logged(folder):
    """(step, value) of every scalar, as TensorBoard reads them."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(folder))
    events.Reload()
    return {name: [(event.step, event.value) for event in events.Scalars(name)] for name in events.Tags()["scalars"]}


def test_rows_can_be_read_back_by_tensorboard_and_those_after_a_resumption_replace_what_was_lost(tmp_path):
    first = TrainingLog(tmp_path, resumed_at=0)
    for step in (1, 2, 3):
        first.add({"step": step, "loss": float(step)}, group="train")
    first.draw_now_and_then(state())  # killed here, after step 3, while the last checkpoint is that of step 2
    second = TrainingLog(tmp_path, resumed_at=2)
    second.add({"step": 3, "loss": 30.0}, group="train")
    second.add({"step": 3, "loss": 5.0}, group="validation")
    second.close(state())
    first.close(state())
    assert logged(tmp_path / "tensorboard") == {
        "train/loss": [(1, 1.0), (2, 2.0), (3, 30.0)],
        "validation/loss": [(3, 5.0)],
    }


def test_every_measurement_has_a_plot_that_shows_it(tmp_path):
    path = tmp_path / "curves.png"
    draw_curves(path, ROWS[:4], [])
    one = imread(path)
    draw_curves(path, ROWS, [{"step": 4, "loss": 0.5, "mpjpe": 0.2}])
    both = imread(path)
    assert both.shape[1] > one.shape[1], "a third plot stands beside the other two"
    assert np.abs(both[..., :3] - 1).sum() > 0
    assert [file.name for file in tmp_path.iterdir()] == ["curves.png"]


def test_the_order_of_names_in_a_row_changes_no_byte_of_the_picture(tmp_path):
    rows = [{"step": step, "loss": 1.0, "root": 0.5, "learning_rate": 0.1} for step in (1, 2)]
    draw_curves(tmp_path / "a.png", rows, [])
    draw_curves(tmp_path / "b.png", [dict(sorted(row.items())) for row in rows], [])  # as a checkpoint has them
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_pictures_are_drawn_now_and_then_and_at_the_end(tmp_path, monkeypatch):
    drawn = []
    now = iter([0.0, 119.0, 121.0, 121.0, 122.0, 190.0])
    monkeypatch.setattr(log, "draw_curves", lambda path, rows, validations: drawn.append(len(rows)))
    monkeypatch.setattr(log.time, "monotonic", lambda: next(now))
    written = TrainingLog(tmp_path, resumed_at=0)
    counts = []
    for _ in range(3):
        written.draw_now_and_then(state())
        counts.append(len(drawn))
    written.close(state())
    assert counts == [0, 1, 1]
    assert len(drawn) == 2


@pytest.mark.parametrize("rows", [[], ROWS])
def test_a_training_that_logged_nothing_has_no_picture(rows, tmp_path):
    written = TrainingLog(tmp_path, resumed_at=0)
    made = state()
    made.rows = rows
    written.close(made)
    assert (tmp_path / "curves.png").is_file() is bool(rows)
