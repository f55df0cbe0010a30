"""Cards, logs, the record that keeps two trainings apart, and finding tasks by name."""

from __future__ import annotations

import sys
from importlib.metadata import EntryPoint

import msgspec
import pytest

from prbench.contract import ENTRY_POINT_GROUP as METHODS
from prbench.errors import AdapterError, StorageError, TrainingError
from prbench.files.storage import write_json
from prbench.harness.methods import installed
from prbench.harness.methods.installed import load_task
from prbench_adapters.training.configuration import OptimisationConfiguration, TrainingConfiguration
from prbench_adapters.training.report import (
    Outputs,
    TableRecord,
    TrainingRecord,
    require_same_training,
    thinned,
)

TABLE = TableRecord(
    dataset="a", title="A", synthetic=True, licence="MIT", identity_digest="i", content_digest="c", sequences=3
)
RECORD = TrainingRecord(
    method="toy",
    stage="pretrain",
    configuration=TrainingConfiguration(
        model={"dropped": ["goal"]}, training=OptimisationConfiguration(steps=5, betas=(0.9, 0.99))
    ),
    data=(TABLE,),
    initial_weights_sha256=None,
    devices=1,
)


def with_training(**changes):
    training = msgspec.structs.replace(RECORD.configuration.training, **changes)
    return msgspec.structs.replace(
        RECORD, configuration=msgspec.structs.replace(RECORD.configuration, training=training)
    )


@pytest.mark.parametrize("rows", [0, 1, 5, 10, 11, 999])
def test_a_thinned_curve_keeps_its_end_and_its_order(rows):
    curve = [{"step": step} for step in range(rows)]
    thin = thinned(curve, 10)
    assert len(thin) == min(rows, 10)
    assert thin[-1:] == curve[-1:]
    assert thin == sorted(thin, key=lambda row: row["step"])


def test_the_same_training_may_go_on_and_one_killed_before_its_record_stood_there_begins_anew(tmp_path):
    require_same_training(tmp_path / "new", RECORD)
    (tmp_path / ".training-abcd1234.partial.json").write_text("{")
    require_same_training(tmp_path, RECORD)
    assert list(tmp_path.iterdir()) == []
    write_json(tmp_path / "training.json", msgspec.to_builtins(RECORD))
    require_same_training(tmp_path, RECORD)
    require_same_training(tmp_path, with_training(save_every=7, log_every=3))


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (with_training(learning_rate=0.5), "'configuration.training.learning_rate' is 0.0001 there, but 0.5 was"),
        (with_training(betas=(0.9, 0.5)), "'configuration.training.betas.1' is 0.99 there, but 0.5 was"),
        (with_training(gradient_clip=1.0), "'configuration.training.gradient_clip' is null there, but 1.0 was"),
        (msgspec.structs.replace(RECORD, devices=2), "'devices' is 1 there, but 2 was"),
        (msgspec.structs.replace(RECORD, data=(TABLE, TABLE)), "'data.1.dataset' is nothing there, but \"a\" was"),
        (msgspec.structs.replace(RECORD, initial_weights_sha256="f"), "'initial_weights_sha256' is null there"),
    ],
)
def test_another_training_is_refused_by_the_first_key_that_differs(other, message, tmp_path):
    write_json(tmp_path / "training.json", msgspec.to_builtins(RECORD))
    with pytest.raises(TrainingError, match=message):
        require_same_training(tmp_path, other)


def test_folders_of_something_else_are_refused(tmp_path):
    (tmp_path / "notes.txt").write_text("x")
    with pytest.raises(StorageError, match=r"holds no training\.json"):
        require_same_training(tmp_path, RECORD)
    with pytest.raises(StorageError, match="so it is no training"):
        require_same_training(tmp_path / "notes.txt", RECORD)
    write_json(tmp_path / "training.json", [1])
    with pytest.raises(TrainingError, match="expected the record of a training"):
        require_same_training(tmp_path, RECORD)


class Incomplete:
    name = "incomplete"


def points(*targets: str, group: str = installed.ENTRY_POINT_GROUP):
    return lambda asked: [EntryPoint("mine", target, asked) for target in targets if asked == group]


@pytest.mark.parametrize(
    ("targets", "message"),
    [
        ((), "nothing to train is called 'mine'. There are: none."),
        (("nowhere.at_all:Task",), "cannot be loaded: ModuleNotFoundError: No module named 'nowhere'"),
        ((f"{__name__}:Incomplete",), "expected name, configurations and build.., found no configurations, build"),
        (("a:B", "c:D"), "'mine' is offered more than once: a:B, c:D"),
    ],
)
def test_a_task_that_cannot_be_had_is_explained(targets, message, monkeypatch):
    monkeypatch.setattr(installed, "entry_points_of", points(*targets))
    with pytest.raises(AdapterError, match=message):
        load_task("mine")


METHOD = """
def load(weights, *, options, device):
    raise NotImplementedError
"""
TASK = """
class Task:
    name, configurations = "mine", "nowhere"
    def build(self, model, *, data, initial, stage):
        raise NotImplementedError

def training_task():
    return Task()
"""


@pytest.fixture
def method(tmp_path, monkeypatch):
    """Installs a module as the method ``mine``, with the one line that a method needs."""

    def install(source: str) -> None:
        (tmp_path / "made_up_method.py").write_text(source)
        monkeypatch.syspath_prepend(tmp_path)
        monkeypatch.delitem(sys.modules, "made_up_method", raising=False)
        monkeypatch.setattr(installed, "entry_points_of", points("made_up_method:load", group=METHODS))

    return install


def test_a_task_beside_its_method_needs_no_entry_point_and_methods_without_one_are_no_tasks(method, monkeypatch):
    method(METHOD + TASK)
    assert installed.list_tasks() == ("mine",)
    assert "made_up_method" not in sys.modules  # listing imports nothing
    assert load_task("mine").name == "mine"
    method(METHOD)
    assert installed.list_tasks() == ()
    with pytest.raises(AdapterError, match="nothing to train is called 'mine'"):
        load_task("mine")
    method("import no_such_module\n" + METHOD + TASK)
    assert installed.list_tasks() == ("mine",)
    with pytest.raises(AdapterError, match=r"made_up_method:training_task.: cannot be loaded: ModuleNotFoundError"):
        load_task("mine")
    monkeypatch.setattr(installed, "entry_points_of", points("nowhere.at_all:load", "a b:load", group=METHODS))
    assert installed.list_tasks() == ()


def test_rows_can_be_read_back_by_tensorboard_and_those_after_a_resumption_replace_what_was_lost(tmp_path):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    given = (tmp_path, tmp_path / "checkpoints", lambda state: {})
    first = Outputs(*given, dtype="float32", resumed_at=0)
    for step in (1, 2, 3):
        first.add({"step": step, "loss": float(step)}, group="train")
    first.tensorboard.flush()  # killed here, after step 3, while the last checkpoint is that of step 2
    second = Outputs(*given, dtype="float32", resumed_at=2)
    second.add({"step": 3, "loss": 30.0}, group="train")
    second.add({"step": 3, "loss": 5.0}, group="validation")
    second.tensorboard.close()
    first.tensorboard.close()
    events = EventAccumulator(str(tmp_path / "tensorboard"))
    events.Reload()
    logged = {name: [(row.step, row.value) for row in events.Scalars(name)] for name in events.Tags()["scalars"]}
    assert logged == {"train/loss": [(1, 1.0), (2, 2.0), (3, 30.0)], "validation/loss": [(3, 5.0)]}
