"""``prbench synthesize``: synthetic recordings in a dataset's native files, with the truth beside them."""

from __future__ import annotations

import argparse
import itertools
from pathlib import Path
from typing import TYPE_CHECKING

from prbench.cli.arguments import add_workers, command, positive
from prbench.cli.builds import add_replace
from prbench.cli.progress import progress
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench.engine import Engine
    from prbench.workflows.matching import Verification

_FEWEST_VERIFIED = 4
"""Recordings on which each noise level is verified at least."""
_SCENES_OF_ONE_PRESET = 12
_RECORDINGS_OF_A_HISTOGRAM = 10


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Register the command."""
    parser = command(
        commands,
        "synthesize",
        summary="write synthetic recordings in a dataset's native layout, with the truth beside them",
        example="prbench synthesize adt --recordings 4 --seed 1 --out synthetic/adt",
        execute=_synthesize,
    )
    parser.add_argument(
        "layout",
        nargs="?",
        help="native layout to write (any dataset of `prbench datasets`); for --gallery alone any preset",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder of the recordings")
    parser.add_argument(
        "--table",
        action="store_true",
        help="write the finished table of sequences instead of native files (the only way for size large)",
    )
    add_replace(parser)
    parser.add_argument("--recordings", type=positive, metavar="N", help="how many (default: the size's number)")
    parser.add_argument("--seed", type=int, default=0, help="of everything (default 0)")
    parser.add_argument("--size", choices=["tiny", "default", "large"], default="tiny", help="how much (default tiny)")
    parser.add_argument("--events", type=positive, metavar="N", help="picks and puts a recording")
    parser.add_argument("--bystander-objects", type=int, metavar="N", help="objects that never move")
    parser.add_argument(
        "--defect",
        action="append",
        default=[],
        metavar="NAME",
        help="damage the first recording as real copies are; repeatable (a wrong name lists them)",
    )
    parser.add_argument(
        "--egoallo",
        action="store_true",
        help="also write bodies as EgoAllo would estimate them (adt; hd-epic and hot3d have no others)",
    )
    parser.add_argument(
        "--no-verify", action="store_true", help="do not compare what curation finds in the files with the truth"
    )
    parser.add_argument(
        "--gallery", type=Path, metavar="FILE", help="draw sequences of LAYOUT, or of all presets without one, as PNG"
    )
    parser.add_argument(
        "--histograms", type=Path, metavar="FILE", help="draw durations, gaps and movements beside the study's, as PNG"
    )
    add_workers(parser)


def _synthesize(arguments: argparse.Namespace) -> int:
    from prbench.errors import UsageError

    draws = arguments.gallery is not None or arguments.histograms is not None
    if not draws and arguments.layout is None:
        raise UsageError("name a layout to write (for example: prbench synthesize adt --out DIR), or --gallery FILE.")
    if arguments.layout is not None and (arguments.out is not None or not draws):
        if arguments.table:
            _write_table(arguments)
        else:
            _write_tree(arguments)
    if arguments.gallery is not None:
        _draw_gallery(arguments)
    if arguments.histograms is not None:
        _draw_histograms(arguments)
    return 0


def _write_tree(arguments: argparse.Namespace) -> None:
    from prbench.engine import engine_for
    from prbench.errors import UsageError
    from prbench.synthetic.corpus import CORPUS_LAYOUTS
    from prbench.synthetic.write_tree import planned_recordings, synthesize_tree

    if arguments.out is None:
        raise UsageError("--out DIR is needed: the folder of the recordings.")
    if arguments.layout in CORPUS_LAYOUTS:
        _write_corpus_tree(arguments)
        return
    done = itertools.count(1)
    planned = planned_recordings(arguments.size, arguments.recordings)
    with progress(f"writing {arguments.layout}") as show:
        tree = synthesize_tree(
            arguments.layout,
            arguments.out,
            recordings=arguments.recordings,
            seed=arguments.seed,
            size=arguments.size,
            workers=arguments.workers,
            n_events=arguments.events,
            bystander_objects=arguments.bystander_objects,
            defects=arguments.defect,
            estimates=arguments.egoallo,
            on_written=lambda written: show(next(done), planned, written.recording_id),
        )
    print_table(
        "synthetic recordings",
        ("recording", "split", "seconds", "events", "objects"),
        [(r.recording_id, r.split, f"{r.duration:.1f}", str(r.n_events), str(r.n_objects)) for r in tree.recordings],
        numbers=(2, 3, 4),
    )
    if not arguments.no_verify and not arguments.defect:
        _verify(arguments, len(tree.recordings), engine_for(arguments.workers))
    print(f"recordings: {tree.root} (the truth is in {tree.root / 'truth'}; readers never open it)")


def _write_table(arguments: argparse.Namespace) -> None:
    """Act out, sense and curate recordings in memory: training data without native files."""
    from prbench.curation import BuildOptions
    from prbench.engine import engine_for
    from prbench.errors import UsageError
    from prbench.synthetic.write_tree import planned_recordings
    from prbench.workflows.synthetic_table import LARGE_RECORDINGS, build_synthetic_table

    if arguments.out is None:
        raise UsageError("--out DIR is needed: the folder of the table.")
    if arguments.defect or arguments.egoallo or arguments.bystander_objects is not None:
        raise UsageError("--table writes no native files; leave --defect, --egoallo and --bystander-objects out.")
    large = arguments.size == "large"
    recordings = arguments.recordings or (LARGE_RECORDINGS if large else planned_recordings(arguments.size, None))
    given = {} if arguments.events is None else {"n_events": arguments.events}
    with progress(f"acting out {arguments.layout}") as show:
        report = build_synthetic_table(
            arguments.layout,
            recordings,
            arguments.seed,
            arguments.out,
            engine=engine_for(arguments.workers),
            world="large" if large else "default",
            options=BuildOptions(replace=arguments.replace),
            progress=show,
            **given,
        )
    print(f"table: {arguments.out} ({report.info.counts.sequences} sequences of {recordings} recordings)")


def _write_corpus_tree(arguments: argparse.Namespace) -> None:
    """Write synthetic people in the layout of a text-motion dataset."""
    from prbench.synthetic.corpus import DEFAULT_RECORDINGS, synthesize_corpus_tree

    done = itertools.count(1)
    planned = arguments.recordings or DEFAULT_RECORDINGS
    with progress(f"writing {arguments.layout}") as show:
        tree = synthesize_corpus_tree(
            arguments.layout,
            arguments.out,
            recordings=planned,
            seed=arguments.seed,
            workers=arguments.workers,
            defects=arguments.defect,
            on_written=lambda written: show(next(done), planned, written.recording_id),
        )
    print_table(
        "synthetic recordings",
        ("recording", "split", "seconds", "texts"),
        [(r.recording_id, r.split, f"{r.duration:.1f}", str(r.n_events)) for r in tree.recordings],
        numbers=(2, 3),
    )
    print(f"recordings: {tree.root} (build them with `prbench build-corpus {arguments.layout} --root {tree.root}`)")


def _verify(arguments: argparse.Namespace, recordings: int, engine: Engine) -> None:
    """Compare curation with the truth, for the files just written and at each noise level for the same seed."""
    from prbench.workflows.verify_synthetic import LEVELS, verify_level, verify_tree

    rows = []
    with progress("comparing curation with the truth") as show:
        files = verify_tree(arguments.out, dataset=arguments.layout, engine=engine)
        rows.append(_verification_row("these files", files))
        for done, level in enumerate(LEVELS, start=1):
            show(done, len(LEVELS), level.name)
            result = verify_level(
                level,
                preset=arguments.layout,
                recordings=max(recordings, _FEWEST_VERIFIED),
                seed=arguments.seed,
                engine=engine,
            )
            rows.append(_verification_row(level.name, result))
    print_table(
        "what curation finds, against what was acted out",
        (
            "sensors", "recordings", "events", "recall", "precision", "timing bias", "median", "p95", "priming recall",
            "false primes", "prime median", "p5 … p95", "hands", "sequences",
        ),
        rows,
        numbers=range(1, 14),
    )  # fmt: skip
    print("times in ms; events within the sensors' resolution of a threshold and lost tracks are not counted")
    print("hands: right / wrong / unknown of all located events; sequences: found of those that were acted out")
    for miss in files.missed_sequences:
        print(f"no sequence in these files: {miss.text}")


def _verification_row(name: str, result: Verification) -> tuple[str, ...]:
    low, _, high = result.prime_quantiles
    return (
        name,
        str(result.recordings),
        str(result.true_events),
        f"{result.recall:.3f}",
        f"{result.precision:.3f}",
        f"{result.timing.bias * 1e3:+.0f}",
        f"{result.timing.median * 1e3:.0f}",
        f"{result.timing.p95 * 1e3:.0f}",
        f"{result.priming_recall:.3f}",
        f"{result.false_primes:.3f} of {result.unprimed}",
        f"{result.prime.median * 1e3:.0f}",
        f"{low * 1e3:+.0f} … {high * 1e3:+.0f}",
        f"{result.hands.right} / {result.hands.wrong} / {result.hands.unknown}",
        f"{result.expected_sequences - len(result.missed_sequences)} of {result.expected_sequences}",
    )


def _draw_gallery(arguments: argparse.Namespace) -> None:
    """Draw twelve sequences of all presets, or of the one that was named."""
    from prbench.synthetic.corpus import CORPUS_LAYOUTS
    from prbench.synthetic.people import perform
    from prbench.viewing.clip_strips import render_strips, strips_of_activities
    from prbench.viewing.gallery import render_contact_sheet, render_gallery, sequences_of

    if arguments.layout in CORPUS_LAYOUTS:
        render_strips(strips_of_activities(arguments.seed), arguments.gallery)
    elif arguments.layout is None:
        render_contact_sheet(arguments.gallery, seed=arguments.seed)
    else:
        performances = [perform(arguments.layout, seed=arguments.seed, index=index, n_events=6) for index in range(4)]
        render_gallery(sequences_of(performances)[:_SCENES_OF_ONE_PRESET], arguments.gallery)
    print(f"gallery: {arguments.gallery}")


def _draw_histograms(arguments: argparse.Namespace) -> None:
    """Draw statistics of some recordings of the preset that was named, or of all presets."""
    from prbench.synthetic.people import PRESETS, perform
    from prbench.viewing.distributions import render_histograms

    presets = tuple(PRESETS) if arguments.layout is None else (arguments.layout,)
    count = arguments.recordings or _RECORDINGS_OF_A_HISTOGRAM
    acted = {
        preset: [perform(preset, seed=arguments.seed, index=index, provocations={}) for index in range(count)]
        for preset in presets
    }
    render_histograms(acted, arguments.histograms)
    print(f"histograms: {arguments.histograms}")
