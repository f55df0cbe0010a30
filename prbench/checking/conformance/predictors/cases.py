"""The windows that a predictor is asked about, and the same without their futures."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from prbench.curation.windows import sliding_windows
from prbench.errors import UsageError
from prbench.geometry.skeleton import head_forward
from prbench.prediction.joint_sets import SMPL22
from prbench.prediction.protocol import load_prediction_protocol
from prbench.prediction.table import FILE_NAME, SCHEMA_VERSION, CutRun, Run, Window, WindowsInfo, WindowsTable
from prbench.prediction.table import write_windows as write
from prbench.sequences.table import by_share

if TYPE_CHECKING:
    from prbench.synthetic.performance import Performance

WINDOWS = 12
"""Asked about, unless a predictor is slow."""
_TO_LEARN_FROM = 60
"""Training windows; more than the benchmark's samples, so that a predictor may answer with one of them each."""
_TABLE = "windows"
_BLIND = "windows-without-futures"
_PRESET = "adt"
_SEED = 2024  # differs from that of embedded people, whom a predictor may have learnt from
_OF_ONE = 6  # windows a recording, so that several people are seen


@dataclass(frozen=True)
class AskedWindows:
    """Test windows, each a run of its own, and training runs behind them."""

    table: WindowsTable
    blind: WindowsTable
    """The same table, with NaN in every frame after the observed ones of the test windows."""


def synthetic_windows(folder: Path) -> AskedWindows:
    """Return windows of synthetic people; the first process makes and keeps them, later ones read the same numbers.

    Args:
        folder: Of this check alone.
    """
    if not _is_kept(folder):
        train = _first_windows(_performed("train"), _TO_LEARN_FROM)
        _keep(folder, _info(), _test_windows(), train)
    return _kept(folder)


def windows_of_table(data: Path, folder: Path) -> AskedWindows:
    """Return twelve test windows of a table, chosen as ``--limit`` does, with some of its training windows.

    Args:
        data: Folder of the table.
        folder: Of this check alone.

    Raises:
        TableError: if there is no such table.
        UsageError: if it has no test windows.
    """
    if _is_kept(folder):
        return _kept(folder)
    table = WindowsTable.open(data)
    places = table.chosen(split="test")
    rows = table.windows["row"].take(places)
    ids = table.windows["window_id"].take(places).to_pylist()
    wanted = set(by_share(ids, table.runs["recording_id"].take(rows).to_pylist())[:WINDOWS])
    chosen = {name: int(place) for name, place in zip(ids, places, strict=True) if name in wanted}
    _keep(folder, table.info, _cut_out(table, chosen), _training_runs(table))
    return _kept(folder)


def require_windows(data: Path) -> None:
    """Refuse a folder without test windows.

    Raises:
        TableError: if there is no table of windows.
        UsageError: if it has no test windows.
    """
    WindowsTable.open(data).chosen(split="test")


def _is_kept(folder: Path) -> bool:
    return (folder / _BLIND / FILE_NAME).is_file()


def _kept(folder: Path) -> AskedWindows:
    return AskedWindows(WindowsTable.open(folder / _TABLE), WindowsTable.open(folder / _BLIND))


def _keep(folder: Path, info: WindowsInfo, test: list[CutRun], train: list[CutRun]) -> None:
    """Write both tables, the blind one last, by which later processes know that both are there."""
    observed = info.observed_frames
    if not test:
        raise UsageError("expected windows of the test split to ask about, found none.")
    write(folder / _TABLE, info, [*test, *train])
    with np.errstate(invalid="ignore"):  # digests of numbers that are none
        write(folder / _BLIND, info, [*(CutRun(_blinded(each.run, observed), each.windows) for each in test), *train])


def _blinded(run: Run, observed: int) -> Run:
    changed = {}
    for name in ("joints", "gaze", "head_direction"):
        values = getattr(run, name).copy()
        values[observed:] = np.nan
        changed[name] = values
    return replace(run, **changed)


def _cut_out(table: WindowsTable, chosen: dict[str, int]) -> list[CutRun]:
    """Each window as a run of its own, of which nothing else is known; goals and events are left out."""
    info = table.info
    length = info.observed_frames + info.future_frames
    places = np.array(sorted(chosen.values()))
    names = {place: name for name, place in chosen.items()}
    row_of = {int(place): int(table.windows["row"][int(place)].as_py()) for place in places}
    runs = dict(table.iterate_runs(row_of.values()))
    cut = []
    for place in places.tolist():
        run = runs[row_of[place]]
        start = int(table.windows["start"][place].as_py())
        n_scored = int(table.windows["n_scored"][place].as_py())
        alone = _part(run, names[place], start, min(start + length, len(run)))
        looking = int(alone.gaze_valid[: info.observed_frames].sum())
        cut.append(CutRun(alone, (Window(0, looking, n_scored),)))
    return cut


