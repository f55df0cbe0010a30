"""``prbench analyse errors``: why the motions of runs fail, and what each part of a method costs."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from prbench.cli.commands import Answer, progress
from prbench.cli.terminal import print_columns
from prbench_benchmarks.prime_and_reach.error_budget.report import ErrorBudgetReport, Group, Parts, RunBudget

_TITLES = {"prime_success": "Prime Success", "reach_success": "Reach Success"}
_LOOKING = ("does not slow", "does not stay", "looks early", "looks late", "misses", "never looks")
_LOOKING_SHORT = ("slow", "stay", "early", "late", "miss", "never")
_REACHING = ("stands too far", "comes and leaves", "under way", "stops short")
_REACHING_SHORT = ("too far", "leaves", "under way", "short")


def error_budget(runs: tuple[Path, ...], *, beside: Path | None, data: tuple[Path, ...], out: Path | None) -> Answer:
    """Say why the motions of runs fail, one cause each, and what explains the rest."""
    from prbench.harness.first_run import table_finder
    from prbench_benchmarks.prime_and_reach.error_budget.of_runs import error_budget as budget_of

    with progress("diagnosing") as show:
        report = budget_of(runs, beside=beside, find_table=table_finder(data), out=out, progress=show)
    return Answer(report, lambda: _print(report))


def _print(report: ErrorBudgetReport) -> None:
    for budget in report.runs:
        _print_head(budget)
        _print_looking(budget)
        rows = [("recorded people", *_miss_cells(budget.people_groups[0]))]
        rows += [(_label(own), *_miss_cells(own)) for own in budget.method_groups]
        _print_rows(
            "Best frame of the window (medians), and the share that would stay on the goal, %",
            ("miss °", "up °", "aside °", "at s", "stays", "if its height", "if its side"),
            rows,
        )
        _print_gains(budget)
        _print_reaching(budget)
        _print_bodies(budget)
        _print_parts(budget)
        _print_beside(budget)
        if budget.synthetic:
            print("\nThese are motions beside synthetic people: never compare their scores with published ones.")
    if report.out is not None:
        print(f"one row a motion: {report.out / 'motions.csv'}")


def _print_head(budget: RunBudget) -> None:
    everything = budget.method_groups[0]
    options = ", ".join(f"{name}={value}" for name, value in budget.options.items())
    print(f"{budget.run.name}: {budget.method}, {budget.condition}{f' ({options})' if options else ''}")
    print(
        f"split {budget.split}: {everything.sequences} sequences of {everything.recordings} recordings,"
        f" {budget.samples} {'motion' if budget.samples == 1 else 'motions'} each"
    )


def _print_looking(budget: RunBudget) -> None:
    rows = [("recorded people", *_looking_cells(budget.people_groups[0], budget.people_groups[0]))]
    rows += [(_label(own), *_looking_cells(own, people)) for own, people in _pairs(budget)]
    _print_rows("Prime Success, and why motions are not primed, %", ("n", "people", "primed", *_LOOKING_SHORT), rows)


def _looking_cells(own: Group, people: Group) -> tuple[str, ...]:
    causes = [_percent(own.looking[cause]) for cause in _LOOKING]
    return (str(own.sequences), _percent(people.primed), _percent(own.primed), *causes)


def _miss_cells(group: Group) -> tuple[str, ...]:
    return (
        _number(group.miss_deg, 1),
        _number(group.miss_up_deg, 1, signed=True),
        _number(group.miss_aside_deg, 1),
        _number(group.look_time, 2, signed=True),
        _percent(group.stays),
        _percent(group.stays_with_elevation),
        _percent(group.stays_with_azimuth),
    )


def _print_gains(budget: RunBudget) -> None:
    lines = {(line.layout, line.angle, line.who): line for line in budget.gains}
    whos = [who for who in ("people", "method", "beside") if any(line.who == who for line in budget.gains)]
    rows = []
    for layout, angle in dict.fromkeys((line.layout, line.angle) for line in budget.gains):
        found = [lines.get((layout, angle, who)) for who in whos]
        cells = ["–" if line is None else f"{line.slope:.2f} (r {line.correlation:.2f})" for line in found]
        rows.append((f"{_layout(layout)}, {angle}", *cells))
    _print_rows("Gain: slope of the ray's angle against the goal's, best frame", whos, rows)


def _print_reaching(budget: RunBudget) -> None:
    rows = [("recorded people", *_reaching_cells(budget.people_groups[0], budget.people_groups[0]))]
    rows += [(_label(own), *_reaching_cells(own, people)) for own, people in _pairs(budget)]
    header = ("n", "people", "reached", *_REACHING_SHORT, "nearest m")
    _print_rows("Reach Success, and why goals are not reached, %", header, rows)


def _reaching_cells(own: Group, people: Group) -> tuple[str, ...]:
    causes = [_percent(own.reaching[cause]) for cause in _REACHING]
    rates = (str(own.sequences), _percent(people.reached), _percent(own.reached))
    return (*rates, *causes, _number(own.smallest, 2))


def _print_bodies(budget: RunBudget) -> None:
    rows = [("recorded people", *_body_cells(budget.people_groups[0]))]
    rows += [(_label(own), *_body_cells(own)) for own in budget.method_groups]
    header = ("skating", "slow slides", "before", "way", "end", "bones", "worst bone")
    _print_rows("Feet and bones: shares of frames that slide, by phase; change of a bone, %", header, rows)


def _body_cells(group: Group) -> tuple[str, ...]:
    phases = [_percent(group.slides_in[phase]) for phase in ("before", "way", "end")]
    bone = next(iter(group.worst_bones))
    shares = (_percent(group.skating), _percent(group.slides), *phases, _percent(group.bone_change))
    return (*shares, f"{bone} {_percent(group.worst_bones[bone])}")


def _print_parts(budget: RunBudget) -> None:
    for metric, title in _TITLES.items():
        found = [each for each in budget.parts if each.metric == metric]
        k = budget.samples
        header = ("n", "always", "noise", "optim.", "repr.", "not learnt", "nobody", f"best of {k}", "features")
        rows = [(_layout(each.layout), *_part_cells(each)) for each in found]
        _print_rows(f"{title}: where sequences are lost, %", header, rows)


def _part_cells(each: Parts) -> tuple[str, ...]:
    shares = (each.always, each.noise, each.optimisation, each.representation, each.not_learnt, each.nor_people)
    return (str(each.sequences), *map(_percent, shares), _percent(each.best_of_k), _percent(each.through_features))


def _print_beside(budget: RunBudget) -> None:
    rows = [
        (
            _TITLES[each.metric],
            str(each.sequences),
            _percent(each.rate),
            _percent(each.rate_beside),
            _percent(each.gained),
            _percent(each.lost),
        )
        for each in budget.beside
    ]
    if rows:
        title = f"Beside {budget.beside[0].run.name}, on the sequences of both, %"
        _print_rows(title, ("n", "this run", "beside", "beside alone", "this run alone"), rows)


def _pairs(budget: RunBudget) -> list[tuple[Group, Group]]:
    people = {(group.by, group.name): group for group in budget.people_groups}
    return [(group, people[group.by, group.name]) for group in budget.method_groups]


def _print_rows(title: str, header: Iterable[str], rows: Iterable[tuple[str, ...]]) -> None:
    print(f"\n{title}")
    print_columns(("", *header), list(rows))


def _label(group: Group) -> str:
    if group.by in ("all", "layout"):
        return _layout(group.name)
    return f"{group.by} {group.name}"


def _layout(name: str) -> str:
    return name.removeprefix("synthetic-")


def _percent(value: float | None) -> str:
    return "–" if value is None else f"{100 * value:.0f}"


def _number(value: float | None, places: int, *, signed: bool = False) -> str:
    if value is None:
        return "–"
    return f"{value:{'+' if signed else ''}.{places}f}"
