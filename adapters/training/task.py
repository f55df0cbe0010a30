"""Training tasks: the interface between the loop, which knows no network, and a network, which knows no loop.

An installed package offers a task by an entry point in the group ``prbench.training_tasks`` that names a callable
without arguments which returns a :class:`TrainingTask`; so does a method, by a callable ``training_task`` in the module
that its own entry point names. A task builds a :class:`TrainingModule`; the loop of
:mod:`prbench_adapters.training.loop` feeds it batches, minimises its ``loss`` and saves its weights.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar, runtime_checkable

import msgspec
import torch
from torch import nn

from prbench.errors import UsageError
from prbench.files.bounded import allowed_values
from prbench.randomness import named_generator

if TYPE_CHECKING:
    from prbench_adapters.training.dataset import MotionBatch, SequenceDataset

Networks = TypeVar("Networks", bound=msgspec.Struct)
Objective = TypeVar("Objective", bound=msgspec.Struct)


@dataclass(frozen=True)
class TrainingData:
    """The training split as it will be fed, at which a task may look before the first step.

    A task takes normalisation statistics from ``train.statistics()`` and ``train.condition_statistics(goal)``, both
    made once and kept; a fine-tuned model keeps those of its initial weights instead
    (docs/specification/pr-model.md#training).

    Attributes:
        mode: Representation of the features: ``continuous`` or ``reference``.
        max_frames: The longest item that will be fed; crops are never longer.
    """

    train: SequenceDataset
    mode: str
    max_frames: int
    fps: float = 20.0

    def require_fit(self, model: str, configuration: Any) -> None:
        """Refuse data that a model cannot learn from.

        Args:
            model: What a message calls it, such as ``the model``.
            configuration: Says its ``representation`` (``continuous`` or ``reference``), its frame rate ``fps``, and
                ``max_frames``, the longest motion that it takes.

        Raises:
            UsageError: naming the setting, and what was expected and found.
        """
        for key, wanted, found in (
            ("data.mode", configuration.representation, self.mode),
            ("frames per second of the tables", configuration.fps, self.fps),
        ):
            if wanted != found:
                raise UsageError(f"{key}: {model} expects {wanted}, found {found}. Change one of the two.")
        if self.max_frames > configuration.max_frames:
            problem = f"found {self.max_frames}. Lower it, or raise model.max_frames."
            raise UsageError(f"data.max_frames: expected at most {model}'s {configuration.max_frames}, {problem}")


class TrainingModule(nn.Module):
    """A network with its losses. Subclasses implement :meth:`forward` and :meth:`weights`.

    The loop sets :attr:`seed`, :attr:`rank` and :attr:`calls` before the first step, seeds torch's global generator
    before every call of :meth:`forward` (dropout draws from that), and calls everything else outside of gradients.

    Attributes:
        seed: Seed of the configuration.
        rank: Number of this process among those that train together; each draws other noise.
        origin: Lines for the card: initial weights, text encoder, whatever else the weights build upon.
        calls: Steps of the whole training: modules that train one network after the other take their phases from it.
    """

    seed: int = 0
    rank: int = 0
    origin: tuple[str, ...] = ()
    calls: int = 1

    def forward(self, batch: MotionBatch, step: int) -> dict[str, torch.Tensor]:
        """Losses of one batch: scalars by name.

        Args:
            batch: Padded features and conditions, on the module's device.
            step: Counts the calls of the whole training from 0, not those since the last resumption. Validation calls
                with negative numbers. All draws of the call come from :meth:`generator` of it.

        Returns:
            ``loss``, which is minimised, and any others, which are logged beside it.
        """
        raise NotImplementedError

    def weights(self) -> tuple[dict[str, torch.Tensor], dict[str, str]]:
        """Return what is saved: tensors by name, and the entries of the file's header.

        The header needs ``kind`` (such as ``denoiser``), ``configuration`` (JSON) and, for networks of motion,
        ``representation`` (such as ``humanml3d-263/continuous``); the writer adds format and version
        (:mod:`prbench_adapters.training.weights`). Frozen parts that have weights of their own stay out.
        """
        raise NotImplementedError

    def learning_rate_factor(self, step: int) -> float:  # noqa: ARG002 - for those that have phases of their own
        """Factor on the learning rate of the configuration, for the optimiser's step that begins with this call."""
        return 1.0

    def apart(self) -> Sequence[nn.Parameter]:
        """Return parameters that :meth:`learning_rate_factor` leaves alone, and that are saved without averaging."""
        return ()

    def comparable_from(self) -> int:
        """First step whose validation can be compared with the last one's; later for those that have phases."""
        return 0

    def gradient_groups(self) -> Sequence[Sequence[nn.Parameter]]:
        """Return parameters whose gradients are clipped together, by the norm of each group: all of them by default."""
        return (tuple(self.parameters()),)

    def hidden_matrices(self) -> Sequence[nn.Parameter]:
        """Return the matrices between hidden layers, which ``training.optimiser = "muon"`` moves orthogonally."""
        return ()

    def generator(self, step: int) -> torch.Generator:
        """Return a generator on the CPU that depends on seed, step and rank alone: a resumed run repeats its draws.

        Draw on the CPU and move the result; then the numbers are the same on every device.
        """
        drawn = named_generator("prbench-training", self.seed, step, self.rank).integers(2**63 - 1)
        return torch.Generator().manual_seed(int(drawn))


@runtime_checkable
class TrainingTask(Protocol):
    """A kind of network that ``prbench train --method NAME`` can train.

    Two optional attributes are honoured: ``stages``, a tuple of the names that ``--stage`` may have here (by default
    ``("pretrain", "finetune")``; the first is the default of the command line), and ``items``, which takes folders or
    opened tables, a split, the table ``[model]`` and a seed. A task with it is fed what that returns, a
    :class:`~prbench_adapters.training.batches.DrawnDataset`, such as windows of motion prediction.

    Attributes:
        configurations: Import name of the package that holds the TOML files, named ``<task>-<configuration>.toml``.
    """

    name: str
    configurations: str

    def build(
        self, model: Mapping[str, Any], *, data: TrainingData, initial: Path | None, stage: str
    ) -> TrainingModule:
        """Make the module in its state before the first step.

        Args:
            model: The table ``[model]`` of the configuration, as it is in the TOML file.
            data: The training split.
            initial: A weights file to start from (``--init``), or None to start from nothing.
            stage: One of ``stages``.

        Raises:
            PrbenchError: if the table does not describe a model, or the initial weights do not fit it.
        """
        ...


def split_model_table(
    model: Mapping[str, Any], networks: type[Networks], objective: type[Objective]
) -> tuple[Networks, Objective]:
    """Split the table between two kinds of settings.

    Args:
        model: The table as it is in the TOML file.
        networks: Made from the keys that ``objective`` does not have; should forbid unknown ones.
        objective: Made from the keys of its own.

    Raises:
        UsageError: for an unknown key or an impossible value.
    """
    trained_for = {key: value for key, value in model.items() if key in objective.__struct_fields__}
    described = {key: value for key, value in model.items() if key not in trained_for}
    return converted(described, networks, "model"), converted(trained_for, objective, "model")


def converted(table: object, kind: type[Networks], where: str) -> Networks:
    """Return a table of a configuration as a record.

    Args:
        table: The table as it is in the TOML file.
        kind: The record's class.
        where: Name of the table, with which messages begin.

    Raises:
        UsageError: for an unknown key or an impossible value, with those that it may have where they are a list.
    """
    try:
        return msgspec.convert(table, kind)
    except msgspec.ValidationError as error:
        raise UsageError(f"[{where}]: {error}.{allowed_values(error, kind)}") from error
