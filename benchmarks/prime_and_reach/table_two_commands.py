"""``prbench run --method all --condition all``: Table 2, its rows run one after the other, printed in its layout."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from prbench.cli.commands import Answer, note, progress
from prbench.cli.options import embedded_tables, opened
from prbench.cli.terminal import print_tables
from prbench.errors import UsageError

if TYPE_CHECKING:
    from prbench.engine.choice import EngineChoice
    from prbench.harness.request import ProgressCallback
    from prbench_benchmarks.prime_and_reach.table_two.request import PlannedRow

_ALL = "all"
_WORKERS = 2
_SINGLE_RUN = {"sequences": "sequence", "isolate": "isolate", "timeout": "timeout", "fold": "fold"}


def run_table_two(given: Mapping[str, Any], *, choice: EngineChoice) -> Answer:
    """Run what is missing of the table; the exit code is 1 if a row failed."""
    from prbench.contract import Condition
    from prbench.harness.request import DEFAULT_PARENT
    from prbench_benchmarks.prime_and_reach.table_two.request import TableRequest
    from prbench_benchmarks.prime_and_reach.table_two.run import JSON, MARKDOWN, run_table

    places = {"reads": tuple(given["data"]), "writes": (given["out"] or DEFAULT_PARENT / "table",)}
    engine = opened(choice, usual=_WORKERS, threads=given["threads"], **places)
    data = tuple(given["data"]) or embedded_tables(engine)
    for name, option in _SINGLE_RUN.items():
        if given[name]:
            raise UsageError(f"--{option}: belongs to a run of one method under one condition; leave it out.")
    same = ("weights", "split", "seed", "device", "threads", "protocol", "out")
    numbers = {name: given[name] for name in ("limit", "samples", "batch_size") if given[name] is not None}
    request = TableRequest(
        data=data,
        method=None if given["method"] == _ALL else given["method"],
        condition=None if given["condition"] in (_ALL, None) else Condition(given["condition"]),
        options=dict(given["options"]),
        shuffled_goal=given["control"] is not None,
        more_controls=given["with_controls"],
        **{name: given[name] for name in same},
        **numbers,
    )
    report = run_table(request, engine=engine, notice=note, progress=_row_progress)
    for name in report.failed:
        note(f"failed: {name}; the same command tries it again")

    def show() -> None:
        print_tables(report.tables, between="\n")
        print(f"table: {report.folder / MARKDOWN}, {report.folder / JSON}")
        print(f"beside the study's numbers: prbench study table-2 {report.folder} --data DIR... --with-published")

    return Answer(report, show, exit_code=1 if report.failed else 0)


@contextlib.contextmanager
def _row_progress(planned: PlannedRow) -> Iterator[ProgressCallback]:
    with progress(f"scoring {planned.name}") as show:
        yield lambda step: show(step.done, step.total, f"{step.stage} {step.dataset}")
