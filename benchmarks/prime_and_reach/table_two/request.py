"""The rows of the study's Table 2 (``table_2.toml``), what a user asks of them, and the run that each row becomes."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal

import msgspec

import prbench
from prbench.contract import Condition
from prbench.datasets import SYNTHETIC_PREFIX
from prbench.errors import PrbenchError, UsageError, did_you_mean
from prbench.files.storage import text_digest
from prbench.harness.controls import GROUND_TRUTH, GROUND_TRUTH_RESAMPLED, SCRIPTED, SHUFFLED_GOAL
from prbench.harness.methods.installed import CHEATS, NEAREST_NEIGHBOUR, list_adapters
from prbench.harness.methods.loading import load_adapter
from prbench.harness.planning import open_tables
from prbench.harness.request import DEFAULT_BATCH_SIZE, DEFAULT_PARENT, RunRequest
from prbench.protocol.manifests import read_toml
from prbench.protocol.own_protocol import read_protocol
from prbench.protocol.published import DATASETS
from prbench.sequences import SequenceTable

# Sequences of each dataset where nothing is said: all rows on five datasets take half an hour on two cores.
LIMIT = 5
# Controls that always stand beside the rows.
CONTROLS = (GROUND_TRUTH, GROUND_TRUTH_RESAMPLED, SCRIPTED)
# Controls that stand there if asked for: what the metrics give a body that cheats, and a training motion.
MORE_CONTROLS = (*CHEATS, NEAREST_NEIGHBOUR)
GOALS = (Condition.GOAL_POSE, Condition.GOAL_LOCATION)
# Settings of a table that every row's run has.
_SAME = ("split", "limit", "seed", "samples", "batch_size", "device", "threads")


class Block(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Rows under one condition.

    Attributes:
        title: Title as printed.
    """

    condition: Condition
    title: str


