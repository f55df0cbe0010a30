"""Renders runs, or recorded motion, into one file: ``prbench view``."""

from __future__ import annotations

import itertools
import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from prbench.errors import MissingExtraError, StorageError, UsageError
from prbench.files.storage import turn_into_paths
from prbench.harness.benchmark import load_benchmark
from prbench.harness.controls import GROUND_TRUTH
from prbench.harness.first_run import tables_of_runs
from prbench.harness.results import RunChecker
from prbench.harness.run_folder import RunFolder
from prbench.harness.run_folder.scores import CodedScores
from prbench.protocol.manifests import default_benchmark
from prbench.sequences import SequenceTable
from prbench.sequences.dataset_info import require_may_pass_on
from prbench.sequences.table import by_share, find_sequence_id
from prbench.viewing.figures import FORMATS
from prbench.viewing.player.document import PlayerMotion, PlayerSequence, player_sequence, within
from prbench.viewing.player.links import PAGE, motion_link, worst_first
from prbench.viewing.player.page import write_page
from prbench.viewing.player.surroundings import surrounded
from prbench.viewing.replay.read import RunMotions, read_scenes, run_labels
from prbench.viewing.replay.scene import METHOD_COLOURS, Progress, Scene, known_scores
from prbench.viewing.replay.sheet import MOST_SCENES, draw_sheet

DEFAULT_LIMIT = 4
LARGEST_PAGE = 40_000_000  # bytes of motions: about 1,000 sequences of two motions


@dataclass(frozen=True, kw_only=True)
class ViewRequest:
    """The sequences and runs that a user wants to see.

    Attributes:
        out: The file; its suffix chooses the kind. None for a page in the run's folder.
        runs: Run folders whose motions stand beside one another; none for recorded motion alone.
        data: Tables; where none is given, the tables in prbench's own cache are tried.
        sequences: Ids, or parts of ids that fit one sequence only.
        limit: Largest number of sequences of each dataset, chosen as `prbench run --limit` does; by default four, in a
            page as many as fit, the worst first.
        sample: Number of the shown motion, for runs that drew several.
        permitted: Datasets for which the user has permission to pass recorded motion on.
        root: The recordings that the table was built from; a page shows their objects and the scan of their scene.
        mesh: Another mesh of the scene, in the coordinates of the recordings' files.
        option: Options of the reader of the recordings that the table does not tell.

    Raises:
        UsageError: if parts of it do not fit together.
    """

    out: Path | None = None
    runs: tuple[Path, ...] = ()
    data: tuple[Path, ...] = ()
    sequences: tuple[str, ...] = ()
    limit: int | None = None
    sample: int = 0
    permitted: Collection[str] = ()
    root: Path | None = None
    mesh: Path | None = None
    option: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        turn_into_paths(self, "out", "runs", "data", "root", "mesh")
        if self.root is None and (self.mesh is not None or self.option):
            raise UsageError("--mesh, --option: belong to recordings; name these with --root DIR.")
        if self.root is not None and self.out is not None and self.out.suffix.lower() != ".html":
            raise UsageError(f"--root: a page (.html) shows what stands around a body, not {self.out.name}.")
        if not self.runs and not self.data:
            raise UsageError("nothing to view: name a run folder, or a dataset folder with --data DIR.")
        if self.sequences and self.limit is not None:
            raise UsageError("--sequence names the sequences already; leave --limit out.")
        if len(self.runs) > len(METHOD_COLOURS):
            raise UsageError(f"expected at most {len(METHOD_COLOURS)} runs in one view, found {len(self.runs)}.")
        if len(set(self.runs)) < len(self.runs):
            raise UsageError("a run folder is named more than once.")


@dataclass(frozen=True)
class ViewReport:
    """The sequences that were shown.

    Attributes:
        scenes: Each a :class:`Scene`, of a page a :class:`PlayerSequence`; those of another benchmark have what stands
            in the report of the command.
        left_out: Number of sequences that a page has no room for.
        caption: Text below the picture in a paper; empty for films and pages.
    """

    out: Path
    scenes: tuple[Any, ...]
    left_out: int = 0
    caption: str = ""

    def told(self, scene: Any, motion: Any) -> str:
        """Return the scores of a motion in one line."""
        if isinstance(motion, PlayerMotion):
            return ", ".join(f"{score.title} {score.text}" for score in motion.scores) or "not scored"
        return ", ".join(" ".join(score) for score in known_scores(scene, motion)) or "not scored"

    @property
    def links(self) -> list[str]:
        """Addresses of the moments at which each sequence of a page is primed; none for a picture or film."""
        if self.out.suffix.lower() != ".html":
            return []
        page = self.out.absolute().as_uri()
        return [motion_link(scene.sequence_id, scene.prime_time, page) for scene in self.scenes]

    @property
    def notices(self) -> tuple[str, ...]:
        """The notices that the datasets' terms ask for, as they stand in the view."""
        return tuple(dict.fromkeys(scene.notice for scene in self.scenes if scene.notice))


