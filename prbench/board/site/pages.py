"""The pages of a site as HTML: every table and sentence stands in them, scripts only sort, filter and draw."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from string import Template
from typing import Any

from prbench.board.collect import COSTS
from prbench.board.export import measured_cells, part_title, table_notes
from prbench.board.site.motions import ShownSequence, json
from prbench.board.site.numbers import MOST_FAILURES, SiteRun, failures_of, prime_timing, spread_of
from prbench.board.tables import DatasetTable, Leaderboard, MacroTable, TableRow, hides
from prbench.harness.benchmark import Benchmark, load_benchmark
from prbench.metrics import MetricInfo, printed_unit
from prbench.protocol.published import load_published, published_table
from prbench.sequences.table import SequenceTable
from prbench.shown import html

_PUBLISHED = "2"  # table of the study


@dataclass(frozen=True)
class About:
    """What all pages of a board say.

    Attributes:
        title: Title of the board.
        cite: BibTeX of what is to be cited.
    """

    title: str
    cite: str


@dataclass(frozen=True)
class Line:
    """A row of a table of several methods.

    Attributes:
        told: Values by which scripts filter, by their names.
        name: The method, as HTML.
        values: Mean and bounds of each metric by its id, as stored.
        ranks: Ranks by metric.
        leads: Metrics in which it is better than all others by a supported difference.
        seconds: Seconds a motion; None where nothing was measured.
    """

    told: Mapping[str, str]
    name: str
    values: Mapping[str, tuple[float, float | None, float | None]]
    ranks: Mapping[str, int]
    leads: frozenset[str] = frozenset()
    seconds: float | None = None


def index_page(
    about: About, board: Leaderboard, tables: Mapping[str, DatasetTable], runs: Sequence[SiteRun], report: Any
) -> str:
    """Return the page of all tables."""
    sections = []
    for number, macro in enumerate(board.macro, start=1):
        sections.append(_macro_section(f"mean-{number}" if number > 1 else "mean", macro, runs))
    sections += [_dataset_section(name, table, runs) for name, table in tables.items()]
    published = [_published(name, table.benchmark) for name, table in _datasets(tables).items()]
    facts = [_counted(len(tables), "table"), _counted(len(runs), "run")]
    benchmarks = dict.fromkeys(f"{table.benchmark.about.title}" for table in tables.values())
    protocols = dict.fromkeys(table.rows[0].entry.record.protocol_version for table in tables.values())
    facts += [*benchmarks, f"protocol version {', '.join(map(str, protocols))}"]
    body = Template(asset("index.html")).substitute(
        title=html(about.title),
        facts="".join(f"<li>{html(fact)}</li>" for fact in facts),
        boards="\n".join(sections),
        published="\n".join(published),
        left_out=_listed(report.left_out) or "<p>Nothing was left out.</p>",
        cite=html_block(about.cite),
    )
    return _page(about, about.title, body, scripts=("board.js",))


def run_page(
    about: About,
    run: SiteRun,
    tables: Mapping[str, DatasetTable],
    at_hand: Mapping[str, SequenceTable],
    shown: Mapping[str, Sequence[ShownSequence]],
) -> str:
    """Return the page of one run."""
    parts = []
    told = []
    for name, row in run.rows.items():
        table = tables[name]
        entry = row.entry
        parts.append(_measured_section(name, table, row))
        failures = failures_of(run.scores[name], entry.benchmark)
        timed = name in at_hand and not entry.unverified and entry.benchmark.about.default
        infos = entry.benchmark.main_metrics
        one = {
            "table": name,
            "title": part_title(table),
            "metrics": [_told_metric(info) for info in infos if not hides(entry, info)],
            "spread": spread_of(run.scores[name], entry),
            "means": {metric.metric: _scaled(metric, entry.benchmark) for metric in entry.summary.metrics},
            "failures": failures[:MOST_FAILURES],
            "failed": len(failures),
            "scored": len(next(iter(run.scores[name].values()), ((), ()))[0]),
            "timing": prime_timing(run.folder, at_hand[name]) if timed else None,
            "motions": name in shown,
        }
        told.append(one)
    first = run.first
    scripts = [f"../motions/{name}.js" for name in run.rows if name in shown]
    body = Template(asset("run.html")).substitute(
        title=html(run.label),
        variant=html(next(iter(run.rows.values())).variant),
        badges=_badges(first),
        facts="".join(f"<div><dt>{html(key)}</dt><dd>{html(value)}</dd></div>" for key, value in _provenance(run)),
        remarks=_listed(_remarks(run)),
        tables="\n".join(parts),
        data=json({"run": run.key, "label": run.label, "tables": told}).decode(),
    )
    return _page(about, f"{run.label} · {about.title}", body, root="../", scripts=("run.js",), data=scripts)


def compare_page(about: About, runs: Sequence[SiteRun], shown: Sequence[str], report: Any) -> str:
    """Return the page on which two runs are compared; ``shown`` are the tables with motions."""
    told = [{"run": run.key, "label": run.label, "tables": list(run.rows)} for run in runs]
    body = Template(asset("compare.html")).substitute(
        left_out=_listed([report.pairs_left_out] if report.pairs_left_out else []),
        data=json({"runs": told, "shown": shown}).decode(),
    )
    return _page(about, f"Compare · {about.title}", body, scripts=("compare.js",))


def _page(
    about: About, title: str, body: str, *, root: str = "", scripts: Sequence[str], data: Sequence[str] = ()
) -> str:
    # What hands values over stands before the script that draws them.
    named = [f"{root}assets/site.js", *data, *(f"{root}assets/{name}" for name in scripts)]
    return Template(asset("page.html")).substitute(
        title=html(title),
        board=html(about.title),
        root=root,
        body=body,
        scripts="\n".join(f'<script src="{html(name)}"></script>' for name in named),
    )


def asset(name: str) -> str:
    """Return one of the files that stand beside this module."""
    return (files("prbench.board.site") / "assets" / name).read_text(encoding="utf-8")


def _dataset_section(name: str, table: DatasetTable, runs: Sequence[SiteRun]) -> str:
    lines = []
    for run in runs:
        row = run.rows.get(name)
        if row is None:
            continue
        entry = row.entry
        values = {}
        for metric in entry.summary.metrics:
            info = next((info for info in table.benchmark.main_metrics if info.id == metric.metric), None)
            if info is not None and not hides(entry, info):
                values[metric.metric] = (metric.mean, metric.low, metric.high)
        told = _told(entry.record.condition, entry.is_control, entry.unverified, entry.training)
        label = f"{entry.method} {entry.summary.symbols}".strip()
        shown = _method(label, row.variant, f"runs/{run.key}.html", entry)
        lines.append(Line(told, shown, values, row.ranks, row.leads, entry.cost["seconds"]))
    notes = [*table_notes(table)]
    if table.redistribution != "yes":
        notes.append(f"Licence of the data: {table.redistribution}.")
    return _section(name, part_title(table), table.dataset, table.split, table.benchmark, lines, notes)


def _macro_section(name: str, macro: MacroTable, runs: Sequence[SiteRun]) -> str:
    benchmark = load_benchmark(macro.benchmark)
    lines = []
    for row in macro.rows:
        same = (
            run
            for run in runs
            if (run.first.method, run.first.record.condition, run.first.origin)
            == (row.method, row.condition, row.origin)
            and next(iter(run.rows.values())).variant == row.variant
        )
        run = next(same, None)
        values = {metric: (mean.mean, mean.low, mean.high) for metric, mean in row.means.items()}
        told = _told(
            row.condition,
            row.is_control,
            "unverified" if row.unverified else "",
            row.training,
        )
        missing = f"lacks {', '.join(row.missing)}" if row.missing else ""
        variant = "; ".join(part for part in (row.variant, missing) if part)
        label = f"{row.method} {row.symbols}".strip()
        shown = _method(label, variant, f"runs/{run.key}.html" if run else "", run.first if run else None)
        costs = [each.entry.cost["seconds"] for each in run.rows.values()] if run and not row.missing else []
        known = [seconds for seconds in costs if seconds is not None]
        mean = sum(known) / len(known) if known and len(known) == len(costs) else None
        lines.append(Line(told, shown, values, row.ranks, seconds=mean))
    word = ", synthetic data among them" if macro.synthetic else ""
    title = f"Mean over {len(macro.datasets)} datasets{word}"
    notes = [
        f"Every dataset counts alike: {', '.join(macro.datasets)}. A group holds the methods of a condition than which"
        " equally many others are better on every dataset by a supported difference."
    ]
    return _section(name, title, "all", "", benchmark, lines, notes)


def _told(condition: str, control: bool, unverified: str, training: str) -> dict[str, str]:
    return {
        "condition": "control" if control else condition,
        "verified": "unverified" if unverified else "verified",
        "training": training,
    }


def _section(
    name: str,
    title: str,
    dataset: str,
    split: str,
    benchmark: Benchmark,
    lines: Sequence[Line],
    notes: Sequence[str],
) -> str:
    """Return one table of several methods with its notes."""
    heads = ['<th scope="col" data-key="group">Group</th><th scope="col" data-key="method">Method</th>']
    heads.append('<th scope="col" data-key="condition">Given</th>')
    for info in benchmark.main_metrics:
        told = _attributes({"key": info.id, "unit": printed_unit(info.unit).strip(), "ranked": str(info.ranked)})
        heads.append(f'<th scope="col" class="number"{told}>{html(info.title)}{html(info.arrow)}</th>')
    heads.append('<th scope="col" class="number" data-key="seconds" data-unit="s">Seconds ↓</th>')
    rows = []
    ranked = benchmark.ranked_metrics[0].id
    for line in lines:
        cells = [f'<td class="group">{line.ranks.get(ranked, "–")}</td>', f'<th scope="row">{line.name}</th>']
        cells.append(f"<td>{html(line.told['condition'])}</td>")
        for info in benchmark.main_metrics:
            cells.append(_number(line.values.get(info.id), info, line.ranks.get(info.id), info.id in line.leads))
        seconds = "" if line.seconds is None else f"{line.seconds:.3g}"
        cells.append(f'<td class="number" data-value="{seconds}">{seconds or "–"}</td>')
        rows.append(f"<tr{_attributes(line.told)}>{''.join(cells)}</tr>")
    about = _attributes({"dataset": dataset, "split": split, "ranked": ranked})
    return (
        f'<section class="board" id="table-{name}"{about}>\n<h2>{html(title)}</h2>\n'
        f'<div class="scroll" tabindex="0" role="region" aria-label="{html(title)}"><table>\n'
        f"<caption>{html(title)}</caption>\n<thead><tr>{''.join(heads)}</tr></thead>\n<tbody>\n"
        + "\n".join(rows)
        + f'\n</tbody></table></div>\n<details class="notes"><summary>How to read this table</summary>{_listed(notes)}'
        "</details>\n</section>"
    )


def _number(
    value: tuple[float, float | None, float | None] | None, info: MetricInfo, rank: int | None, leads: bool
) -> str:
    """Return the cell of a metric, with its numbers for scripts."""
    if value is None:
        return '<td class="number" data-value="">–</td>'
    mean, low, high = (None if each is None else info.scale * each for each in value)
    assert mean is not None
    digits = 1 if info.unit == "rate" else 2
    told = {"value": f"{mean:.6g}", "rank": "" if rank is None else str(rank)}
    interval = ""
    if low is not None and high is not None:
        told |= {"low": f"{low:.6g}", "high": f"{high:.6g}"}
        interval = f' <span class="interval">[{low:.{digits}f}, {high:.{digits}f}]</span>'
    tag = "strong" if leads else "span"
    return f'<td class="number"{_attributes(told)}><{tag}>{mean:.{digits}f}</{tag}>{interval}</td>'


def _method(label: str, variant: str, href: str, entry: Any) -> str:
    shown = f'<a href="{href}">{html(label)}</a>' if href else html(label)
    small = f'<span class="variant">{html(variant)}</span>' if variant else ""
    return f"{shown}{'' if entry is None else _badges(entry)}{small}"


def _badges(entry: Any) -> str:
    badges = []
    if entry.is_control:
        badges.append('<span class="badge control">control</span>')
    if entry.unverified:
        badges.append(f'<span class="badge open" title="{html(entry.unverified)}">unverified</span>')
    else:
        badges.append(f'<span class="badge sure">{html(entry.verified)}</span>')
    return f'<span class="badges">{"".join(badges)}</span>'


def _measured_section(name: str, table: DatasetTable, row: TableRow) -> str:
    """Return all scores of a run on one dataset, and the places of its charts."""
    titles = {info.id: info for info in table.benchmark.metrics}
    rows = []
    for cell in measured_cells(row, table):
        info = titles[cell.metric]
        mean = "–" if cell.value is None else f"{cell.value:.2f}{printed_unit(info.unit)}"
        interval = "–" if cell.low is None or cell.high is None else f"[{cell.low:.2f}, {cell.high:.2f}]"
        rows.append((f"{info.title}{info.arrow}", mean, interval, cell.sequences, cell.recordings, cell.note))
    head = ("Metric", "Mean", "95 % interval", "Sequences", "Recordings", "Remarks")
    cost = [f"{COSTS[key][0]}: {value:.4g}" for key, value in row.entry.cost.items() if value is not None] or [
        "no cost was measured"
    ]
    notes = [*cost, *([f"cost.json is not believed: {row.entry.unverified_cost}"] if row.entry.unverified_cost else [])]
    return (
        f'<section class="part" id="table-{name}"><h2>{html(part_title(table))}</h2>\n'
        f'<div class="charts" data-table="{name}"></div>\n'
        f"<details><summary>All scores and the cost</summary>{_table(part_title(table), head, rows)}"
        f"{_listed(notes)}</details></section>"
    )


def _provenance(run: SiteRun) -> Iterable[tuple[str, str]]:
    """Yield what a run was made of, declared or not."""
    record = run.first.record
    method = record.method
    yield "Method", f"{method.name} {method.version}"
    yield "Kind (declared)", run.first.origin
    yield "Given", record.condition + (f", control {record.control}" if record.control else "")
    yield "Training data (declared)", run.first.training
    yield "Weights (declared)", method.weights or "none"
    yield "Digest of the weights", method.weights_digest or "–"
    yield "Options", ", ".join(f"{key}={value}" for key, value in sorted(method.options.items())) or "none"
    yield "Split, limit, samples, seed", f"{record.split}, {record.limit or 'all'}, {record.samples}, {record.seed}"
    yield "Device, threads", f"{record.device}, {record.threads}"
    yield "Packages", ", ".join(f"{key} {value}" for key, value in sorted(record.packages.items()))
    yield "Protocol", f"version {record.protocol_version}, {record.protocol_digest}"
    yield "prbench", record.prbench_version
    for row in run.rows.values():
        table = row.entry.table
        yield f"{table.dataset}: identity digest", table.identity_digest
        yield f"{table.dataset}: content digest", table.content_digest
    if run.first.submission:
        yield "Submission", run.first.submission


def _remarks(run: SiteRun) -> list[str]:
    """Return what a reader of the run has to know, table by table."""
    found = []
    for row in run.rows.values():
        entry = row.entry
        words = (entry.summary.mark, entry.summary.arrival, entry.summary.own_first_frame)
        found += [f"{entry.table.dataset}: {word}" for word in words if word]
        if entry.unverified:
            found.append(f"{entry.table.dataset}: unverified, because {entry.unverified}")
    found.append(f"Declared by the run, and shown by nothing but running the method: {', '.join(run.first.declared)}.")
    return list(dict.fromkeys(found))


def _datasets(tables: Mapping[str, DatasetTable]) -> dict[str, DatasetTable]:
    """Return a table for each dataset of the study that a board has, synthetic ones too."""
    found: dict[str, DatasetTable] = {}
    for table in tables.values():
        if table.benchmark.about.default:
            found.setdefault(table.dataset.removeprefix("synthetic-"), table)
    return found


def _published(dataset: str, benchmark: Benchmark) -> str:
    """Return the study's own numbers of a dataset, in a table of their own."""
    infos = {info.id: info for info in benchmark.main_metrics}
    rows: dict[tuple[str, ...], dict[str, str]] = {}
    for number in load_published(_PUBLISHED):
        if number.dataset == dataset:
            key = (number.method, number.variant, number.condition)
            rows.setdefault(key, {})[number.metric] = number.printed or "–"
    if not rows:
        return ""
    metrics = dict.fromkeys(metric for row in rows.values() for metric in row)
    head = ("Method", "Weights", "Given", *(f"{infos[metric].title}{infos[metric].arrow}" for metric in metrics))
    title = f"Printed in Prime and Reach, Table {_PUBLISHED} (section {published_table(_PUBLISHED).section}): {dataset}"
    body = [(*key, *(row.get(metric, "–") for metric in metrics)) for key, row in rows.items()]
    return (
        f'<details class="published" data-dataset="{html(dataset)}"><summary>{html(title)}</summary>'
        f"{_table(title, head, body)}</details>"
    )


