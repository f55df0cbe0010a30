"""``prbench build-dataset``: native recordings into a table.

Also what the commands that build other tables share with it: report, plan, and remarks on recordings left out.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec

from prbench.cli import options as opt
from prbench.cli.commands import Answer, command, note, progress
from prbench.cli.terminal import print_table
from prbench.errors import UsageError

if TYPE_CHECKING:
    from prbench.curation import BuildPlan, BuildReport
    from prbench.curation.job import FunnelRow
    from prbench.curation.options import BuildOptions
    from prbench.engine.choice import EngineChoice
    from prbench.readers import AnnotationCounts
    from prbench.readers.discover import BrokenDataset
    from prbench.sequences import Recording, corpus, parts

# Exit code of a command that finished, but had to leave out something that could not be read.
NOT_EVERYTHING = 3
# Movements that stand for all others in a count of annotations, and kinds of remarks that are printed.
_EXAMPLES = 5
# Known-bad recordings that a printed plan names.
_SKIPPED_SHOWN = 10
# Stands in place of a dataset's name for whatever is found.
EVERYTHING = "all"


class BuildsReport(msgspec.Struct, frozen=True, kw_only=True):
    """The work of a command that builds tables, done or planned.

    Attributes:
        built: Maps the folder of each table that was written to the content of its ``dataset.json`` or ``corpus.json``.
        not_built: Datasets that were found and gave no table; only of ``build-dataset all``.
        planned: One entry for each table that would be written, with ``--dry-run``.
        shard: The shard that was made, with ``--shard``; else null.
        proposed: The rows of the file that ``--propose-events`` writes.
    """

    built: dict[str, Any] = {}
    not_built: list[BrokenDataset] = []
    planned: list[BuildPlan] = []
    shard: opt.MadeShard | None = None
    proposed: list[dict[str, Any]] = []


def answer_of_table(report: Any, info: Any, title: str, rows: Sequence[tuple[str, str]], what: str) -> Answer:
    """Answer a command that has written a table, whose description is ``info``, with some numbers of it.

    Args:
        report: What ``--json`` prints.
        info: The table's description.
        title: Title of the numbers.
        rows: Names and numbers.
        what: Last line, which says where the table is.
    """
    for each in info.quarantine:
        note(f"{each.recording_id}: {each.status}: {each.message}")

    def show() -> None:
        print_table(title, ("of", "number"), rows, numbers=(1,))
        print(what)

    failed = any(each.status == "failed" for each in info.quarantine)
    return Answer(report, show, NOT_EVERYTHING if failed else 0)


def built(*reports: BuildReport) -> dict[str, Any]:
    """Return what :attr:`BuildsReport.built` holds of some tables."""
    return {str(report.folder): msgspec.to_builtins(report.info) for report in reports}


def print_plan(plan: BuildPlan, workers: int, *, unfit: str) -> None:
    """Say what would be read, what is known to be ``unfit``, and about what it takes."""
    print(f"{len(plan.recordings)} recordings, {plan.input_bytes / 1e6:,.1f} MB to read")
    if plan.skipped:
        shown = ", ".join(plan.skipped[:_SKIPPED_SHOWN]) + (" …" if len(plan.skipped) > _SKIPPED_SHOWN else "")
        print(f"{len(plan.skipped)} of them are known to be {unfit} and would be skipped: {shown}")
    seconds = plan.estimated_seconds / workers
    duration = f"{seconds:,.0f} s" if seconds < 120 else f"{seconds / 60:,.0f} minutes"
    several = "s" if workers > 1 else ""
    print(f"estimated: {duration} with {workers} worker{several}, {plan.estimated_disk_bytes / 1e6:,.1f} MB on disk")


def print_stages(title: str, stages: Iterable[FunnelRow]) -> None:
    """Print how much of the files each stage left."""
    rows = [(stage, str(kept), str(dropped or ""), why) for stage, kept, dropped, why in stages]
    print_table(title, ("stage", "kept", "dropped", "why"), rows, numbers=(1, 2))


def note_unread(records: Sequence[Recording | corpus.CorpusRecord], *, reused: int) -> None:
    """Name the recordings that are not in the result, and why; and of each remark on the others the first."""
    if reused:
        note(f"{reused} recordings were taken over from an interrupted build.")
    remarks: dict[str, list[str]] = {}
    for record in records:
        remark = record.message
        for told_elsewhere in (*getattr(record, "shortfalls", ()), *getattr(record, "findings", ())):
            remark = remark.replace(told_elsewhere, "").strip("; ")
        if record.status != "read":
            note(f"{record.status}: {record.recording_id}: {record.message}")
        elif remark:
            kind = re.sub(r"\d+", "#", remark)  # remarks that differ in numbers alone are one kind
            remarks.setdefault(kind, []).append(f"{record.recording_id}: {remark}")
    # What is said of few recordings comes first: the remarks that all share seldom tell of damage.
    told = sorted(remarks.values(), key=len)
    for each in told[:_EXAMPLES]:
        note(f"remark: {each[0]}" + (f"; and {len(each) - 1} more, see the column `message`" if each[1:] else ""))
    if rest := sum(map(len, told[_EXAMPLES:])):
        note(f"remark: on {rest} more recordings, see the column `message`")


def note_findings(records: Iterable[Recording]) -> None:
    """Name the recordings whose streams are suspicious."""
    for record in records:
        for finding in record.findings:
            note(f"streams: {record.recording_id}: {finding}")


def note_recordings(records: Iterable[Recording], *, reused: int) -> None:
    """Name the recordings that are missing from a table, cut short, so that events may be missing, or without sequence.

    For a recording without sequences the outcomes of its events are printed: the reader's remarks are seldom the cause.
    """
    records = list(records)
    note_unread(records, reused=reused)
    for record in records:
        for shortfall in record.shortfalls:
            note(f"cut short: {record.recording_id}: {shortfall}")
    note_findings(records)
    for record in records:
        if record.is_fruitless:
            note(f"no sequence: {record.recording_id}: {record.why_fruitless}")


_EXAMPLE = "prbench build-dataset adt --root /data/ADT --out tables/adt --workers 4"
_OUT = "Folder of the table; an earlier one is replaced once the new one is ready, if that lacks nothing."
_PROPOSE = "Write picks for a person to confirm into this new CSV file, and no table (gimo: docs/gimo-events.md)."
_EVENTS = "List picks and puts from the annotations alone, without sequences, before anything else is downloaded"
_PRIMING = "Prime times by the equations (default), or taken over from the dataset where it publishes them (hd-epic)."
_MOVEMENT = "What must be at least 20 cm: wrist_to_goal (default), pelvis or object displacement."
_SURE = "Keep sequences of events with at least this event_confidence, from 0 to 1 (docs/specification/curation.md)."
_CORRECTIONS = "Events that a person drops, moves, renames or gives another hand or goal (docs/review.md)."

_MANIFEST = "With 'own': name, licence and thresholds of your recordings, TOML (docs/own-recordings.md)."


@command("build-dataset", example=_EXAMPLE, resumes=True, report=BuildsReport)
@click.argument("dataset")
@opt.root_option()
@opt.out_folder_option(_OUT)
@opt.replace_option()
@opt.recordings_options
@opt.flag("--dry-run", "Say what would be read, and write nothing.")
@click.option("--propose-events", type=opt.OUT_FILE, metavar="FILE", help=_PROPOSE)
@opt.flag("--events-only", f"{_EVENTS} (hd-epic).")
@click.option("--in-hand", metavar="RULE", help="Another in-hand rule of the manifest, for example wrist.")
@click.option("--ray-origin", type=click.Choice(["eye", "camera"]), help="Where gaze rays start (default: eye).")
@opt.choice_option("--priming", ["rule", "published"], _PRIMING, default="rule")
@click.option("--minimum-movement", default="wrist_to_goal", metavar="MEASURE", help=_MOVEMENT)
@click.option("--min-confidence", type=float, default=0.0, metavar="X", help=_SURE)
@opt.path_option("--corrections", _CORRECTIONS)
@opt.path_option("--manifest", _MANIFEST)
@opt.stream_options
@opt.protocol_option("every number of the curation, stamped into the table (docs/protocol-choices.md).")
@opt.on_error_option()
@opt.reader_options()
@opt.engine_options()
@opt.shard_option("the dataset's recordings")
def build_dataset(
    *, dataset: str, root: Path, out: Path | None, dry_run: bool, options: opt.Pairs, engine: EngineChoice, **given: Any
) -> Answer:
    """Turn a dataset's recordings into a table of prime-and-reach sequences.

    DATASET is its name, for example adt (`prbench datasets` lists them), or 'all' for whatever lies below --root.
    """
    from prbench.curation.options import build_options

    propose_events = given.pop("propose_events")
    if (manifest := given.pop("manifest")) is not None:
        options = {**options, "manifest": str(manifest)}
    refused = {"replace": given["replace"], "dry_run": dry_run, "everything": dataset == EVERYTHING}
    part = opt.chosen_shard(given.pop("shard"), **refused)
    chosen = build_options(option=options, **given)
    if propose_events is not None:
        from prbench.curation.propose_events import write_candidates

        where = opt.opened(engine, reads=(root,))
        with progress(f"looking for reaches in {dataset}") as show:
            chosen_by = {"options": options, "engine": where, "progress": show}
            rows, problems = write_candidates(dataset, root, propose_events, **chosen_by)
        for name, problem in problems.items():
            note(f"{name}: {problem}")

        def show_proposals() -> None:
            found = sum(bool(row["hand"]) for row in rows)
            print(f"{found} proposals for {len(rows)} segments, {len(problems)} not read")
            told = "look at the videos, write yes or no into the column 'confirmed', and build with it"
            print(f"{told}: {propose_events}")

        return Answer(BuildsReport(proposed=rows), show_proposals, NOT_EVERYTHING if problems else 0)
    if dry_run:
        return _plan(dataset, root, chosen, engine if isinstance(engine, int) else 1)
    if out is None:
        raise UsageError("--out DIR is needed: the folder of the table. (--dry-run and --propose-events do without.)")
    where = opt.opened(engine, reads=(root,), writes=(out,), packages=chosen.packages)
    with progress(f"building {f'shard {part} of ' if part else ''}{dataset}") as tell:
        if dataset == EVERYTHING:
            from prbench.curation.build import build_all

            reports, broken = build_all(root, out, options=chosen, engine=where, progress=tell)
            return table_answer(*reports, not_built=broken)
        if part is None:
            from prbench.curation import build_dataset as build

            report = build(dataset, root, out, options=chosen, engine=where, progress=tell)
            from prbench.readers import CountsAnnotations, reader_for

            reader = reader_for(dataset, {"events_only": "true"}) if given["events_only"] else None
            counts = reader.annotation_counts(reader.find(root)) if isinstance(reader, CountsAnnotations) else None
            return table_answer(report, annotations=counts)
        from prbench.curation.build import build_shard_from_sources
        from prbench.curation.job import native_sources

        sources = native_sources(dataset, root, chosen)
        report = build_shard_from_sources(sources, out, part, options=chosen, engine=where, progress=tell)
    note_recordings(report.records, reused=report.reused)
    complete = all(record.status != "failed" and not record.shortfalls for record in report.records)
    return shard_answer(report, len(report.records), unit="recordings", complete=complete)


def made_shard(report: parts.ShardReport[Any], made_of: int) -> opt.MadeShard:
    """Return the report of one shard of a build that is made of so many items."""
    return opt.MadeShard(
        shard=str(report.shard), folder=report.folder, made_of=made_of, planned=report.planned, taken_over=report.reused
    )


def shard_answer(report: parts.ShardReport[Any], made_of: int, *, unit: str, complete: bool) -> Answer:
    """Answer a command that has made one shard of a build."""
    made = made_shard(report, made_of)
    return opt.shard_answer(BuildsReport(shard=made), made, unit=unit, exit_code=0 if complete else NOT_EVERYTHING)


def _plan(dataset: str, root: Path, options: BuildOptions, workers: int) -> Answer:
    """Say what would be read, of one dataset or of all that are found."""
    from prbench.curation.build import found_datasets, plan_build

    places = [(dataset, root)]
    if dataset == EVERYTHING:
        places = [(each.dataset, each.root) for each in found_datasets(root, options)[0]]
    plans = [plan_build(name, place, options) for name, place in places]

    def show() -> None:
        for plan in plans:
            if dataset == EVERYTHING:
                print(f"{plan.dataset} in {plan.root}:")
            print_plan(plan, workers, unfit="bad")

    return Answer(BuildsReport(planned=plans), show)


def print_annotations(counts: AnnotationCounts) -> None:
    """Print how many annotations there are, by participant and beside the published counts."""
    names = ("videos", "objects", "picks", "puts", "masks", "primed")
    rows = []
    for title, numbers in (*counts.by_participant.items(), ("all", counts.totals), *counts.published.items()):
        rows.append((title, *(f"{numbers[name]:,}" if name in numbers else "–" for name in names)))
    print_table("annotated picks and puts", ("participant", *names), rows, numbers=range(1, 7))
    for line in (*counts.remarks, *counts.examples[:_EXAMPLES]):
        print(line)


def table_answer(
    *reports: BuildReport, not_built: Iterable[BrokenDataset] = (), annotations: AnnotationCounts | None = None
) -> Answer:
    """Answer a command that has written tables."""
    broken = list(not_built)
    complete = not broken
    for report in reports:
        note_recordings(report.records, reused=report.reused)
        waiting = report.info.options.get("corrections_waiting")
        if waiting:
            note(f"corrections of recordings that were not read wait for them: {waiting}")
        counts = report.info.counts
        complete = complete and not counts.recordings_failed and not counts.recordings_cut_short

    def show() -> None:
        from prbench.curation.job import funnel_rows
        from prbench.sequences.table import why_no_sequences

        for report in reports:
            print_stages(f"{report.info.title}: from files to sequences", funnel_rows(report.info))
            if annotations is not None:
                print_annotations(annotations)
            if not report.info.counts.sequences and not report.info.outcomes.get("annotation_only"):
                print(f"0 sequences: {why_no_sequences(report.info)}")
            print(f"table: {report.folder}")
        for each in broken:
            print(f"no table of {each.dataset} in {each.root}: {each.message}")

    return Answer(BuildsReport(built=built(*reports), not_built=broken), show, 0 if complete else NOT_EVERYTHING)
