"""``prbench synthesize``: synthetic recordings in a dataset's native files, with the truth beside them."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec

from prbench.cli import options as opt
from prbench.cli.builds import built
from prbench.cli.commands import Answer, command, progress
from prbench.cli.terminal import print_table
from prbench.entry_points import CORPORA, load_built_in
from prbench.errors import UsageError

if TYPE_CHECKING:
    from prbench.synthetic.write_tree import WrittenRecording

# Layouts of text and motion, which stand with their corpora.
_CORPUS_LAYOUTS = ("nymeria", "humanml3d")
# Recordings of such a layout if no number is named.
_CORPUS_RECORDINGS = 4


class SynthesizeReport(msgspec.Struct, frozen=True, kw_only=True):
    """The recordings that were written, or the table.

    Attributes:
        folder: The native files, or the table.
        recordings: The recordings in them; empty with ``--table``.
        built: Maps the folder of the table to its ``dataset.json``, with ``--table``.
    """

    folder: Path
    recordings: tuple[WrittenRecording, ...] = ()
    built: dict[str, dict] = {}


_EXAMPLE = "prbench synthesize adt --count 4 --seed 1 --out synthetic/adt"
_FORMER = {"--recordings": "--count", "--recording": "--count"}
_WORLD = "Whose people: second moves by other laws, only for tests of transfer; with --table (default default)."
_ESTIMATES = "Also write bodies as EgoAllo would estimate them (adt; hd-epic and hot3d have no others)."


@command("synthesize", example=_EXAMPLE, report=SynthesizeReport, former=_FORMER)
@click.argument("layout")
@opt.out_folder_option("Folder of the recordings, or of the table.")
@opt.flag("--table", "Write the finished table of sequences instead of native files (the only way for size large).")
@opt.replace_option()
@opt.count_option("Number of recordings to make (default: the size's number).")
@opt.seed_option("of everything")
@opt.choice_option("--size", ["tiny", "default", "large"], "How much (default tiny).", default="tiny")
@opt.choice_option("--world", ["default", "second"], _WORLD, default="default")
@opt.number_option("--events", "n_events", "Picks and puts of each recording.")
@click.option("--bystander-objects", type=int, metavar="N", help="Objects that never move.")
@opt.flag("--egoallo", "estimates", _ESTIMATES)
@opt.workers_option()
def synthesize(
    *, layout: str, out: Path | None, table: bool, replace: bool, count: int | None, world: str, **given: Any
) -> Answer:
    """Write synthetic recordings in a dataset's native layout, with the truth beside them.

    LAYOUT is the native layout to write: any dataset of `prbench datasets`.
    """
    from prbench.synthetic.write_tree import planned_recordings, synthesize_tree

    if out is None:
        raise UsageError(f"--out DIR is needed: the folder of the {'table' if table else 'recordings'}.")
    if world == "second" and (not table or given["size"] == "large"):
        raise UsageError("--world second is a table of the usual size: add --table, and leave --size large out.")
    if table:
        if given.pop("estimates") or given.pop("bystander_objects") is not None:
            raise UsageError("--table writes no native files; leave --egoallo and --bystander-objects out.")
        # Recordings are acted out, sensed and curated in memory: training data without native files.
        from prbench.curation import BuildOptions
        from prbench.engine import engine_for
        from prbench.harness.synthetic_table import LARGE_RECORDINGS, Staging, build_synthetic_table

        large = given["size"] == "large"
        usual = LARGE_RECORDINGS if large else planned_recordings(given["size"], None)
        events = Staging.n_events if given["n_events"] is None else given["n_events"]
        chosen: dict[str, Any] = {
            "world": "large" if large else world,
            "n_events": events,
            "options": BuildOptions(replace=replace),
        }
        engine = engine_for(given["workers"])
        with progress(f"acting out {layout}") as acted:
            made = build_synthetic_table(
                layout, count or usual, given["seed"], out, engine=engine, **chosen, progress=acted
            )
        found = f"{made.info.counts.sequences} sequences of {len(made.records)} recordings"
        report = SynthesizeReport(folder=made.folder, built=built(made))
        return Answer(report, lambda: print(f"table: {made.folder} ({found})"))
    of_corpus = layout in _CORPUS_LAYOUTS
    planned = (count or _CORPUS_RECORDINGS) if of_corpus else planned_recordings(given["size"], count)
    done = itertools.count(1)
    with progress(f"writing {layout}") as tell:

        def tell_written(written: WrittenRecording) -> None:
            tell(next(done), planned, written.recording_id)

        shared = {"seed": given.pop("seed"), "workers": given.pop("workers"), "on_written": tell_written}
        if of_corpus:
            tree = load_built_in(CORPORA, "synthesize")(layout, out, recordings=planned, **shared)
        else:
            tree = synthesize_tree(layout, out, recordings=count, **given, **shared)

    def show() -> None:
        rows = []
        for each in tree.recordings:
            objects = "" if of_corpus else str(each.n_objects)
            rows.append((each.recording_id, each.split, f"{each.duration:.1f}", str(each.n_events), objects))
        header = ("recording", "split", "seconds", "texts" if of_corpus else "events", "" if of_corpus else "objects")
        print_table("synthetic recordings", header, rows, numbers=(2, 3, 4))
        then = f"the truth is in {tree.root}/truth; readers never open it"
        if of_corpus:
            then = f"build them with `prbench build-corpus {layout} --root {tree.root}`"
        print(f"recordings: {tree.root} ({then})")

    return Answer(SynthesizeReport(folder=tree.root, recordings=tree.recordings), show)