def _table(title: str, head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a plain table; its first column names the row."""
    heads = "".join(f'<th scope="col">{html(text)}</th>' for text in head)
    lines = []
    for first, *rest in rows:
        cells = "".join(f"<td>{html('–' if text is None else text)}</td>" for text in rest)
        lines.append(f'<tr><th scope="row">{html(first)}</th>{cells}</tr>')
    return (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{html(title)}"><table><caption>{html(title)}'
        f"</caption><thead><tr>{heads}</tr></thead><tbody>{''.join(lines)}</tbody></table></div>"
    )


def _listed(sentences: Iterable[str]) -> str:
    items = "".join(f"<li>{html(sentence)}</li>" for sentence in sentences)
    return f"<ul>{items}</ul>" if items else ""


def _attributes(values: Mapping[str, str]) -> str:
    return "".join(f' data-{key}="{html(value)}"' for key, value in values.items())


def _told_metric(info: MetricInfo) -> dict[str, Any]:
    return {
        "id": info.id,
        "title": info.title + info.arrow,
        "unit": printed_unit(info.unit),
        "rate": info.unit == "rate",
    }


def _scaled(metric: Any, benchmark: Benchmark) -> list[float | None]:
    scale = next(info.scale for info in benchmark.metrics if info.id == metric.metric)
    return [None if each is None else scale * each for each in (metric.mean, metric.low, metric.high)]


def _counted(number: int, word: str) -> str:
    return f"{number} {word}{'' if number == 1 else 's'}"


def html_block(text: str) -> str:
    """Return several lines as HTML; line breaks stay."""
    return "\n".join(html(line) for line in text.splitlines())
