"""The log of a training: TensorBoard's files."""

from __future__ import annotations

from prbench_adapters.training.report import Outputs


def outputs(folder, *, resumed_at):
    return Outputs(folder, folder / "checkpoints", lambda state: {}, dtype="float32", resumed_at=resumed_at)


def logged(folder):
    """(step, value) of every scalar, as TensorBoard reads them."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(folder))
    events.Reload()
    return {name: [(event.step, event.value) for event in events.Scalars(name)] for name in events.Tags()["scalars"]}


def test_rows_can_be_read_back_by_tensorboard_and_those_after_a_resumption_replace_what_was_lost(tmp_path):
    first = outputs(tmp_path, resumed_at=0)
    for step in (1, 2, 3):
        first.add({"step": step, "loss": float(step)}, group="train")
    first.log.flush()  # killed here, after step 3, while the last checkpoint is that of step 2
    second = outputs(tmp_path, resumed_at=2)
    second.add({"step": 3, "loss": 30.0}, group="train")
    second.add({"step": 3, "loss": 5.0}, group="validation")
    second.log.close()
    first.log.close()
    assert logged(tmp_path / "tensorboard") == {
        "train/loss": [(1, 1.0), (2, 2.0), (3, 30.0)],
        "validation/loss": [(3, 5.0)],
    }
