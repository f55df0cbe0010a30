"""Native recordings into a table: the command ``prbench build-dataset``, and synthetic recordings to try it on."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from prbench.api import arguments as args
from prbench.api.pictures import frame_from_rows, notebook_table, progress
from prbench.api.tables import Table, open_table
from prbench.errors import UsageError
from prbench.object_stores.store import is_url

if TYPE_CHECKING:
    import pandas as pd

    from prbench.curation import BuildReport
    from prbench.synthetic.write_tree import WrittenTree


@dataclass(frozen=True, eq=False, repr=False)
class Build:
    """The result of :func:`prbench.build_dataset`: a table, and what became of the recordings and events."""

    _report: BuildReport

    @property
    def folder(self) -> Path:
        """Folder of the table."""
        return self._report.folder

    @property
    def table(self) -> Table:
        """The table, opened."""
        return open_table(self.folder)

    @property
    def summary(self) -> str:
        """One line a stage, from files to sequences: how many were kept, how many dropped, and why."""
        lines = []
        for stage, kept, dropped, why in self._rows():
            lines.append(f"{stage}: {kept}{f', {dropped} dropped' if dropped else ''}{f' ({why})' if why else ''}")
        return "\n".join(lines)

    @property
    def unread(self) -> dict[str, str]:
        """Recordings that are not in the table, by name, each with the reason."""
        lost = [record for record in self._report.records if record.status != "read"]
        return {record.recording_id: f"{record.status}: {record.message}" for record in lost}

    @property
    def notes(self) -> tuple[str, ...]:
        """Everything that the command says beside its table, one line each.

        Recordings that were taken over from an interrupted build, that could not be read, of which a stream ends early
        (events may be missing), and that gave no sequence, with the reason.
        """
        records = self._report.records
        notes = []
        if self._report.reused:
            notes.append(f"{self._report.reused} recordings were taken over from an interrupted build.")
        notes += [f"{name}: {why}" for name, why in self.unread.items()]
        notes += [f"{one.recording_id}: cut short: {shortfall}" for one in records for shortfall in one.shortfalls]
        notes += [f"{one.recording_id}: streams: {finding}" for one in records for finding in one.findings]
        notes += [f"{one.recording_id}: no sequence: {one.why_fruitless}" for one in records if one.is_fruitless]
        return tuple(notes)

    def to_pandas(self) -> pd.DataFrame:
        """Return the way from files to sequences: one row a stage with columns ``stage, kept, dropped, why``."""
        return frame_from_rows(self._rows(), ("stage", "kept", "dropped", "why"))

    def _rows(self) -> list[tuple[str, int, int, str]]:
        from prbench.curation import funnel_rows

        return funnel_rows(self._report.info)

    def __repr__(self) -> str:
        return f"<Build of {self._report.info.title}: {self._report.info.counts.sequences} sequences, {self.folder}>"

    def _repr_html_(self) -> str:
        title = f"{self._report.info.title}: from files to sequences"
        return notebook_table(title, self.to_pandas(), [*self.notes, f"table: {self.folder}"])


def build_dataset(
    dataset: str,
    root: args.PathLike,
    out: args.PathLike,
    *,
    replace: bool = False,
    recordings: str = "*",
    max_recordings: int | None = None,
    in_hand: str | None = None,
    ray_origin: Literal["eye", "camera"] | None = None,
    priming: Literal["rule", "published"] = "rule",
    minimum_movement: str = "wrist_to_goal",
    min_confidence: float = 0.0,
    corrections: args.PathLike | None = None,
    events_only: bool = False,
    shift: Mapping[str, float] | None = None,
    scale: Mapping[str, float] | None = None,
    protocol: args.PathLike | None = None,
    on_error: Literal["skip", "fail"] = "skip",
    option: Mapping[str, object] | None = None,
    workers: args.Workers = 1,
) -> Build:
    """Turn a dataset's recordings into a table of prime-and-reach sequences, as ``prbench build-dataset`` does.

    A build that was interrupted goes on where it stopped. Recordings that cannot be read are left out and named in
    :attr:`Build.unread`; :attr:`Build.notes` tells what else was noticed.

    Args:
        dataset: Name of the dataset, for example ``adt``; ``prbench datasets`` lists them.
        root: Your copy of the dataset.
        out: Folder of the table; an earlier one is replaced once the new one is ready, if that lacks nothing.
        replace: Replace an earlier table even where the new one lacks recordings that it holds.
        recordings: Only recordings whose name matches this pattern; ``*`` stands for any text.
        max_recordings: Number of recordings to build, the first by name; None for all.
        in_hand: Another rule of the dataset for "the hand holds the object", for example ``wrist``.
        ray_origin: Point where gaze rays start; the eye by default.
        priming: Prime times by the study's equations (``rule``), or taken over where the dataset publishes them.
        minimum_movement: What must be at least 20 cm: ``wrist_to_goal``, ``pelvis_displacement`` or
            ``object_displacement``.
        min_confidence: Smallest ``event_confidence`` of a sequence, from 0 to 1; events below end as
            ``low_confidence``.
        corrections: File of a person's corrections of events, CSV or TOML (docs/review.md).
        events_only: List picks and puts from the annotations alone, without sequences (hd-epic).
        shift: Seconds to add to the times of a stream: gaze, camera, head, body, hands or objects.
        scale: Factor on the positions of a stream, such as ``{"objects": 0.001}`` for millimetres.
        protocol: Your own ``protocol.toml``, stamped into the table; by default prbench's.
        on_error: Go on without a recording that cannot be read (``skip``), or ``fail`` at once.
        option: Options of the dataset's reader, by name; ``poses`` says where bodies come from, for example ``egoallo``
            in place of ADT's suit; ``manifest`` is the file of ``own`` recordings (docs/own-recordings.md).
        workers: Processes to use, or a :class:`prbench.Cluster`; changes no result. A script that asks for several
            processes needs ``if __name__ == "__main__":``.

    Returns:
        What was built; :attr:`Build.table` opens it.

    Raises:
        UsageError: for an unknown dataset or option.
        InputFileError: if there is nothing to read, or a recording cannot be read and ``on_error`` is ``fail``.
        StorageError: if ``out`` cannot be written, holds something else, or holds more than the new table would.
        MissingExtraError: if a rule asks for meshes without the extra ``open3d``, or a cluster without ``ray``.
        ClusterError: if a cluster cannot be reached, or a node is unfit.
    """
    given: dict[str, Any] = dict(locals())
    from prbench.curation import build_dataset as build
    from prbench.curation.options import build_options

    if dataset == "all":
        remedy = "name one dataset, or run `prbench build-dataset all --root DIR --out DIR`."
        raise UsageError(f"dataset 'all' builds several tables: {remedy}")
    args.require_positive(max_recordings=max_recordings)
    if on_error not in ("skip", "fail"):
        raise UsageError(f"on_error: expected skip or fail, found '{on_error}'.")
    chosen = {
        name: value for name, value in given.items() if name not in ("dataset", "root", "out", "workers", "option")
    }
    paths: dict[str, Any] = {name: args.as_optional_path(given[name]) for name in ("protocol", "corrections")}
    options = build_options(**(chosen | paths), option=args.as_options(option))
    if is_url(root):  # a local copy of the files that the dataset's reader asks for
        from prbench.object_stores.inputs import fetched_native

        source = fetched_native(str(root), dataset)
    else:
        source = Path(root).expanduser()
    with (
        args.output_folder(out) as folder,
        args.engine_of(workers, reads=(source,), writes=(folder,), packages=options.packages) as engine,
        progress(f"building {dataset}") as show,
    ):
        report = build(dataset, source, folder, options=options, engine=engine, progress=show)
    return Build(report)


@dataclass(frozen=True, eq=False, repr=False)
class SyntheticRecordings:
    """Recordings of synthetic people, written as files in a dataset's own layout.

    Attributes:
        layout: The dataset whose layout the files have; the name to build them under.
    """

    layout: str
    _tree: WrittenTree

    @property
    def folder(self) -> Path:
        """Folder of the recordings; the ``root`` of :func:`prbench.build_dataset`."""
        return self._tree.root

    @property
    def summary(self) -> str:
        """One line a recording: split, seconds, events and objects."""
        return "\n".join(
            f"{one.recording_id}: {one.split}, {one.duration:.1f} s, {one.n_events} events, {one.n_objects} objects"
            for one in self._tree.recordings
        )

    def to_pandas(self) -> pd.DataFrame:
        """Return one row a recording with columns ``recording_id, split, duration, n_events, n_objects``."""
        columns = ("recording_id", "split", "duration", "n_events", "n_objects")
        rows = [tuple(getattr(one, name) for name in columns) for one in self._tree.recordings]
        return frame_from_rows(rows, columns)

    def __repr__(self) -> str:
        return f"<{len(self._tree.recordings)} synthetic recordings in the layout of {self.layout}, {self.folder}>"

    def _repr_html_(self) -> str:
        title = f"synthetic recordings in the layout of {self.layout}"
        return notebook_table(title, self.to_pandas(), [f"folder: {self.folder}"])


def synthesize(
    layout: str,
    out: args.PathLike,
    *,
    count: int | None = None,
    seed: int = 0,
    size: Literal["tiny", "default"] = "tiny",
    events: int | None = None,
    bystander_objects: int | None = None,
    egoallo: bool = False,
    workers: int = 1,
) -> SyntheticRecordings:
    """Write recordings of synthetic people in a dataset's own files, as ``prbench synthesize`` does.

    So everything can be tried without any data; what happened is known, and written beside the files.

    Args:
        layout: Dataset whose layout the files have, for example ``adt`` or ``hot3d``.
        out: Folder of the recordings; earlier synthetic ones there are replaced.
        count: Number of recordings to make; by default the size's number (2 or 24).
        seed: Seed of everything that is drawn.
        size: ``tiny`` or ``default``.
        events: Picks and puts a recording; by default the size's number (6 or 10).
        bystander_objects: Objects that never move.
        egoallo: Also write bodies as EgoAllo would estimate them (``adt`` alone).
        workers: Processes to use; changes no result. A script that asks for several needs
            ``if __name__ == "__main__":``.

    Returns:
        What was written.

    Raises:
        UsageError: for an unknown layout or size, or a folder that holds something else.
        StorageError: if the folder cannot be written.
    """
    from prbench.synthetic.write_tree import planned_recordings, synthesize_tree

    args.require_positive(count=count, events=events, workers=workers)
    planned = planned_recordings(size, count)
    done = itertools.count(1)
    with args.output_folder(out) as folder, progress(f"writing {layout}") as show:
        chosen = {"recordings": count, "seed": seed, "size": size, "n_events": events, "estimates": egoallo}
        chosen |= {"bystander_objects": bystander_objects, "workers": workers}
        tree = synthesize_tree(
            layout, folder, **chosen, on_written=lambda one: show(next(done), planned, one.recording_id)
        )
    return SyntheticRecordings(layout, tree)
