"""``prbench build-dataset``: native recordings into a table."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from prbench.cli.builds import (
    NOT_EVERYTHING,
    BuildsReport,
    BuiltTable,
    ProposedPick,
    built_table,
    made_shard,
    note_recordings,
    planned,
    print_plan,
    print_stages,
)
from prbench.cli.commands import Answer, command, note
from prbench.cli.engines import opened
from prbench.cli.options import (
    OUT_FILE,
    engine_options,
    on_error_option,
    out_folder_option,
    protocol_option,
    reader_options,
    recordings_options,
    replace_option,
    root_option,
)
from prbench.cli.progress import progress
from prbench.cli.shards import chosen_shard, shard_answer, shard_option
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench.curation import BuildReport
    from prbench.curation.options import BuildOptions
    from prbench.engine import Engine
    from prbench.engine.choice import EngineChoice
    from prbench.engine.shards import Shard

EVERYTHING = "all"
"""Stands in place of a dataset's name for whatever is found."""


@command(
    "build-dataset",
    example="prbench build-dataset adt --root /data/ADT --out tables/adt --workers 4",
    resumes=True,
    report=BuildsReport,
)
@click.argument("dataset")
@root_option()
@out_folder_option("Folder of the table; an earlier one is replaced once the new one is ready, if that lacks nothing.")
@replace_option()
@recordings_options
@click.option("--dry-run", is_flag=True, help="Say what would be read, and write nothing.")
@click.option(
    "--propose-events",
    type=OUT_FILE,
    metavar="FILE",
    help="Write picks for a person to confirm into this new CSV file, and no table (gimo: docs/gimo-events.md).",
)
@click.option("--in-hand", metavar="RULE", help="Another in-hand rule of the manifest, for example wrist.")
@click.option("--ray-origin", type=click.Choice(["eye", "camera"]), help="Where gaze rays start (default: eye).")
@click.option(
    "--priming",
    type=click.Choice(["rule", "published"]),
    default="rule",
    help="Prime times by the equations (default), or taken over from the dataset where it publishes them (hd-epic).",
)
@click.option(
    "--occlusion",
    type=click.Choice(["off", "mark", "require"]),
    default="off",
    help="Where a dataset has meshes: mark events primed through one, or let unobstructed looks alone prime"
    " (needs the extra open3d).",
)
@click.option(
    "--minimum-movement",
    default="wrist_to_goal",
    metavar="MEASURE",
    help="What must be at least 20 cm: wrist_to_goal (default), pelvis or object displacement.",
)
@click.option(
    "--minimum-prime",
    type=float,
    metavar="SECONDS",
    help="How long a look must last to prime (default 0: a single gaze sample primes, as in the study).",
)
@protocol_option("every number of the curation, stamped into the table (docs/protocol-choices.md).")
@on_error_option()
@click.option(
    "--poses",
    metavar="SOURCE",
    help="Where bodies come from, for example egoallo in place of ADT's suit; short for --option poses=SOURCE.",
)
@reader_options()
@engine_options()
@shard_option("the dataset's recordings")
def build_dataset(
    *,
    dataset: str,
    root: Path,
    out: Path | None,
    replace: bool,
    recordings: str,
    max_recordings: int | None,
    dry_run: bool,
    propose_events: Path | None,
    in_hand: str | None,
    ray_origin: str | None,
    priming: Literal["rule", "published"],
    occlusion: Literal["off", "mark", "require"],
    minimum_movement: str,
    minimum_prime: float | None,
    protocol: Path | None,
    on_error: Literal["skip", "fail"],
    poses: str | None,
    options: tuple[tuple[str, str], ...],
    engine: EngineChoice,
    shard: str | None,
) -> Answer:
    """Turn a dataset's recordings into a table of prime-and-reach sequences.

    DATASET is its name, for example adt (`prbench datasets` lists them), or 'all' for whatever lies below --root.
    """
    from prbench.curation.options import BuildOptions, CurationOptions, mesh_options
    from prbench.protocol.own_protocol import read_protocol

    part = chosen_shard(shard, replace=replace, dry_run=dry_run, everything=dataset == EVERYTHING)
    named = None if dataset == EVERYTHING else dataset
    source = mesh_options(named, in_hand=in_hand, occlusion=occlusion) | dict(options)
    if poses is not None:
        source["poses"] = poses
    chosen = BuildOptions(
        curation=CurationOptions(
            in_hand=in_hand,
            ray_origin=ray_origin,
            minimum_movement=minimum_movement,
            priming=priming,
            occlusion=occlusion,
            minimum_prime=minimum_prime,
        ),
        protocol=read_protocol(protocol) if protocol is not None else None,
        recordings=recordings,
        limit=max_recordings,
        reader=tuple(sorted(source.items())),
        on_error=on_error,
        replace=replace,
    )
    if propose_events is not None:
        return _propose(dataset, root, propose_events, source, opened(engine, reads=(root,)))
    if dry_run:
        return _plan(dataset, root, chosen, engine if isinstance(engine, int) else 1)
    if out is None:
        from prbench.errors import UsageError

        raise UsageError("--out DIR is needed: the folder of the table. (--dry-run and --propose-events do without.)")
    where = opened(engine, reads=(root,), writes=(out,), packages=chosen.packages)
    if part is not None:
        return _build_shard(dataset, root, out, part, chosen, where)
    if dataset == EVERYTHING:
        return _build_all(root, out, chosen, where)
    return _build_one(dataset, root, out, chosen, where)


