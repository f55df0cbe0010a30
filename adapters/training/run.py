"""A whole training, from a user's request to trained weights: task, configuration, precision, data, loop, validation.

Validation measures losses on part of the validation split. The noise of the losses is the same every time, so two
validations differ by the weights alone. The benchmark's metrics of a state of the weights come from ``prbench run
--split validation --weights FOLDER/weights.safetensors``.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import msgspec
import torch

from prbench.datasets import SECOND_WORLD_PREFIX
from prbench.engine import IN_PROCESS, Engine, close_engine
from prbench.errors import MissingExtraError, TrainingStopped, UsageError
from prbench.files.storage import sole_writer, write_json
from prbench.harness.methods.installed import load_task
from prbench.sequences.dataset_info import FILE_NAME as DATASET_FILE
from prbench.sequences.folds import fold_tables, parse_fold
from prbench.sequences.table import by_share
from prbench_adapters.trained_network import TrainedNetwork
from prbench_adapters.training import report as reports
from prbench_adapters.training.batches import DrawnDataset, Items, LengthBatches, load_batches
from prbench_adapters.training.configuration import TrainingConfiguration, resolved
from prbench_adapters.training.dataset import configured_dataset
from prbench_adapters.training.loop import Progress, faster_precision, fit, make_fabric, silent
from prbench_adapters.training.state import Row, TrainingState
from prbench_adapters.training.store import REFIT, Table, open_table, parts_of
from prbench_adapters.training.task import TrainingData, TrainingModule, TrainingTask
from prbench_adapters.training.weights import read_weights

_SPLIT = "validation"


@dataclass(frozen=True)
class Validation:
    """Chosen sequences and settings of a validation, the same at every step of a training.

    Attributes:
        places: Places of the chosen items in ``data``, by length.
    """

    data: Items
    places: tuple[int, ...]
    batch_size: int

    @classmethod
    def prepare(
        cls, tables: Iterable[Table], configuration: TrainingConfiguration, *, engine: Engine = IN_PROCESS
    ) -> Validation:
        """Choose the sequences. Tables without validation sequences are left out.

        Raises:
            UsageError: if no table has validation sequences.
        """
        wanted = configuration.validation
        usable = [table for table in tables if table.scalars(split=_SPLIT, columns=["split"]).num_rows]
        if not usable:
            remedy = "Build more recordings, or train without: --set validation.every=0."
            raise UsageError(f"no table has sequences in split 'validation'. {remedy}")
        data = configured_dataset(usable, configuration, split=_SPLIT, engine=engine)
        chosen: set[str] = set()
        for table in usable:
            rows = table.scalars(split=_SPLIT, columns=["sequence_id", "recording_id"])
            names = by_share(rows["sequence_id"].to_pylist(), rows["recording_id"].to_pylist())
            chosen.update(names[: wanted.sequences])
        places = [place for place, name in enumerate(data.sequence_ids) if name in chosen]
        return cls(data, tuple(sorted(places, key=lambda place: (int(data.lengths[place]), place))), wanted.batch_size)

    @torch.no_grad()
    def measure(self, module: TrainingModule, device: torch.device) -> Row:
        """Losses of a module in evaluation mode, by name; what has no value on these sequences is left out."""
        totals: dict[str, float] = defaultdict(float)
        for number, start in enumerate(range(0, len(self.places), self.batch_size)):
            places = self.places[start : start + self.batch_size]
            batch = self.data.collate([self.data[place] for place in places]).to(device)  # pyright: ignore[reportArgumentType]
            # Negative steps draw the same noise at every validation and none that training has drawn.
            for name, loss in module(batch, -1 - number).items():
                totals[name] += float(loss) * len(places)
        means = {name: total / len(self.places) for name, total in totals.items()}
        return {name: value for name, value in means.items() if math.isfinite(value)}


if TYPE_CHECKING:
    from lightning_fabric import Fabric


@dataclass(frozen=True, kw_only=True)
class TrainRequest:
    """One training.

    Attributes:
        method: Name of an installed training task.
        data: Folders of built datasets or corpora; their split ``train`` is learnt from.
        out: The training folder; goes on with the same training, refuses another.
        refit: Learn from the split ``validation`` as well, once nothing is chosen by it any more.
        fold: A fold of the tables' participants, such as ``2/6``, who are not learnt from; None for the tables' own
            split.
        stage: Stage of the training; by default the task's first.
        configuration: Name of one that comes with the task, or the path of a TOML file; by default the one named like
            the stage where there is one, else ``small``.
        overrides: ``("training.steps", "100")`` …
        initial: Weights to start from.
        devices: Processes that train together.
        threads: Torch's threads in each process; on a CPU the last bits of the weights depend on it.
        workers: Processes that load data for each training process; they change no result.
        wandb: Project at Weights & Biases that the log goes to as well; ``WANDB_MODE=offline`` keeps it on this disk.
    """

    method: str
    data: tuple[Path, ...]
    out: Path
    refit: bool = False
    fold: str | None = None
    stage: str | None = None
    configuration: str | None = None
    overrides: tuple[tuple[str, str], ...] = ()
    initial: Path | None = None
    device: str = "cpu"
    devices: int = 1
    threads: int = 1
    workers: int = 0
    wandb: str | None = None


def train(
    request: TrainRequest, *, report: Callable[[Progress], None] = silent, engine: Engine = IN_PROCESS
) -> TrainedNetwork | None:
    """Train, or go on training, to the last step; None in all but the first of several processes.

    Args:
        request: What to train on what.
        report: Called as the training goes on.
        engine: Engine that prepares the data; changes no byte of it.

    Raises:
        AdapterError: if there is no such task.
        UsageError: if the request does not fit together, or there is no such device.
        TrainingStopped: after SIGTERM or Ctrl-C; everything was saved.
        TrainingError: if the folder belongs to another training, or a loss is not finite.
        MissingExtraError: if the extra ``train``, or ``wandb`` where it is asked for, is not installed.
        PrbenchError: if data, configuration or initial weights are not what they should be.
    """
    task = load_task(request.method)
    stage, configuration = resolved(task, request.configuration, stage=request.stage, overrides=request.overrides)
    if request.refit and configuration.validation.every:
        why = "the validation split is learnt from, so measuring on it would say nothing; add --set validation.every=0."
        raise UsageError(f"--refit: {why}")
    torch.set_num_threads(request.threads)
    if request.wandb is not None:
        try:
            # Where it is missing, this is said before the data are prepared.
            import wandb  # noqa: F401  # pyright: ignore[reportMissingImports]
        except ModuleNotFoundError as error:
            raise MissingExtraError("wandb", "wandb", "--wandb") from error
    fabric = make_fabric(request.device, devices=request.devices)
    fabric.launch()
    torch.set_num_threads(request.threads)  # launching several processes sets one of its own
    with sole_writer(request.out) if fabric.is_global_zero else nullcontext():
        return run(request, task, stage, configuration, fabric, report, engine=engine)


def run(
    request: TrainRequest,
    task: TrainingTask,
    stage: str,
    configuration: TrainingConfiguration,
    fabric: Fabric,
    report: Callable[[Progress], None] = silent,
    *,
    engine: Engine = IN_PROCESS,
) -> TrainedNetwork | None:
    """Train in this process, which is one of those that Fabric has launched; the first one holds the folder."""
    settings = configuration.training
    validation = None
    if settings.precision == "auto" and (request.out / reports.RECORD).is_file():
        # Timed by the session that began: another choice would be another training.
        settings = reports.read_record(request.out).configuration.training
        configuration = _with_precision(configuration, settings.precision)
    with fabric.rank_zero_first():  # the first makes what is cached, the others find it
        data = _data(request, task, configuration, engine)
        given: Any = data
        if isinstance(data, DrawnDataset):
            counts = data.counts
        else:
            given = TrainingData(data, mode=data.mode, max_frames=data.max_frames, fps=data.fps)
            rows = [table.scalars(columns=["split"])["split"].to_pylist() for table in data.tables]
            counts = [sum(split in parts_of(data.split) for split in splits) for splits in rows]
        record = reports.TrainingRecord(
            method=request.method,
            stage=stage,
            configuration=configuration,
            data=tuple(map(reports.table_record, data.tables, counts)),
            initial_weights_sha256=read_weights(request.initial).digest if request.initial else None,
            devices=request.devices,
            refit=request.refit,
        )
        reports.require_same_training(request.out, record)
        # What a process drew before must not decide the initial weights: they follow from the seed alone.
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(settings.seed)
            module = task.build(configuration.model, data=given, initial=request.initial, stage=stage)
        if fabric.is_global_zero and configuration.validation.every:
            if isinstance(data, DrawnDataset):
                held_out = cast(Any, task).items(data.tables, _SPLIT, configuration.model, settings.seed)
                wanted = configuration.validation
                validation = Validation(held_out, held_out.spread(wanted.sequences), wanted.batch_size)
            else:
                validation = Validation.prepare(data.tables, configuration, engine=engine)
    close_engine(engine)  # its workers have nothing more to do
    fabric.barrier()  # nobody may find the folder half made

    def batches(start: int, workers: int = request.workers) -> Iterable[Any]:
        rank, world_size = fabric.global_rank, fabric.world_size
        order = LengthBatches(data, settings.batch_size, settings.seed, rank, world_size, start)
        return load_batches(data, order, workers=workers, pinned=fabric.device.type == "cuda")

    if configuration.training.precision == "auto":
        timed = faster_precision(module, next(iter(batches(0, 0))), fabric.device) if fabric.is_global_zero else None
        configuration = _with_precision(configuration, fabric.broadcast(timed))
        record = msgspec.structs.replace(record, configuration=configuration)
    wandb_run = None
    if fabric.is_global_zero:
        write_json(request.out / reports.RECORD, msgspec.to_builtins(record))  # now that everything fits together
        if request.wandb is not None:
            wandb_run = reports.wandb_run(request.out, request.wandb, record)

    def validate(module: TrainingModule) -> Row:
        assert validation is not None
        return validation.measure(module, fabric.device)

    def describe(state: TrainingState) -> dict[str, Any]:
        return reports.training_card(record, state, fabric.device, request.threads)

    told: dict[str, Any] = {"describe": describe, "validate": validate, "report": report}
    if wandb_run is not None:
        told["log"] = wandb_run.log
    try:
        state = fit(module, batches, configuration, request.out, fabric=fabric, **told)
    except TrainingStopped as stopped:
        if fabric.is_global_zero:
            raise  # one process speaks for all; Fabric would kill it if another left with a code that is not 0
        raise SystemExit(0) from stopped
    finally:
        if wandb_run is not None:
            wandb_run.finish()
    best = state.best_validation()
    best_step = None if best is None else int(best["step"])
    trained = TrainedNetwork(weights=request.out / reports.WEIGHTS, steps=state.step, best_step=best_step)
    return trained if fabric.is_global_zero else None


def _with_precision(configuration: TrainingConfiguration, precision: Any) -> TrainingConfiguration:
    training = msgspec.structs.replace(configuration.training, precision=precision)
    return msgspec.structs.replace(configuration, training=training)


def _data(request: TrainRequest, task: TrainingTask, configuration: TrainingConfiguration, engine: Engine) -> Items:
    """Return the split that is learnt from: sequences, or what a task draws itself."""
    split = REFIT if request.refit else "train"
    if hasattr(task, "items"):
        if request.fold is not None:
            remedy = "windows leave participants out with --set 'model.windows.left_out=[\"P1\"]'."
            raise UsageError(f"--fold: the tables of {task.name} have no folds of participants; {remedy}")
        return cast(Any, task).items(request.data, split, configuration.model, configuration.training.seed)
    folders = request.data
    for folder in folders:
        dataset = open_table(folder).info.dataset
        if dataset.startswith(SECOND_WORLD_PREFIX):
            problem = f"holds {dataset}, whose people are for tests of transfer and never learnt from"
            raise UsageError(f"{folder} {problem}. Give tables that were made without --world second.")
    if request.fold is not None:
        parse_fold(request.fold)
        for folder in folders:
            if not (folder / DATASET_FILE).is_file():
                why = "only built datasets have folds of participants."
                raise UsageError(f"--fold: {folder} holds no {DATASET_FILE}; {why}")
        folders = fold_tables(folders, request.fold)
    return configured_dataset(folders, configuration, split=split, engine=engine)