def view(request: ViewRequest, progress: Progress = lambda *_: None) -> ViewReport:
    """Render runs, or recorded motion, into one file.

    Raises:
        UsageError: if the file's suffix is unknown, or a sequence is unknown or left out by a run.
        RunError: if a run has no predictions, was made on another table, or its scores are not those of its motions.
        TableError: if a table cannot be found or read.
        RedistributionError: if nothing is left that the licence lets be shown.
        MissingExtraError: if MP4 is asked for without the extra `view`.
        StorageError: if the file cannot be written.
    """
    # First of all: an unwritable kind of file must not fail after minutes of drawing.
    if request.out is not None:
        file_kind(request.out)
    if request.runs:
        benchmark = RunFolder.open(request.runs[0], any_benchmark=True).record.benchmark
        if benchmark != default_benchmark().name:
            if request.out is None:
                kinds = "(.png, .svg, .pdf)"
                raise UsageError(f"--out FILE: a run of {benchmark} is drawn as a picture {kinds}; name the file.")
            return load_benchmark(benchmark).view(request)
    out = request.out or Path(PAGE)
    # A page that nobody named a file for goes into the folder of a single run, so that it moves along; where that
    # folder cannot be written, and for anything else, into the present folder.
    if request.out is None and len(request.runs) == 1 and os.access(request.runs[0], os.W_OK):
        out = request.runs[0] / PAGE
    kind = file_kind(out)
    if kind == "html":
        return _view_page(request, out, progress)
    scenes = scenes_of(request)
    return ViewReport(out, scenes, caption=write_view(scenes, out, kind, progress))


def _view_page(request: ViewRequest, out: Path, progress: Progress) -> ViewReport:
    """Write the page of all sequences that were asked for, or of as many of each dataset as there is room for."""
    shown = _shown(request)
    chosen = _chosen(request, shown, most=None)
    total = sum(map(len, chosen))
    if request.root is not None:
        if len(shown) > 1:
            raise UsageError("--root: holds the recordings of one dataset; name its table with --data DIR.")
        require_may_pass_on(shown[0][0].info, "the objects and the scene in the page", request.permitted)

    def documents(scenes: Iterator[Scene], done: int) -> Iterator[PlayerSequence]:
        for number, scene in enumerate(scenes, done + 1):
            yield player_sequence(scene)
            progress(number, total, scene.sequence_id)

    sequences: list[PlayerSequence] = []
    for (table, motions), ids in zip(shown, chosen, strict=True):
        room = LARGEST_PAGE // len(shown)
        held = within(documents(_scenes(request, table, motions, ids), len(sequences)), room)
        if request.root is not None:
            held = within(surrounded(held, table, request.root, request.mesh, request.option, progress), room)
        sequences += held
    write_page(sequences, out)
    return ViewReport(out, tuple(sequences), left_out=total - len(sequences))


Shown = Sequence[tuple[SequenceTable, list[RunMotions]]]


def scenes_of(request: ViewRequest) -> tuple[Scene, ...]:
    """Read what is to be shown, table after table."""
    shown = _shown(request)
    chosen = zip(shown, _chosen(request, shown), strict=True)
    return tuple(scene for (table, motions), ids in chosen for scene in _scenes(request, table, motions, ids))


def _shown(request: ViewRequest) -> Shown:
    """Open the tables, and on each the motions of the runs."""
    runs = [RunFolder.open(path) for path in request.runs]
    labels = run_labels([run.path for run in runs], [run.record for run in runs])
    if runs:
        tables = tables_of_runs(runs, request.data)
    else:
        tables = [SequenceTable.open(path).with_sequences() for path in request.data]
    # The scores stand beside the motions in the picture, so they have to be theirs.
    for table in tables:
        for run in runs:
            record = next(record for record in run.record.tables if record.dataset == table.info.dataset)
            if run.dataset(record.dataset).finished:
                RunChecker(lambda _, table=table: table).check(run, record)
    named = list(zip(runs, labels, strict=True))
    opened = partial(RunMotions.open, sample=request.sample)
    return [(table, [opened(run, table.info.dataset, label=label) for run, label in named]) for table in tables]


