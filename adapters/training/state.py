"""Everything that changes while training goes on, and the checkpoints that hold it.

The exponential moving average of the weights is what is validated and saved (docs/specification/mdm.md#training), as
it was at the best validation. The learning rate is a pure function of the step. A checkpoint is a folder,
``safetensors`` and JSON, written whole; the newest ones are kept.
"""

from __future__ import annotations

import contextlib
import math
import re
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import safetensors.torch
import torch
from safetensors import SafetensorError
from torch import nn

from prbench.errors import InputFileError, TrainingError, UsageError
from prbench.files.bounded import foreign_input, require_size
from prbench.files.storage import atomic_folder, read_json, remove_folder, write_json
from prbench.limits import LARGEST_UNPACKED
from prbench_adapters.training.configuration import OptimisationConfiguration
from prbench_adapters.training.task import TrainingModule

# Length of Muon's steps against AdamW's; tried with small P&R models (docs/methods/pr.md#training).
_MUON_SCALE = 2.0
# One line of the log: ``step`` and what was measured there, by name.
Row = dict[str, float | int]


class WeightAverage:
    """Averages of the trained parameters, kept in float32 on their device.

    Args:
        module: Whose parameters; only those that require gradients.
        decay: Largest decay; 0 follows the weights themselves.
        warmup: Average over fewer steps at first: the decay at step n is at most (1 + n) / (10 + n).
        apart: Parameters whose averages follow the weights themselves.
    """

    def __init__(
        self, module: nn.Module, decay: float, *, warmup: bool = True, apart: Sequence[nn.Parameter] = ()
    ) -> None:
        self.decay, self.warmup = decay, warmup
        self.apart = {id(parameter) for parameter in apart}
        self.parameters = {name: parameter for name, parameter in module.named_parameters() if parameter.requires_grad}
        self.averages = {name: parameter.detach().clone() for name, parameter in self.parameters.items()}

    @torch.no_grad()
    def update(self, steps_done: int) -> None:
        """Take in the weights as they are after ``steps_done`` steps (1 after the first)."""
        # At first the average would be dominated by random initial weights.
        decay = min(self.decay, (1 + steps_done) / (10 + steps_done)) if self.warmup else self.decay
        averages = list(self.averages.values())
        parameters: list[torch.Tensor] = list(self.parameters.values())
        torch._foreach_lerp_(averages, parameters, 1 - decay)  # pyright: ignore[reportPrivateImportUsage]
        for average, parameter in zip(averages, parameters, strict=True):
            if id(parameter) in self.apart:
                average.copy_(parameter)

    @contextlib.contextmanager
    def applied(self, values: dict[str, torch.Tensor] | None = None) -> Iterator[None]:
        """Put averages in the module's place while the block runs, and the weights back afterwards, to the bit.

        Args:
            values: Averages of an earlier step; by default those of now.
        """
        own = {name: parameter.detach().clone() for name, parameter in self.parameters.items()}
        self._set(values or self.averages)
        try:
            yield
        finally:
            self._set(own)

    @torch.no_grad()
    def _set(self, values: dict[str, torch.Tensor]) -> None:
        for name, parameter in self.parameters.items():
            parameter.copy_(values[name])


