"""``prbench analyse agreement``: on which sequences methods succeed: those of people, and by where the goal is."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from prbench.datasets import ON_SYNTHETIC_DATA
from prbench.harness.results import RunChecker
from prbench.harness.run_folder import DatasetAgreement, RunFolder
from prbench.tables import Block, Cell, Column, Row, Table, metric_cell

_UNITS = {"bearing": "°", "distance": " m", "height": " m"}
_METRIC = Column(key="metric", title="metric", text=True)
_PEOPLE = Column(key="people", title="people", unit="%")
_AGREEMENT = (_METRIC, Column(key="phi", title="phi"), _PEOPLE, Column(key="remark", title="", text=True))
_BY_PLACE = (
    _METRIC,
    Column(key="goal", title="goal", text=True),
    Column(key="sequences", title="sequences"),
    Column(key="recordings", title="recordings"),
    Column(key="mean", title="mean", unit="%"),
    _PEOPLE,
)


def agreement_tables(runs: Sequence[Path], checker: RunChecker) -> list[Table]:
    """Lay out for each run and dataset the agreement with recorded people, and the rates by the goal's place.

    Args:
        runs: Finished run folders.
        checker: Holds the tables at hand, on which the scores are checked.

    Raises:
        RunError: if a run is damaged, or its files do not follow from one another.
    """
    tables = []
    for path in runs:
        run = RunFolder.open(path)
        for record in run.record.tables:
            unverified = checker.check(run, record).unverified
            found = DatasetAgreement.read(run.dataset(record.dataset).path)
            title = f"{path.name}: {run.record.method.name} (declared) on {record.dataset}"
            notes = []
            if unverified:
                notes.append(f"unverified: {unverified}")
            if record.synthetic:
                notes.append(ON_SYNTHETIC_DATA)
            rates = []
            for rate in found.rates:
                about = {name: getattr(rate, name) for name in ("low", "high", "sequences", "recordings")}
                phi = Cell(metric="phi", value=rate.phi, **about)
                words = {"metric": rate.title, "remark": rate.remark}
                rates.append(Row(text=words, cells=(phi, metric_cell("people", "rate", rate.people))))
            bins = []
            for each in found.breakdown:
                unit = _UNITS[each.by]
                end = f"from {each.begin:g}{unit}" if each.end is None else f"{each.begin:g} to {each.end:g}{unit}"
                words = {"metric": each.title, "goal": f"{each.by} {end}"}
                words |= {"sequences": str(each.sequences), "recordings": str(each.recordings)}
                mean = metric_cell("mean", "rate", each.mean, each.low, each.high)
                bins.append(Row(text=words, cells=(mean, metric_cell("people", "rate", each.people))))
            by_sequence = f"{title}: agreement with recorded people, sequence by sequence"
            by_place = f"{title}: by where the goal is, seen from the first pose"
            said = "phi from -1 to 1, 0 is unrelated; 95 % intervals in brackets."
            tables += [
                Table(title=by_sequence, columns=_AGREEMENT, blocks=(Block(rows=tuple(rates)),), notes=(said,)),
                Table(title=by_place, columns=_BY_PLACE, blocks=(Block(rows=tuple(bins)),), notes=tuple(notes)),
            ]
    return tables