def _propose(dataset: str, root: Path, out: Path, options: dict[str, str], engine: Engine) -> Answer:
    """Propose pick events where a dataset has none, for a person to confirm."""
    from prbench.curation.propose_events import write_candidates

    with progress(f"looking for reaches in {dataset}") as show:
        proposals = write_candidates(dataset, root, out, options=options, engine=engine, progress=show)
    proposed = []
    for proposal in proposals:
        found = proposal.candidate
        pick = ProposedPick(
            recording=proposal.line.recording_id,
            time=None if found is None else float(found.time),
            hand=None if found is None else found.hand,
            confidence=None if found is None else float(found.confidence),
            reason=str(proposal.row()["reason"]),
            problem=proposal.problem,
        )
        proposed.append(pick)
        if pick.problem:
            note(f"{pick.recording}: {pick.problem}")
    unread = sum(bool(pick.problem) for pick in proposed)

    def show_proposals() -> None:
        found = sum(pick.time is not None for pick in proposed)
        print(f"{found} proposals for {len(proposed)} segments, {unread} not read")
        print(f"look at the videos, write yes or no into the column 'confirmed', and build with it: {out}")

    report = BuildsReport(built=[], not_built=[], planned=[], proposed=proposed)
    return Answer(report, show_proposals, NOT_EVERYTHING if unread else 0)


def _plan(dataset: str, root: Path, options: BuildOptions, workers: int) -> Answer:
    """Say what would be read, of one dataset or of all that are found."""
    if dataset == EVERYTHING:
        from prbench.curation.build_all import plan_all

        plans = [planned(plan, workers, dataset=name, root=place) for name, place, plan in plan_all(root, options)]
    else:
        from prbench.curation import plan_build

        plans = [planned(plan_build(dataset, root, options), workers, dataset=dataset, root=root)]

    def show() -> None:
        for plan in plans:
            if dataset == EVERYTHING:
                print(f"{plan.dataset} in {plan.root}:")
            print_plan(plan, unfit="bad")

    return Answer(BuildsReport(built=[], not_built=[], planned=plans), show)


def _build_one(dataset: str, root: Path, out: Path, options: BuildOptions, engine: Engine) -> Answer:
    from prbench.curation import build_dataset as build

    with progress(f"building {dataset}") as tell:
        report = build(
            dataset,
            root,
            out,
            options=options,
            engine=engine,
            progress=lambda step: tell(step.done, step.total, step.record.recording_id),
        )
    return table_answer(report)


def _build_shard(dataset: str, root: Path, out: Path, shard: Shard, options: BuildOptions, engine: Engine) -> Answer:
    from prbench.curation.build import build_dataset_shard

    with progress(f"building shard {shard} of {dataset}") as tell:
        report = build_dataset_shard(
            dataset,
            root,
            out,
            shard,
            options=options,
            engine=engine,
            progress=lambda step: tell(step.done, step.total, step.record.recording_id),
        )
    note_recordings(report.records, reused=report.reused)
    made = made_shard(report, made_of=len(report.records))
    complete = all(record.status != "failed" and not record.shortfalls for record in report.records)
    answer = BuildsReport(built=[], not_built=[], planned=[], shard=made)
    return shard_answer(answer, made, unit="recordings", exit_code=0 if complete else NOT_EVERYTHING)


def table_answer(report: BuildReport) -> Answer:
    """Answer a command that has written one table."""
    table = _built(report)
    counts = report.info.counts
    complete = not counts.recordings_failed and not counts.recordings_cut_short
    return Answer(
        BuildsReport(built=[table], not_built=[], planned=[]),
        lambda: _print_table(table),
        0 if complete else NOT_EVERYTHING,
    )


def _build_all(root: Path, out: Path, options: BuildOptions, engine: Engine) -> Answer:
    from prbench.curation.build_all import build_all
    from prbench.readers.discover import BrokenDataset

    with progress("building") as tell:
        outcomes = build_all(
            root,
            out,
            options=options,
            engine=engine,
            progress=lambda name, step: tell(step.done, step.total, f"{name} {step.record.recording_id}"),
        )
    built = [_built(outcome.report) for outcome in outcomes if outcome.report is not None]
    not_built = [
        BrokenDataset(outcome.dataset, outcome.root, outcome.message) for outcome in outcomes if outcome.report is None
    ]
    rows = []
    for each in outcomes:
        sizes = ["–"] * 3
        if each.report is not None:
            counts = each.report.info.counts
            not_read = counts.recordings_failed + counts.recordings_skipped
            sizes = [str(count) for count in (counts.recordings_read, not_read, counts.sequences)]
        rows.append((each.dataset, *sizes, each.message))

    def show() -> None:
        for table in built:
            _print_table(table)
        print_table("datasets", ("dataset", "recordings", "not read", "sequences", "problem"), rows, numbers=(1, 2, 3))

    complete = all(outcome.complete for outcome in outcomes)
    return Answer(BuildsReport(built=built, not_built=not_built, planned=[]), show, 0 if complete else NOT_EVERYTHING)


def _built(report: BuildReport) -> BuiltTable:
    """Report one table, and note what of its recordings is missing from it."""
    from prbench.curation.provenance import funnel_rows

    note_recordings(report.records, reused=report.reused)
    return built_table(report, funnel_rows(report.info))


def _print_table(table: BuiltTable) -> None:
    print_stages(f"{table.title}: from files to sequences", table.stages)
    print(f"table: {table.folder}")