@dataclass
class TrainingState:
    """A training between two steps.

    Attributes:
        optimisers: Each with parameters of its own; a group's ``scale`` is its factor on the learning rate, and
            ``steady`` groups know no factor of the module.
        step: Steps done.
        losses: Sums since the last line of the log; kept on their device, because reading them would make a GPU wait.
        batches: Batches in these sums.
        rows: The log so far; holds no times, so that two undisturbed trainings have the same.
        validations: What every validation measured.
        best: The averages as they were at the best validation; empty before the first one that counts.
    """

    module: TrainingModule
    optimisers: tuple[torch.optim.Optimizer, ...]
    average: WeightAverage
    step: int = 0
    losses: dict[str, torch.Tensor | float] = field(default_factory=dict)
    batches: int = 0
    rows: list[Row] = field(default_factory=list)
    validations: list[Row] = field(default_factory=list)
    best: dict[str, torch.Tensor] = field(default_factory=dict)

    @classmethod
    def start(cls, module: TrainingModule, settings: OptimisationConfiguration) -> TrainingState:
        """Return the state before the first step; the module is where it will be trained."""
        average = WeightAverage(module, settings.ema, warmup=settings.ema_warmup, apart=module.apart())
        matrices = list(module.hidden_matrices()) if settings.optimiser == "muon" else []
        if settings.optimiser == "muon" and not matrices:
            raise UsageError("training.optimiser: this task names no matrices for muon. Use adamw.")
        apart = {id(matrix) for matrix in matrices}
        others = [parameter for parameter in average.parameters.values() if id(parameter) not in apart]
        rate, decay = settings.learning_rate, settings.weight_decay
        fused = all(parameter.device.type in ("cpu", "cuda") for parameter in others)
        steady = [parameter for parameter in others if id(parameter) in average.apart]
        others = [parameter for parameter in others if id(parameter) not in average.apart]
        # Two groups of one Adam are two optimisers: it treats every number by itself.
        groups = [{"params": others}, *([{"params": steady, "steady": True}] if steady else [])]
        adamw = torch.optim.AdamW(groups, rate, settings.betas, weight_decay=decay, fused=fused)
        optimisers: list[torch.optim.Optimizer] = [adamw]
        if matrices:
            # Scaled so that a step changes an entry as much as one of AdamW at the same rate would.
            group = {"params": matrices, "scale": _MUON_SCALE}
            optimisers.append(torch.optim.Muon([group], rate, decay, adjust_lr_fn="match_rms_adamw"))
        return cls(module, tuple(optimisers), average)

    def best_validation(self) -> Row | None:
        """Return the first validation with the lowest loss, of those that can be compared with the last one."""
        first = self.module.comparable_from()
        comparable = [row for row in self.validations if row["step"] >= first and "loss" in row]
        return min(comparable, key=lambda row: row["loss"], default=None)

    def add_validation(self, row: Row) -> None:
        """Take in what was measured of the averages, and keep them if they are the best so far."""
        self.validations.append(row)
        if self.best_validation() is row:
            self.best = {name: average.clone() for name, average in self.average.averages.items()}

    def exhausted(self, patience: int) -> bool:
        """Return True once ``patience`` validations in a row have not been better than the best; 0 waits for ever."""
        best = self.best_validation()
        if not patience or best is None:
            return False
        return len(self.validations) - 1 - self.validations.index(best) >= patience

    def tensors(self) -> dict[str, torch.Tensor]:
        """Trained parameters and buffers, their averages and their moments, by name; frozen parameters stay out."""
        frozen = {name for name, parameter in self.module.named_parameters() if not parameter.requires_grad}
        own = self.module.state_dict()
        tensors = {f"module.{name}": tensor for name, tensor in own.items() if name not in frozen}
        tensors |= {f"best.{name}": tensor for name, tensor in self.best.items()}
        for name, parameter in self.average.parameters.items():
            tensors[f"average.{name}"] = self.average.averages[name]
            for optimiser in self.optimisers:
                for moment, tensor in optimiser.state.get(parameter, {}).items():
                    tensors[f"optimiser.{moment}.{name}"] = tensor
        return tensors

    @torch.no_grad()
    def load_tensors(self, tensors: dict[str, torch.Tensor]) -> None:
        """Put the tensors of a checkpoint in place.

        Raises:
            TrainingError: if they are those of another network.
        """
        own = self.tensors()
        wanted = {name for name in own if not name.startswith(("optimiser.", "best."))}
        found = {name for name in tensors if not name.startswith(("optimiser.", "best."))}
        odd = sorted(wanted ^ found) or sorted(name for name in wanted if own[name].shape != tensors[name].shape)
        if odd:
            raise TrainingError(
                f"the checkpoint does not fit the network: '{odd[0]}' is missing, unknown or of another shape."
                " The code of the task has changed since; start again in another folder."
            )
        for name in wanted:
            own[name].copy_(tensors[name])
        for name, average in self.average.averages.items():
            if f"best.{name}" in tensors:
                self.best[name] = tensors[f"best.{name}"].to(average.device, copy=True)
        names = {id(parameter): name for name, parameter in self.average.parameters.items()}
        for optimiser in self.optimisers:
            for parameter in (parameter for group in optimiser.param_groups for parameter in group["params"]):
                name = names[id(parameter)]
                for moment in ("step", "exp_avg", "exp_avg_sq", "momentum_buffer"):
                    kept = tensors.get(f"optimiser.{moment}.{name}")
                    if kept is not None:
                        optimiser.state[parameter][moment] = kept.to(parameter.device, copy=True)