class RowWeights(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The weights of a row in the study.

    Attributes:
        state: Pre-trained ones were never shown a prime-and-reach sequence: zero-shot.
        trained_on: ``all`` training sequences, or the corpus.
        variant: The row's variant in the published tables in long form.
    """

    state: Literal["none", "pretrained", "finetuned"]
    trained_on: str
    variant: str


class StudyRow(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One printed row.

    Attributes:
        label: Label as printed.
        weights: Key in :attr:`TableTwo.weights`, and the name under which a user's own are found.
        bundled: Name of the weights that come with prbench for it; empty if there are none, or the method needs none.
    """

    label: str
    method: str
    weights: str
    condition: Condition
    bundled: str = ""

    @property
    def name(self) -> str:
        """Unique, and fit to be a folder's name."""
        return f"{self.condition.value}-{self.method}-{self.weights.removeprefix(f'{self.method}-')}"


class TableTwo(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The whole file."""

    table: str
    blocks: tuple[Block, ...]
    weights: dict[str, RowWeights]
    rows: tuple[StudyRow, ...]

    @property
    def methods(self) -> tuple[str, ...]:
        """Ids, in order of appearance."""
        return tuple(dict.fromkeys(row.method for row in self.rows))

    def chosen(self, method: str | None, condition: Condition | None) -> tuple[StudyRow, ...]:
        """Return the rows of one method or all, under one condition or all.

        Raises:
            UsageError: if there is none.
        """
        if method is not None and method not in self.methods:
            raise UsageError(
                f"--condition all: Table 2 has no rows of '{method}'; its methods are: {', '.join(self.methods)}."
                f"{did_you_mean(method, self.methods)} Name one condition to run another method."
            )
        rows = tuple(
            row
            for row in self.rows
            if (method is None or row.method == method) and (condition is None or row.condition == condition)
        )
        if not rows:
            raise UsageError(f"Table 2 has no rows of '{method or 'all'}' under '{condition or 'all'}'.")
        return rows


@cache
def load_table_two() -> TableTwo:
    """Return the rows as they come with prbench.

    Raises:
        InputFileError: if the file does not fit the data class (naming the key).
    """
    return read_toml("prbench_benchmarks.prime_and_reach", "table_2.toml", TableTwo)


@dataclass(frozen=True, kw_only=True)
class TableRequest:
    """Table 2, or the rows of one method or one condition, on one or several tables.

    Raises:
        UsageError: if parts of it do not fit together.

    Attributes:
        data: Dataset folders.
        method: The method; None for all.
        condition: The condition; None for all.
        weights: Folder with weights by the names of ``table_2.toml``; those that come with prbench take the place of
            others.
        options: Maps ``method.key`` to a value; a table of one method takes plain keys too.
        limit: Sequences of each dataset.
        batch_size: Sequences of a batch.
        protocol: The user's own protocol; None for prbench's.
        shuffled_goal: True if every goal row stands there with other sequences' goals, too.
        more_controls: True if :data:`MORE_CONTROLS` stand beside the rows, too.
        out: Folder of the table; by default one under ``runs`` whose name says what was asked.
    """

    data: tuple[Path, ...]
    method: str | None = None
    condition: Condition | None = None
    weights: Path | None = None
    options: Mapping[str, str] = field(default_factory=dict)
    split: str = "test"
    limit: int = LIMIT
    seed: int = 0
    samples: int = 1
    batch_size: int = DEFAULT_BATCH_SIZE
    device: str = "cpu"
    threads: int = 1
    protocol: Path | None = None
    shuffled_goal: bool = False
    more_controls: bool = False
    out: Path | None = None

    def __post_init__(self) -> None:
        if not self.data:
            raise UsageError("a table needs one dataset folder or more (--data DIR).")
        load_table_two().chosen(self.method, self.condition)
        if self.weights is not None and not any(self.user_weights(name) for name in load_table_two().weights):
            found = "a folder without any" if self.weights.is_dir() else "no folder"
            problem = f"expected a folder of weights for a table, found {found}."
            remedy = f"It holds NAME or NAME.safetensors for one or more of: {', '.join(load_table_two().weights)}."
            raise UsageError(f"--weights {self.weights}: {problem} {remedy}")
        for key in self.options:
            method = key.partition(".")[0] if "." in key else self.method
            if method is None or method not in load_table_two().methods:
                problem = f"expected METHOD.{key.rpartition('.')[2]}=… for a table of several methods;"
                why = f"these are: {', '.join(load_table_two().methods)}."
                raise UsageError(f"--option {key}=…: {problem} {why}")

    @property
    def rows(self) -> tuple[StudyRow, ...]:
        """The rows that are asked for, in printed order."""
        return load_table_two().chosen(self.method, self.condition)

    def options_of(self, method: str) -> dict[str, str]:
        """Return the options of one method."""
        # A key with a method's name in front wins over a plain one.
        plain = {key: value for key, value in self.options.items() if "." not in key}
        own = {key.partition(".")[2]: value for key, value in self.options.items() if key.startswith(f"{method}.")}
        return plain | own

    def user_weights(self, name: str) -> Path | None:
        """Return the user's own weights of this name: a file, or a folder such as ``prbench train`` leaves."""
        if self.weights is None:
            return None
        paths = (self.weights / name, self.weights / f"{name}.safetensors")
        return next((path for path in paths if path.exists()), None)

    def tables(self) -> list[SequenceTable]:
        """Return the tables, in the study's order, others behind by name.

        Raises:
            TableError: if one is missing, empty or of an unknown version.
            UsageError: if datasets repeat.
        """
        return sorted(open_tables(self.data), key=lambda table: study_place(table.info.dataset))

    def folder(self) -> Path:
        """Return the folder of the table; the same request finds its folder again."""
        if self.out is not None:
            return self.out
        tables = self.tables()
        datasets = "+".join(table.info.dataset for table in tables)
        weights = "" if self.weights is None else os.path.realpath(self.weights)
        # The digest makes the folder's name the same for the same request and another one for any other, so that a
        # repeated command resumes and nothing is mixed.
        decided = (part for pair in self.deciding(tables).items() for part in pair)
        name = f"table-2-{datasets}-{text_digest(weights, *decided)[:8]}"
        return DEFAULT_PARENT / re.sub(r"[^\w.+-]", "_", name)

    def deciding(self, tables: list[SequenceTable]) -> dict[str, str]:
        """Map the user's name of everything that decides the rows to its value; empty where it was left to prbench.

        The weights do not stand here: the run folder of each row records its own.
        """
        settings = {
            "version of prbench": prbench.__version__,
            "--method": self.method or "all",
            "--condition": self.condition.value if self.condition is not None else "all",
            "--option": " ".join(f"{key}={value}" for key, value in sorted(self.options.items())),
            **{f"--{name.replace('_', '-')}": str(getattr(self, name)) for name in _SAME},
            "--control": SHUFFLED_GOAL if self.shuffled_goal else "",
        }
        if self.more_controls:
            settings["--with-controls"] = "yes"
        if self.protocol is not None:
            settings["--protocol"] = read_protocol(self.protocol).digest
        return settings | {f"table {table.info.dataset}": f"{table.identity} {table.content}" for table in tables}


def study_place(dataset: str) -> tuple[int, str]:
    """Return the place of a dataset among the study's; others stand behind, by name."""
    plain = dataset.removeprefix(SYNTHETIC_PREFIX)
    return (DATASETS.index(plain) if plain in DATASETS else len(DATASETS), dataset)


@dataclass(frozen=True)
class PlannedRow:
    """One line of the table.

    Attributes:
        name: Unique; the name of its run folder.
        label: Label as printed.
        skipped: The reason why it is not run; None for a row that is.
    """

    name: str
    label: str
    run: RunRequest
    skipped: str | None = None

    @property
    def condition(self) -> Condition:
        """The condition that it is run under."""
        assert self.run.condition is not None, "every row names its condition"
        return Condition(self.run.condition)


def plan_rows(request: TableRequest, data: tuple[Path, ...], folder: Path) -> list[PlannedRow]:
    """Plan all lines in printed order, controls last.

    A row without a method or weights is skipped; whatever else is wrong with it is a failure of its run.

    Args:
        request: What is asked for.
        data: Its dataset folders, in printed order.
        folder: Folder of the table; every row gets a run folder in it.

    Raises:
        AdapterError: if a method refuses its options or the device.
    """
    base = RunRequest(
        method=GROUND_TRUTH,
        # A control does the same under every condition; one has to be recorded.
        condition=request.condition or Condition.GOAL_LOCATION,
        data=data,
        protocol=request.protocol,
        **{name: getattr(request, name) for name in _SAME},
    )
    installed = {adapter.name for adapter in list_adapters() if not adapter.problem}
    planned = []
    for row in request.rows:
        own = request.user_weights(row.weights)
        weights = Path(row.bundled) if own is None and row.bundled else own
        about: dict[str, Any] = {"weights": weights, "options": request.options_of(row.method)}
        out = folder / "rows" / row.name
        run = replace(base, method=row.method, condition=row.condition, out=out, **about)
        reason = f"no method '{row.method}' is installed"
        if row.method in installed:
            # The user's own weights are not opened here: what is wrong with them is a failure of the row.
            reason = None if own is not None else _why_no_weights(row, run)
        planned.append(PlannedRow(row.name, row.label, run, skipped=reason))
    names = (*CONTROLS, *MORE_CONTROLS) if request.more_controls else CONTROLS
    controls = [PlannedRow(name, name, replace(base, method=name, out=folder / "rows" / name)) for name in names]
    shuffled = []
    for row in planned:
        if request.shuffled_goal and row.condition in GOALS:
            name = f"{row.name}-{SHUFFLED_GOAL}"
            run = replace(row.run, control=SHUFFLED_GOAL, out=folder / "rows" / name)
            label = f"{row.label}, {row.condition.value}, {SHUFFLED_GOAL}"
            shuffled.append(replace(row, name=name, label=label, run=run))
    return planned + controls + shuffled


def _why_no_weights(row: StudyRow, run: RunRequest) -> str | None:
    """Return why no weights are found for a row without the user's own; None if some are found, or none are needed."""
    weights = load_table_two().weights[row.weights]
    if weights.state == "none":
        return None
    if not row.bundled:
        return f"no weights ({weights.variant}) come with prbench; --weights FOLDER with '{row.weights}' gives some"
    try:
        load_adapter(row.method, run.weights, {}, "cpu")
    except PrbenchError as error:
        return f"its weights ({weights.variant}) are not there: {error}"
    if run.options or run.device != "cpu":  # a mistyped option shows before hours of work
        load_adapter(row.method, run.weights, run.options, run.device)
    return None
