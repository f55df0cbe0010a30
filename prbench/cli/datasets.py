"""``prbench datasets``: which datasets there are, and what using them asks for; start a new one, check a reader.

``prbench inspect``: what is this folder, and is it all there?

``prbench validate``: a dataset's own results beside prbench's rules.

``prbench poses``: bodies for recordings that have none.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from prbench.cli import options as opt
from prbench.cli.adapters import print_report, scaffold_answer
from prbench.cli.builds import NOT_EVERYTHING, print_annotations
from prbench.cli.commands import Answer, Group, SeveralValues, command, note, progress
from prbench.cli.terminal import print_columns, print_table
from prbench.errors import UsageError

if TYPE_CHECKING:
    from prbench.checking.catalogue import CatalogueEntry
    from prbench.checking.hd_epic import Validation
    from prbench.checking.inspection import InspectedDataset, InspectedTable


_HELP = "List the datasets (this is also what `prbench datasets` alone does), start a new one, check a reader."
_COMMANDS = {"list": f"{__name__}:list_datasets", "new": f"{__name__}:new", "check": f"{__name__}:check"}
datasets = Group("datasets", sections={"commands": _COMMANDS}, example="prbench datasets", help=_HELP, usual="list")
_CITE = "Print BibTeX and licence terms of everything that these tables contain, such as --cite tables/adt"


@command("list", example="prbench datasets list --root /data", report="prbench.checking.catalogue:Catalogue")
@click.argument("name", required=False)
@opt.root_option("Look here for copies, and one folder below.", required=False)
@opt.path_option("--cite", f"{_CITE}, and nothing else.", cls=SeveralValues, metavar="DIR...")
def list_datasets(*, name: str | None, root: Path | None, cite: tuple[Path, ...]) -> Answer:
    """List the datasets with licence and terms, how to obtain them, and what of them is below a folder.

    With NAME only that dataset is shown, with everything known about it.
    """
    from prbench.checking.catalogue import Catalogue, catalogue, citation_text
    from prbench.readers.discover import usable_readers

    if cite:
        text = citation_text(cite)
        return Answer(Catalogue(bibtex=text), lambda: print(text))
    report = Catalogue(datasets=catalogue(root, name), unusable_readers=usable_readers()[1])

    def show() -> None:
        if name is not None:
            print(_everything(report.datasets[0]))
            return
        header = ("name", "kind", "title", "licence", "redistribution")
        rows = [(*(getattr(each, name) for name in header), each.found or "–") for each in report.datasets]
        print_table("datasets", ("name", "for", *header[2:], "found"), rows)
        for each in report.datasets:
            for line in each.missing:
                print(f"{each.name}: {line}")
        for line in report.unusable_readers:
            print(f"! {line}")
        print("`prbench datasets NAME` tells how to obtain one and which files it consists of.")

    return Answer(report, show)


def _everything(entry: CatalogueEntry) -> str:
    lines = [
        f"{entry.title} ({entry.name}), for: {entry.kind}",
        f"homepage:        {entry.homepage}",
        f"licence:         {entry.licence}",
        f"redistribution:  {entry.redistribution}",
        f"how to obtain:   {entry.how_to_obtain}",
        "required files:  " + ", ".join(entry.required_files),
        "optional files:  " + ", ".join(entry.optional_files),
        "rates (Hz):      " + ", ".join(f"{name} {rate:g}" for name, rate in entry.rates_hz.items()),
        f"body poses:      {', '.join(entry.body_poses)}",
    ]
    lines += [f"reader option:   {text}" for text in entry.reader_options]
    lines += [f"known bad:       {name}: {reason}" for name, reason in entry.known_bad.items()]
    if entry.found:
        lines.append(f"found:           {entry.found}")
    lines += [f"missing:         {line}" for line in entry.missing]
    return "\n".join([*lines, "", entry.citation])


@command("new", example="prbench datasets new tabletop", report="prbench.checking.scaffold.create:ScaffoldReport")
@click.argument("name")
@opt.out_folder_option("New folder (default: ./prbench-NAME).")
def new(*, name: str, out: Path | None) -> Answer:
    """Write a complete package that reads a made-up dataset, for you to change.

    NAME is that of the dataset, such as tabletop: what `prbench build-dataset` will be given.
    """
    from prbench.checking.scaffold import new_dataset

    return scaffold_answer(new_dataset(name, out))


_CHECK = "prbench datasets check adt --root ADT"


@command("check", example=_CHECK, report="prbench.checking.conformance.findings:Report")
@click.argument("name", required=False)
@opt.root_option("A copy of it, of two recordings or more.", required=False)
@opt.number_option("--max-recordings", "Read at most N recordings, the first that are found (default 3).")
@opt.path_option("--manifest", "Of own recordings: your manifest, as for `prbench build-dataset`.")
@opt.reader_options()
@opt.flag("--list", "listed", "List the checks, and make none.")
def check(*, name: str | None, root: Path | None, options: opt.Pairs, listed: bool, **given: Any) -> Answer:
    """Check a reader and its manifest on a copy of the dataset, and say what to change.

    NAME is that of an installed dataset. Nothing is written into the copy.
    """
    from prbench.checking.conformance.findings import Finding, Outcome, Report
    from prbench.checking.dataset_checks import CHECKS, check_dataset

    if listed:
        checks = [(each.name, Outcome.SKIPPED, each.title) for each in CHECKS]
        report = Report("", tuple(Finding(*each) for each in checks), 0.0)
        return Answer(report, lambda: print_columns(("check", "", "question"), checks))
    if name is None or root is None:
        raise UsageError("NAME and --root DIR are needed: the dataset, and a copy of it. (--list does without.)")
    if (manifest := given["manifest"]) is not None:
        options = {**options, "manifest": str(manifest)}
    with progress(f"checking {name}") as show:
        chosen = (given["max_recordings"] or 3, tuple(sorted(options.items())))
        report = check_dataset(name, root, *chosen, lambda one: show(CHECKS.index(one), len(CHECKS), one.name))
    return Answer(report, lambda: print_report(report), NOT_EVERYTHING if report.failed else 0)


# Recordings of a dataset that are listed without ``--all``.
_SHOWN = 30


@command("inspect", example="prbench inspect /data tables/adt", report="prbench.checking.inspection:Inspection")
@click.argument("places", type=opt.NATIVE, nargs=-1, required=True, metavar="DIR...")
@opt.flag("--thorough", "Read every recording as a build would; takes as long.")
@opt.stream_options
@opt.flag("--all", "everything", "List complete recordings too, and every incomplete one.")
def inspect(
    *, places: tuple[Path, ...], thorough: bool, shift: opt.Pairs, scale: opt.Pairs, everything: bool
) -> Answer:
    """Say what folders hold, and which recordings are complete, cut short, incomplete or damaged.

    DIR is a dataset's folder, one that holds several, or a built table, of which sizes and means are printed; `prbench
    study table-1` prints those beside the study's.
    """
    from prbench.checking.inspection import inspect_folders
    from prbench.curation.mending import stream_numbers

    if (shift or scale) and not thorough:
        raise UsageError("--shift and --scale change what is read; give --thorough, too.")
    mends = (stream_numbers(shift, "shift"), stream_numbers(scale, "scale"))
    with progress("inspecting") as show:
        found = inspect_folders(places, thorough=thorough, mends=mends, progress=show)

    def show_all() -> None:
        for dataset in found.datasets:
            _print_dataset(dataset, everything=everything)
        for broken in found.broken:
            print(f"{broken.root}: looks like {broken.dataset}, but: {broken.message}")
        if found.tables:
            _print_tables(found.tables)

    return Answer(found, show_all, 0 if found.all_complete else NOT_EVERYTHING)


def _print_dataset(dataset: InspectedDataset, *, everything: bool) -> None:
    recordings = dataset.recordings
    states = Counter(recording.state for recording in recordings)
    counted = ", ".join(f"{count} {state}" for state, count in sorted(states.items()))
    plural = "s" if len(recordings) != 1 else ""
    print(f"{dataset.root}: {dataset.title} ({dataset.name}), {len(recordings)} recording{plural} ({counted}),"
          f" {dataset.size / 1e6:,.1f} MB")  # fmt: skip
    listed = [each for each in recordings if everything or each.state != "complete" or each.remarks]
    shown = listed if everything else listed[:_SHOWN]
    reasons = {(each.state, each.remarks) for each in listed}
    if len(listed) > _SHOWN and len(reasons) == 1 and not everything:
        shown = listed  # one line says it of all
        print(f"all {len(listed)} of them: {'; '.join(listed[0].remarks)}")
    elif shown:
        rows = [(each.recording_id, each.state, f"{each.size / 1e6:,.1f}", "; ".join(each.remarks)) for each in shown]
        print_table(dataset.name, ("recording", "state", "MB", "what"), rows, numbers=(2,))
    if len(shown) < len(listed):
        print(f"… and {len(listed) - len(shown)} more: --all")
    if dataset.annotations is not None:
        print_annotations(dataset.annotations)


def _print_tables(tables: tuple[InspectedTable, ...]) -> None:
    rows = []
    for table in tables:
        means = [f"{each.mean:.2f} ± {each.sd:.2f}" if table.sequences else "–" for each in table.quantities.values()]
        counts = [str(number) for number in (table.sequences, *table.by_split.values())]
        rows.append((table.dataset, *counts, *means, ", ".join(table.pose_sources)))
    counted = ("dataset", "sequences", "train", "validation", "test")
    measured = ("duration s", "prime gap s", "body m", "hand m")
    title = "prime-and-reach sequences (mean ± standard deviation over sequences)"
    print_table(title, (*counted, *measured, "body"), rows, numbers=range(1, 9))
    for table in tables:
        if table.participants_in_two_splits:
            why = "have sequences in both train and test; the protocol splits by recording, as the study does."
            print(f"{table.dataset}: {table.participants_in_two_splits} participants {why}")
        for remark in table.remarks:
            print(f"{table.dataset}: {remark}")


_EXAMPLE = "prbench validate hd-epic --root /data/HD-EPIC --data tables/hd-epic"


@command("validate", example=_EXAMPLE, report="prbench.checking.hd_epic:Validation")
@click.argument("dataset", type=click.Choice(["hd-epic"]))
@click.option("--data", type=opt.PATH, metavar="DIR", help="A table of it that was built by the rule.")
@opt.root_option("Its annotations, alone or with the videos.", required=False)
def validate(*, dataset: str, data: Path | None, root: Path | None) -> Answer:
    """Compare a dataset's own annotations with the published counts, and its priming results with the rule."""
    from prbench.checking.hd_epic import validate_annotations, validate_build

    assert dataset == "hd-epic", "the only choice"
    if data is None and root is None:
        raise UsageError("--root DIR (counts) or --data DIR (priming by the rule) is needed, or both.")
    counted = None if root is None else validate_annotations(root)
    validation = counted if data is None else validate_build(data)
    assert validation is not None, "one of the two is given"
    if counted is not None:
        validation = dataclasses.replace(validation, annotations=counted.annotations)
    return Answer(validation, lambda: _print(validation))


def _print(validation: Validation) -> None:
    from prbench.checking.hd_epic import RULE_OUTCOMES

    if validation.synthetic:
        print("synthetic videos, with priming results that an invented pipeline published")
    if validation.annotations is not None:
        print_annotations(validation.annotations)
        _print_priming(validation.annotations.priming, validation.published_shares)
    if not validation.agreements:
        return
    rows: list[tuple[str, ...]] = []
    for each in validation.agreements:
        rows += [(each.action, published, *map(str, by_rule.values())) for published, by_rule in each.counts.items()]
    header: tuple[str, ...] = ("action", "published", *RULE_OUTCOMES)
    print_table("published priming (rows) and the rule (columns): events", header, rows, numbers=(2, 3, 4))
    rows = []
    for each in validation.agreements:
        told = validation.published_shares.get(each.action)
        tested, primed = ("", "") if told is None else (f"{share:.1%}" for share in told)
        gaps = [f"{mean:.2f} ± {sd:.2f}" for mean, sd in (each.published_gap, each.rule_gap)]
        ours = [f"{share:.1%}" for share in (each.tested_share, each.primed_share, each.agreement)]
        rows.append((each.action, ours[0], tested, ours[1], primed, ours[2], *gaps))
    header = ("action", "tested", "dataset", "primed", "dataset", "same answer", "gap published", "gap rule")
    print_table("shares, and prime gaps in seconds (mean ± sd)", header, rows, numbers=range(1, 8))
    rows = []
    for each in validation.agreements:
        spread = each.difference
        numbers = (f"{value:.3f}" for value in (spread.bias, spread.median, spread.p95, spread.largest))
        rows.append((each.action, str(spread.n), *numbers))
    header = ("action", "both primed", "mean", "median size", "95 % size", "largest")
    print_table("prime time by the rule minus published, seconds", header, rows, numbers=range(1, 6))


def _print_priming(priming: dict[str, dict[str, int]], shares: dict[str, tuple[float, float]]) -> None:
    """Print how many sides of movements the dataset itself tested and found primed, beside its paper's shares."""
    if not priming:
        print("priming_info.json is not there: the dataset's own priming cannot be compared")
        return
    rows = []
    for action, counts in priming.items():
        primed = counts.get("primed", 0)
        tested = primed + counts.get("not_primed", 0)
        listed = tested + counts.get("excluded", 0)
        told = [f"{share:.1%}" for share in shares.get(action, ())] or ["–", "–"]
        here = [f"{part / whole:.1%}" if whole else "–" for part, whole in ((tested, listed), (primed, tested))]
        rows.append((action, f"{listed:,}", f"{primed:,}", here[0], told[0], here[1], told[1]))
    header = ("action", "listed", "primed", "tested", "paper", "primed of tested", "paper")
    print_table("priming that the dataset publishes", header, rows, numbers=range(1, 7))


_POSES = "prbench poses egoallo --root /data/HD-EPIC --config egoallo.toml"


@command("poses", example=_POSES, resumes=True, report=["prbench.curation.poses.make:Outcome"])
@click.argument("estimator", type=click.Choice(["egoallo", "three-point"]))
@opt.root_option(type=opt.LOCAL_PATH)
@click.option("--dataset", metavar="NAME", help="Name of the dataset, such as adt (default: what the folder holds).")
@click.option("--config", type=opt.PATH, metavar="FILE", help="How to run EgoAllo; without it, says what to do.")
@opt.option_option("three-point", remark="estimator=NAME, weights=FILE, floor=METRES")
@opt.recordings_options
@opt.option("--poses-root", "Folder of EgoAllo's outputs (default: ROOT/egoallo).", type=opt.LOCAL_PATH, metavar="DIR")
@opt.flag("--dry-run", "Say which recordings lack a body, and run nothing.")
def poses(
    *, estimator: str, root: Path, config: Path | None, options: opt.Pairs, dry_run: bool, **given: Any
) -> Answer:
    """Say which recordings lack a body pose, and have it estimated.

    By EgoAllo, which you install; or by a network of ours from head and wrists alone (three-point), into
    ROOT/three-point, which readers take with --option poses=three-point.
    """
    from prbench.curation import poses as bodies
    from prbench.readers import parse_options

    is_ours = estimator == "three-point"
    if (config or given["poses_root"] or dry_run) if is_ours else options:
        raise UsageError("--config, --poses-root and --dry-run are egoallo's, --option is three-point's.")
    settings = bodies.read_config(config) if config else None
    given["limit"] = given.pop("max_recordings")
    states: tuple[bodies.PoseState, ...] = ()
    with progress(f"bodies by {estimator}") as tell:
        if is_ours:
            del given["poses_root"]
            chosen = parse_options(bodies.ThreePointOptions, options, dataset="three-point bodies")
            outcomes = bodies.make_bodies(root, options=chosen, progress=tell, **given)
        else:
            states = tuple(bodies.pose_states(root, **given))
            outcomes = [bodies.Outcome(state.found.recording_id, state.state, state.message) for state in states]
            if settings is not None and not dry_run:
                outcomes = bodies.make_poses(states, settings, root=root, progress=tell)
    for outcome in outcomes:
        if outcome.failed:
            note(f"failed: {outcome.recording_id}: {outcome.message}")

    def show() -> None:
        whole = ("complete", "kept", "made")
        rows = [(each.recording_id, each.state, each.message) for each in outcomes if each.state not in whole]
        if rows:
            print_table(f"recordings without a whole body by {estimator}", ("recording", "body", "details"), rows)
        counts = Counter(each.state for each in outcomes)
        counted = ", ".join(f"{count} {name}" for name, count in sorted(counts.items()))
        print(f"{len(outcomes)} recordings: {counted}")
        lacking = [state for state in states if state.lacking]
        if lacking and settings is None and not dry_run:
            print(f"\n{bodies.instructions(root, lacking)}", end="")

    return Answer(outcomes, show, NOT_EVERYTHING if any(each.failed for each in outcomes) else 0)