def _scenes(
    request: ViewRequest, table: SequenceTable, motions: Sequence[RunMotions], ids: Sequence[str]
) -> Iterator[Scene]:
    # Every view shows the recorded motion anyway; a shuffled control of it shows other motions and stays.
    made = [(each.run.record.method.name, each.run.record.control) for each in motions]
    generated = [each for each, how in zip(motions, made, strict=True) if how != (GROUND_TRUTH, None)]
    return read_scenes(table, ids, generated, request.permitted) if ids else iter(())


def _chosen(request: ViewRequest, shown: Shown, most: int | None = DEFAULT_LIMIT) -> list[list[str]]:
    """Ids of each table: those asked for, else ``most`` that every run holds; all, the worst first, if that is None."""
    rows = [table.scalars(columns=["sequence_id", "recording_id"]) for table, _ in shown]
    known = [table["sequence_id"].to_pylist() for table in rows]
    chosen = []
    if not request.sequences:
        for (_, runs), ids, table in zip(shown, known, rows, strict=True):
            recording_of = dict(zip(ids, table["recording_id"].to_pylist(), strict=True))
            held = [name for name in ids if all(name in run for run in runs)]
            shared = by_share(held, [recording_of[name] for name in held])
            taken = set(shared[: request.limit or most])
            if most is None:
                scored = [run.files.scores for run in runs if run.files.scores.is_file()]
                ordered = dict.fromkeys([*worst_first(map(CodedScores.read, scored)), *shared])
                chosen.append([name for name in ordered if name in taken])
            else:
                chosen.append([name for name in ids if name in taken])
        if not any(chosen):
            raise UsageError("these runs have no sequence in common; run them with the same --split and --limit.")
        return chosen
    # A part of an id has to fit one sequence of all tables together, so it is looked for among all of them.
    everything = list(itertools.chain.from_iterable(known))
    among = ", ".join(table.info.dataset for table, _ in shown)
    wanted = list(dict.fromkeys(find_sequence_id(name, everything, among=among) for name in request.sequences))
    for (_, runs), ids in zip(shown, known, strict=True):
        chosen.append([name for name in wanted if name in ids])
        for name, motions in ((name, motions) for motions in runs for name in chosen[-1]):
            if name not in motions:
                run = motions.run
                limited = "" if run.record.limit is None else f" with --limit {run.record.limit}"
                problem = f"{run.path}: holds no motion of {name}; the run was of split '{run.record.split}'{limited}."
                raise UsageError(f"{problem} Run this sequence alone: prbench run … --sequence ID")
    return chosen


def file_kind(path: Path) -> str:
    """Return the kind of file, ``html``, ``png``, ``svg``, ``pdf`` or ``mp4``, that a path asks for.

    A command calls it first: everything that it refuses would otherwise fail after minutes of drawing.

    Raises:
        UsageError: if the path ends in something else.
        StorageError: if it is a folder.
        MissingExtraError: if a package is needed that is not installed.
    """
    suffix = path.suffix.lower()
    if suffix not in (".html", *FORMATS, ".mp4"):
        found = f"'{suffix}'" if suffix else "no suffix"
        raise UsageError(f"{path}: expected a file that ends in .html, .png, .svg, .pdf or .mp4, found {found}.")
    if path.is_dir():
        raise StorageError(f"{path}: is a folder. Choose a file for --out.")
    # Only looked for, not imported: whether it is there is all that is asked yet.
    if suffix == ".mp4" and find_spec("imageio_ffmpeg") is None:
        raise MissingExtraError("imageio-ffmpeg", "view", "writing MP4")
    return suffix[1:]


def write_view(scenes: Sequence[Scene], path: Path, kind: str, progress: Progress) -> str:
    """Render scenes into one file, and return the caption of a picture; empty for films and pages.

    Args:
        scenes: Scenes to show, in order.
        path: The file; replaced when it exists.
        kind: What :func:`file_kind` returned for the path.
        progress: Called after every step.

    Raises:
        UsageError: if a picture would become too large.
        StorageError: if the file cannot be written.
    """
    if f".{kind}" in FORMATS:
        if len(scenes) > MOST_SCENES:
            raise UsageError(f"{path}: expected at most {MOST_SCENES} sequences in one picture, found {len(scenes)}.")
        return draw_sheet(scenes, path, progress=progress)
    if kind == "mp4":
        from prbench.viewing.replay.film import film_scenes

        film_scenes(scenes, path, progress)
    else:
        write_page(map(player_sequence, scenes), path)
    return ""