def learning_rate(step: int, settings: OptimisationConfiguration) -> float:
    """Linear warm-up, then constant, halved in six steps, or a half cosine that would reach 0 one step after the last.

    Args:
        step: Number of the step, from 0.
        settings: Peak rate, schedule, warm-up and number of steps.
    """
    if step < settings.warmup_steps:
        return settings.learning_rate * (step + 1) / settings.warmup_steps
    if settings.schedule == "constant":
        return settings.learning_rate
    progress = (step - settings.warmup_steps) / (settings.steps - settings.warmup_steps)
    if settings.schedule == "halving":
        return settings.learning_rate * 0.5 ** int(6 * progress)
    return settings.learning_rate * 0.5 * (1 + math.cos(math.pi * progress))


_KEPT = 2
_TENSORS = "tensors.safetensors"
_STATE = "state.json"


def save_checkpoint(folder: Path, state: TrainingState) -> None:
    """Write a checkpoint, then delete the old ones.

    Raises:
        StorageError: if it cannot be written; the earlier ones stay.
    """
    tensors = {name: tensor.detach().cpu().contiguous().clone() for name, tensor in state.tensors().items()}
    losses = {name: float(total) for name, total in state.losses.items()}
    with atomic_folder(folder / f"step-{state.step:09d}") as temporary:
        safetensors.torch.save_file(tensors, temporary / _TENSORS)
        tally = {"losses": losses, "batches": state.batches}
        described = {"step": state.step, "tally": tally, "rows": state.rows, "validations": state.validations}
        write_json(temporary / _STATE, described)
    _newest(folder)


def _newest(folder: Path) -> Path | None:
    """Delete all checkpoints but the newest ones, and return the last."""
    found = sorted(path for path in folder.glob("step-*") if re.fullmatch(r"step-\d{9}", path.name) and path.is_dir())
    for path in found[:-_KEPT]:
        remove_folder(path)
    return found[-1] if found else None


@foreign_input()
def restore_checkpoint(checkpoints: Path, state: TrainingState) -> bool:
    """Put the newest checkpoint of a folder into ``state``; false if there is none.

    Raises:
        InputFileError: if it is damaged.
        TrainingError: if it is of another network.
    """
    for left in checkpoints.glob(".step-*"):
        shutil.rmtree(left, ignore_errors=True)  # half-written by a process that was killed
    folder = _newest(checkpoints)
    if folder is None:
        return False
    try:
        require_size(folder / _TENSORS, largest=LARGEST_UNPACKED)
        tensors = safetensors.torch.load_file(folder / _TENSORS)
    except (SafetensorError, OSError) as error:
        remedy = f"Delete the folder {folder}; the one before it is used then."
        raise InputFileError(folder / _TENSORS, "", expected="a checkpoint", found=str(error), remedy=remedy) from error
    described = read_json(folder / _STATE)
    if not isinstance(described, dict) or "step" not in described:
        raise TrainingError(f"{folder / _STATE}: expected the state of a training. Delete the folder {folder}.")
    state.step = described["step"]
    state.losses, state.batches = described["tally"]["losses"], described["tally"]["batches"]
    state.rows, state.validations = described["rows"], described["validations"]
    state.load_tensors(tensors)
    return True
