"""Training configurations: TOML files, read once, complete, and refused where they hold what nobody reads.

A file has the tables ``[model]`` (read by the task), ``[data]``, ``[training]`` and ``[validation]``; a table
``[stages.<stage>.<table>]`` overrides keys for one stage, and ``--set table.key=value`` overrides both.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, Literal

import msgspec

from prbench.errors import InputFileError, UsageError, did_you_mean
from prbench.files.bounded import foreign_input, read_toml, structured

DEFAULT_STAGES = ("pretrain", "finetune")
_DEFAULT_CONFIGURATION = "small"


# Ranges of settings, in words; NaN lies in none.
_RANGES: dict[str, Callable[[float], bool]] = {
    "at least 1": lambda value: value >= 1,
    "at least 0": lambda value: value >= 0,
    "above 0": lambda value: value > 0,
    "from 0 to 1": lambda value: 0 <= value <= 1,
    "at least 0 and below 1": lambda value: 0 <= value < 1,
}


def require_within(settings: msgspec.Struct, allowed: str, *names: str) -> None:
    """Refuse settings outside of a range.

    Args:
        settings: The settings.
        allowed: Key of :data:`_RANGES`.
        names: Which of them.

    Raises:
        ValueError: naming the setting, its range, and what was found.
    """
    for name in names:
        if not _RANGES[allowed](getattr(settings, name)):
            raise ValueError(f"'{name}' must be {allowed}, found {getattr(settings, name)}")


class DataConfiguration(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """``[data]``: how sequences are cut and encoded.

    Attributes:
        max_frames: Longer sequences are cropped to this.
        crop: Keep the end (it holds the goal), or a random part (for text alone).
        mode: Mode of the representation.
    """

    max_frames: int = 241
    crop: Literal["end", "random"] = "end"
    mode: Literal["continuous", "reference"] = "continuous"


class OptimisationConfiguration(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """``[training]``: everything that the loop needs.

    Attributes:
        batch_size: Sequences of a batch of each process.
        optimiser: ``muon`` moves the matrices that a task names by orthogonal steps (Jordan et al. 2024), twice the
            learning rate long, and everything else by AdamW.
        schedule: ``halving`` halves the learning rate after every sixth of the steps (AvatarPoser).
        warmup_steps: Steps over which the learning rate rises linearly; part of ``steps``.
        gradient_clip: Largest norm of the gradient over all parameters, or over those of each network where the task
            says so.
        ema: Decay of the average of the weights, which is what is saved; 0 keeps no average.
        ema_warmup: Average over fewer steps at first: the decay at step n is at most (1 + n) / (10 + n).
        precision: ``auto`` times both on the first batch; the card and ``training.json`` name what was faster.
        weights_dtype: Type of matrices in the saved weights.
    """

    steps: int
    batch_size: int = 64
    optimiser: Literal["adamw", "muon"] = "adamw"
    learning_rate: float = 1e-4
    schedule: Literal["constant", "cosine", "halving"] = "constant"
    warmup_steps: int = 0
    weight_decay: float = 0.0
    betas: tuple[float, float] = (0.9, 0.999)
    gradient_clip: float | None = None
    ema: float = 0.9999
    ema_warmup: bool = True
    precision: Literal["32-true", "bf16-mixed", "auto"] = "32-true"
    seed: int = 0
    save_every: int = 1000
    log_every: int = 50
    weights_dtype: Literal["float32", "float16"] = "float32"

    def __post_init__(self) -> None:
        require_within(self, "at least 1", "steps", "batch_size", "save_every", "log_every")
        require_within(self, "at least 0", "warmup_steps")
        if self.warmup_steps > self.steps:
            why = f"{self.warmup_steps} `warmup_steps`, in which the learning rate rises, in only {self.steps} `steps`"
            raise ValueError(f"{why}; lower them, such as by --set training.warmup_steps={self.steps // 10}")
        require_within(self, "at least 0 and below 1", "ema")
        require_within(self, "above 0", "learning_rate")
        if self.gradient_clip is not None and self.gradient_clip <= 0:
            raise ValueError("`gradient_clip` must be above 0; leave it out for none")


class ValidationConfiguration(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """``[validation]``: losses on the validation split, while training goes on; the best weights are kept.

    Attributes:
        every: Steps between validations; 0 for none, then the last weights are kept.
        patience: Validations without a lower loss after which training ends early; 0 never ends it.
        sequences: Number of sequences of each dataset: of every recording its share, as ``--limit`` takes them.
    """

    every: int = 0
    patience: int = 0
    sequences: int = 64
    batch_size: int = 32

    def __post_init__(self) -> None:
        require_within(self, "at least 0", "every", "patience")
        require_within(self, "at least 1", "sequences", "batch_size")
        if self.patience and not self.every:
            raise ValueError(f"`patience` is {self.patience}, but `every` is 0, so nothing is ever validated")


class TrainingConfiguration(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One configuration, resolved for one stage.

    Attributes:
        model: Read by the task.
    """

    model: dict[str, Any]
    training: OptimisationConfiguration
    data: DataConfiguration = DataConfiguration()
    validation: ValidationConfiguration = ValidationConfiguration()


TABLES = TrainingConfiguration.__struct_fields__


def list_configurations(package: str, task: str) -> tuple[str, ...]:
    """Names of the configurations that come with a task: files ``<task>-<name>.toml`` of a package.

    Args:
        package: Import name.
        task: Name of the task.
    """
    names = (entry.name for entry in resources.files(package).iterdir())
    found = [re.fullmatch(rf"{re.escape(task)}-(.+)\.toml", name) for name in names]
    return tuple(sorted(match[1] for match in found if match))


