"""Plan the runs of the rows: which can be run here, with which weights, and why the others cannot."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from prbench.contract import Condition
from prbench.errors import PrbenchError
from prbench.harness.controls import GROUND_TRUTH, SHUFFLED_GOAL
from prbench.harness.methods.installed import list_adapters
from prbench.harness.methods.loading import load_adapter
from prbench.harness.request import RunRequest
from prbench_benchmarks.prime_and_reach.table_two.request import (
    CONTROLS,
    MORE_CONTROLS,
    Row,
    TableRequest,
    load_table_two,
)

ALL = "all"
"""The value of ``--method`` or ``--condition`` that asks for all that Table 2 has."""
_ROWS_FOLDER = "rows"
GOALS = (Condition.GOAL_POSE, Condition.GOAL_LOCATION)


@dataclass(frozen=True)
class PlannedRow:
    """One line of the printed table."""

    name: str
    """Unique; the name of its run folder."""
    label: str
    """Label as printed."""
    row: Row | None
    """The study's row; None for a control."""
    run: RunRequest
    """The run without limit and size of batches, which follow later."""
    skipped: str | None = None
    """The reason why it is not run; None for a row that is."""
    stands_in: bool = False
    """True if bundled weights take the place of the study's."""

    @property
    def condition(self) -> Condition:
        """The condition that it is run under."""
        assert self.run.condition is not None, "every row names its condition"
        return Condition(self.run.condition)

    @property
    def is_control(self) -> bool:
        """Made by the harness, or with other sequences' goals."""
        return self.row is None or self.run.control is not None

    def limited(self, limit: int, batch_size: int) -> RunRequest:
        """Its run on this many sequences of each dataset."""
        return replace(self.run, limit=limit, batch_size=batch_size)


def plan_rows(request: TableRequest, data: tuple[Path, ...], folder: Path) -> list[PlannedRow]:
    """Plan all lines in printed order, controls last.

    Args:
        request: What is asked for.
        data: Its dataset folders, in printed order.
        folder: Of the table; every row gets a run folder in it.

    Raises:
        AdapterError: if a method refuses its options or the device.
    """
    planned = [_planned(request, row, data, folder) for row in request.rows]
    names = (*CONTROLS, *MORE_CONTROLS) if request.more_controls else CONTROLS
    controls = [_control(request, name, data, folder) for name in names]
    shuffled = [_shuffled(row, folder) for row in planned if row.run.condition in GOALS]
    return planned + controls + (shuffled if request.shuffled_goal else [])


def _planned(request: TableRequest, row: Row, data: tuple[Path, ...], folder: Path) -> PlannedRow:
    own = request.user_weights(row)
    weights = own
    if own is None and row.bundled:
        weights = Path(row.bundled)
    run = replace(
        _base(request, data),
        method=row.method,
        condition=row.condition,
        weights=weights,
        options=request.options_of(row.method),
        out=folder / _ROWS_FOLDER / row.name,
    )
    reason = _why_skipped(row, run, own=own is not None)
    return PlannedRow(row.name, row.label, row, run, reason, stands_in=own is None and bool(row.bundled))


def _why_skipped(row: Row, run: RunRequest, *, own: bool) -> str | None:
    """A row without a method or weights is skipped; whatever else is wrong with it is a failure of its run."""
    weights = load_table_two().weights[row.weights]
    if row.method not in {adapter.name for adapter in list_adapters() if not adapter.problem}:
        return f"no method '{row.method}' is installed"
    # The user's own weights are not opened here: what is wrong with them is a failure of the row, with its own
    # message.
    if own or weights.state == "none":
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


def _shuffled(planned: PlannedRow, folder: Path) -> PlannedRow:
    """The same with other sequences' goals."""
    name = f"{planned.name}-{SHUFFLED_GOAL}"
    run = replace(planned.run, control=SHUFFLED_GOAL, out=folder / _ROWS_FOLDER / name)
    label = f"{planned.label}, {planned.condition.value}, {SHUFFLED_GOAL}"
    return replace(planned, name=name, label=label, run=run)


def _control(request: TableRequest, name: str, data: tuple[Path, ...], folder: Path) -> PlannedRow:
    # A control does the same under every condition; one has to be recorded.
    condition = request.condition or Condition.GOAL_LOCATION
    run = replace(_base(request, data), method=name, condition=condition, out=folder / _ROWS_FOLDER / name)
    return PlannedRow(name, name, None, run)


def _base(request: TableRequest, data: tuple[Path, ...]) -> RunRequest:
    return RunRequest(
        method=GROUND_TRUTH,
        data=data,
        split=request.split,
        seed=request.seed,
        samples=request.samples,
        device=request.device,
        threads=request.threads,
        protocol=request.protocol,
    )