def _training_runs(table: WindowsTable) -> list[CutRun]:
    """Runs of the training split until there are enough windows; none where the table has no such split."""
    try:
        places = table.chosen(split="train")[:_TO_LEARN_FROM]
    except UsageError:
        return []
    rows = table.windows.take(places).to_pylist()
    runs = dict(table.iterate_runs({row["row"] for row in rows}))
    return [CutRun(run, tuple(Window.of(row) for row in rows if row["row"] == number)) for number, run in runs.items()]


def _part(run: Run, name: str, first: int, end: int) -> Run:
    frames = {
        field: getattr(run, field)[first:end]
        for field in ("joints", "joints_valid", "gaze", "gaze_valid", "head_direction")
    }
    return replace(run, run_id=name, start_time=run.start_time + first / run.fps, **frames)


def _test_windows() -> list[CutRun]:
    """Half a second up to the prime, and the reach behind it."""
    from prbench.synthetic.performance import true_clips

    rules = load_prediction_protocol().windows
    length = rules.observed_frames + rules.future_frames
    cut: list[CutRun] = []
    for performance, run in _performed("test"):
        primes = [clip.event.prime_time for clip in true_clips(performance)]
        starts = [round((time or 0.0) * rules.fps) - rules.observed_frames for time in primes]
        for start in [each for each in starts if 0 <= each < len(run) - length][:_OF_ONE]:
            alone = _part(run, f"{run.run_id}/{start}", start, start + length)
            cut.append(CutRun(alone, (Window(0, rules.observed_frames, rules.future_frames),)))
        if len(cut) >= WINDOWS:
            return cut[:WINDOWS]
    raise AssertionError("synthetic people do not end")


def _first_windows(runs: Iterator[tuple[Performance, Run]], number: int) -> list[CutRun]:
    rules = load_prediction_protocol().windows
    found: list[CutRun] = []
    for _, run in runs:
        found.append(CutRun(run, sliding_windows(run, np.zeros(len(run), dtype=bool), rules)))
        if sum(len(each.windows) for each in found) >= number:
            break
    return found


def _performed(split: str) -> Iterator[tuple[Performance, Run]]:
    """Recordings of synthetic people of a split; no person and no room is in two of them."""
    from prbench.synthetic.people.perform import name_of_recording, perform
    from prbench.synthetic.people.world import Source, assign

    rules = load_prediction_protocol().windows
    source = Source(_SEED, _PRESET, "default")
    for index in count():
        if assign(source, index, "person_and_room").split != split:
            continue
        performance = perform(_PRESET, seed=_SEED, index=index, rate=2 * rules.fps, provocations={})
        joints = performance.joints[::2]
        name = name_of_recording(_PRESET, _SEED, index)
        yield (
            performance,
            Run(
                run_id=name,
                recording_id=name,
                participant_id=performance.person.participant_id,
                split=split,
                published_split="",
                segment="",
                pose_source="invented",
                fps=rules.fps,
                start_time=0.0,
                joints=joints,
                joints_valid=np.ones(len(joints), dtype=bool),
                gaze=performance.gaze[::2],
                gaze_valid=np.ones(len(joints), dtype=bool),
                head_direction=head_forward(joints, performance.person.neck_tilt_deg)[0],
            ),
        )


def _info() -> WindowsInfo:
    protocol = load_prediction_protocol()
    rules = protocol.windows
    unknown = ("prbench_version", "manifest_digest", "input_digest", "identity_digest", "content_digest", "homepage")
    return WindowsInfo(
        **dict.fromkeys((*unknown, "citation"), ""),
        schema_version=SCHEMA_VERSION,
        protocol_version=protocol.version,
        protocol_digest=protocol.digest,
        dataset="synthetic-conformance",
        title="Invented people (conformance check)",
        synthetic=True,
        options={},
        outcomes={},
        quarantine=(),
        licence="none needed: invented",
        redistribution="yes",
        fps=rules.fps,
        observed_frames=rules.observed_frames,
        future_frames=rules.future_frames,
        fewest_gaze_frames=rules.fewest_gaze_frames,
        joint_set=SMPL22.name,
        has_gaze=False,
        estimated_bodies=False,
        participants=0,
        recordings=0,
        runs=0,
        frames=0,
    )