def resolved(
    task: Any, configuration: str | None = None, *, stage: str | None = None, overrides: Sequence[tuple[str, str]] = ()
) -> tuple[str, TrainingConfiguration]:
    """Return the stage and the configuration of a training.

    Args:
        task: What is trained (:class:`~prbench_adapters.training.task.TrainingTask`).
        configuration: Name of one that comes with the task, or the path of a TOML file; None for the one named like the
            stage, or ``small`` where there is none.
        stage: Stage of the training; None for the task's first.
        overrides: ``("training.steps", "100")`` …

    Raises:
        UsageError: for an unknown stage, configuration or key.
        InputFileError: if the file is no configuration.
    """
    stages: tuple[str, ...] = getattr(task, "stages", DEFAULT_STAGES)
    chosen = stage or stages[0]
    if chosen not in stages:
        raise UsageError(f"--stage: '{task.name}' has no stage '{chosen}'; its stages are: {', '.join(stages)}.")
    where = {"package": task.configurations, "task": task.name}
    if configuration is None:
        configuration = chosen if chosen in list_configurations(**where) else _DEFAULT_CONFIGURATION
    return chosen, load_configuration(configuration, **where, stage=chosen, overrides=overrides)


@foreign_input()
def load_configuration(
    name: str, *, package: str, task: str, stage: str, overrides: Sequence[tuple[str, str]] = ()
) -> TrainingConfiguration:
    """Read a configuration and resolve it for one stage.

    Args:
        name: Name of a configuration that comes with the task, or the path of a TOML file.
        package: Import name of the task's package of configurations.
        task: Name of the task.
        stage: Whose table under ``[stages]`` overrides the others.
        overrides: ``("training.steps", "100")`` and so on; values as TOML writes them, or plain text.

    Raises:
        UsageError: for an unknown name (with those that exist) or an override that does not fit.
        InputFileError: if the file is no such configuration (naming the key).
    """
    if name.endswith(".toml"):
        return resolve(read_toml(Path(name)), source=Path(name), stage=stage, overrides=overrides)
    known = list_configurations(package, task)
    short = name.removeprefix(f"{task}-")
    if short not in known:
        hint = did_you_mean(short, known)
        raise UsageError(
            f"--config: '{task}' has no configuration '{name}'.{hint} There are: {', '.join(known) or 'none'};"
            " or give the path of a .toml file."
        )
    file = f"{task}-{short}.toml"
    tables = tomllib.loads(resources.files(package).joinpath(file).read_text(encoding="utf-8"))
    return resolve(tables, source=Path(file), stage=stage, overrides=overrides)


def resolve(
    tables: Mapping[str, Any], *, source: Path, stage: str, overrides: Sequence[tuple[str, str]] = ()
) -> TrainingConfiguration:
    """Merge the tables of a file with those of a stage and with single keys.

    Args:
        tables: The parsed file.
        source: Its path, for messages.
        stage: Whose table under ``[stages]`` overrides the others.
        overrides: Keys and values that override both, such as ``("training.steps", "100")``.

    Raises:
        UsageError: for an override that names no key.
        InputFileError: for an unknown table or key, a missing one, or a value of a wrong kind.
    """
    merged = {name: table for name, table in tables.items() if name != "stages"}
    stages = tables.get("stages", {})
    if not isinstance(stages, Mapping) or not all(isinstance(table, Mapping) for table in stages.values()):
        raise InputFileError(source, "[stages]", expected="tables such as [stages.pretrain.training]", found="a value")
    merged = _merged(merged, stages.get(stage, {}))
    for key, text in overrides:
        merged = _merged(merged, _override(key, text))
    remedy = "`prbench train --method NAME --show-config` prints a complete one."
    return structured(source, merged, TrainingConfiguration, remedy=remedy)


def as_toml(configuration: TrainingConfiguration) -> str:
    """Return the configuration as a TOML file that :func:`load_configuration` reads back."""
    tables = msgspec.to_builtins(configuration)
    lines = []
    for name in TABLES:
        lines.append(f"[{name}]")
        lines += [f"{key} = {_toml_value(value)}" for key, value in tables[name].items() if value is not None]
        lines.append("")
    return "\n".join(lines)


def _merged(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Keys of ``above`` over those of ``below``, table by table."""
    merged = dict(below)
    for key, value in above.items():
        # Tables merge key by key; lists and numbers replace what was there.
        both = isinstance(value, Mapping) and isinstance(merged.get(key), Mapping)
        merged[key] = _merged(merged[key], value) if both else value
    return merged


def _override(key: str, text: str) -> dict[str, Any]:
    """``training.steps``, ``100`` as nested tables."""
    table, _, rest = key.partition(".")
    if table not in TABLES or not rest:
        problem = f"expected table.key=value with a table of {', '.join(TABLES)}, found '{key}'."
        raise UsageError(f"--set {key}={text}: {problem}")
    try:
        return tomllib.loads(f"{key} = {text}")
    except tomllib.TOMLDecodeError:
        pass  # plain text needs no quotes on a command line
    try:
        return tomllib.loads(f"{key} = {_toml_value(text)}")
    except tomllib.TOMLDecodeError as error:
        raise UsageError(f"--set {key}={text}: expected table.key=value, found {error}.") from error


def _toml_value(value: Any) -> str:
    """Return a value in TOML; its strings and numbers are written as JSON writes them."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {_toml_value(item)}" for key, item in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_toml_value(item) for item in value) + "]"
    return msgspec.json.encode(value).decode()
