"""The user study of motion prediction (*GazeMoDiff*, section 5): which of two predictors' futures people prefer.

People see windows with futures of both, and say whose are more realistic and whose are more precise. What follows the
study and what differs: docs/telling-apart.md#the-user-study-of-motion-prediction.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from scipy.stats import wilcoxon

from prbench.datasets import ON_SYNTHETIC_DATA, SYNTHETIC_PREFIX
from prbench.errors import UsageError
from prbench.sequences.dataset_info import notice, require_may_pass_on
from prbench.sequences.table import by_share
from prbench.tables import Block, Cell, Row, Table
from prbench.viewing.pairs import BlindPair, PairsKey, Question, answers_table, read_key, write_pairs
from prbench.viewing.player.document import packed
from prbench.viewing.replay.read import run_labels
from prbench.viewing.replay.scene import METHOD_COLOURS
from prbench_benchmarks.motion_prediction.batch import Condition
from prbench_benchmarks.motion_prediction.benchmark import MOTION_PREDICTION, run_on
from prbench_benchmarks.motion_prediction.futures import held_windows, read_futures
from prbench_benchmarks.motion_prediction.protocol import load_prediction_protocol
from prbench_benchmarks.motion_prediction.study_tables import published_scores
from prbench_benchmarks.motion_prediction.table import WindowsTable

SHOWN_FUTURES = 10  # of each predictor, as in the study
_FEWEST_PEOPLE = 6  # below, no signed ranks are significant at 5 %
QUESTIONS = (
    Question(
        name="realism",
        text="Whose motions could a person have made? Look for twisted joints, limbs that change their length, jumps.",
    ),
    Question(
        name="precision",
        text="Whose motions come closer to what happened, which is shown in black?",
        beside_recorded=True,
    ),
)


class ShownFutures(msgspec.Struct, frozen=True, kw_only=True):
    """What the page is told of one window; positions are int16 millimetres (frames, joints, 3), as in the player.

    Attributes:
        name: Name of the pair.
        bones: Parent and child of each bone.
        head: Place of the head among the joints.
        colours: ``#rrggbb`` of the left and the right side.
        observed: What both predictors have seen.
        recorded: What happened then.
        sides: The futures of the left and the right side.
    """

    name: str
    fps: float
    bones: tuple[tuple[int, int], ...]
    head: int
    colours: tuple[str, str]
    observed: bytes
    recorded: bytes
    sides: list[list[bytes]]


def _in_order(shown: ShownFutures, name: str, order: tuple[int, int]) -> ShownFutures:
    return msgspec.structs.replace(shown, name=name, sides=[shown.sides[place] for place in order])


def write_pairs_of_predictors(
    runs: Sequence[Path],
    data: Sequence[Path],
    out: Path,
    *,
    pairs: int = 16,
    seed: int = 0,
    permitted: Collection[str] = (),
) -> PairsKey:
    """Write a page on which people compare the futures of two runs in the same windows, and its key.

    Args:
        runs: Run folders of two predictors.
        data: Their tables of windows.
        out: Folder that gets ``pairs.html`` and ``key.json``.
        pairs: Most windows, of each table as many: the longest recorded futures first, of each recording its share.
        seed: Decides their order and sides.
        permitted: Datasets for which the user has permission to pass recorded motion on.

    Raises:
        UsageError: for other than two runs, no table, no window that both hold, or futures of one design of which
            fewer would be shown.
        RunError: for a run of another benchmark or table.
        RedistributionError: if a table's recorded motion must not be passed on.
        StorageError: if a file cannot be written.
    """
    if len(runs) != 2 or not data:
        problem = "expected two runs of predictors and their windows (--data DIR)"
        raise UsageError(f"analyse pairs: {problem}, found {len(runs)} of the runs and {len(data)} tables.")
    tables = [WindowsTable.open(folder) for folder in data]
    for table in tables:
        require_may_pass_on(table.info, "the page", permitted)
    opened = [[run_on(path, table) for path in runs] for table in tables]
    records = [run.record for run, _ in opened[0]]
    first, second = run_labels(runs, records)
    if first == second:
        raise UsageError(f"analyse pairs: expected two runs that can be told apart, found two of {first}.")
    samples = min(SHOWN_FUTURES, *(record.samples for record in records))
    for path, record in zip(runs, records, strict=True):
        if record.method.one_design and record.samples != samples:
            why = f"its {record.samples} futures are one design, of which {samples} are no part"
            raise UsageError(f"{path}: {why}. Run it with --samples {samples}.")
    shown = []
    for table, both in zip(tables, opened, strict=True):
        files = [each for _, each in both]
        windows = table.windows["window_id"].to_pylist()
        scored = dict(zip(windows, table.windows["n_scored"].to_pylist(), strict=True))
        known = held_windows(files, windows)
        if not known:
            raise UsageError(f"{' and '.join(map(str, runs))}: expected runs on the same windows, found none in both.")
        recordings = MOTION_PREDICTION.recordings_of(table)
        spread = by_share(known, [recordings[name] for name in known])
        chosen = set(sorted(spread, key=lambda name: -scored[name])[: max(1, pairs // len(tables))])
        futures = [read_futures(each, chosen, len(table.joints.names)) for each in files]
        places = np.flatnonzero(np.isin(windows, list(chosen)))
        # The frame of the futures: a page that shows the room would tell more than the motion.
        frame = load_prediction_protocol().evaluation.frame
        batch, truth = next(table.batches(Condition.POSE, places, frame=frame, size=len(places)))
        for row, name in enumerate(truth.window_ids):
            n = truth.n_scored[row]
            told = ShownFutures(
                name=name,
                fps=batch.fps,
                bones=table.joints.bones,
                head=table.joints.index(table.joints.head)[0],
                colours=METHOD_COLOURS[:2],
                observed=packed(batch.observed_joints[row]),
                recorded=packed(truth.joints[row, :n]),
                sides=[[packed(future[:n]) for future in each[name][:samples]] for each in futures],
            )
            about = (name, table.info.dataset, truth.recording_ids[row], (first, second))
            shown.append(BlindPair(*about, partial(_in_order, told), notice(table.info, permitted)))
    about = {"questions": QUESTIONS, "counted": (first, second), "benchmark": MOTION_PREDICTION.name}
    return write_pairs(shown, out, seed=seed, **about)


def user_study_table(folder: Path, files: Sequence[Path]) -> Table:
    """Count whom people preferred, beside the study's Table 4; see :func:`prbench.viewing.pairs.answers_table`.

    Raises:
        InputFileError: see there.
    """
    table = answers_table(folder, files)
    printed: dict[tuple[str, str], list[Cell]] = {}
    published = published_scores("user_study")
    for each in published:
        about: dict[str, Any] = {name: each[name] for name in ("method", "variant", "metric", "note")}
        cell = Cell(value=float(each["value"]), unit="%", origin="published: GazeMoDiff, Table 4", **about)
        printed.setdefault((each["method"], each["variant"]), []).append(cell)
    rows = tuple(Row(text={"chosen": ", ".join(key)}, cells=tuple(cells)) for key, cells in printed.items())
    measured = msgspec.structs.replace(table.blocks[0], title="measured")
    blocks = (measured, Block(title="printed in the study", rows=rows))
    notes = [*table.notes, *dict.fromkeys(each["note"] for each in published if each["note"])]
    notes.append("The study asked 21 people about 4 windows of MoGaze and 12 of GIMO, and printed no intervals.")
    key = read_key(folder)
    found = [cell for row in table.blocks[0].rows for cell in row.cells if cell.variant.startswith("by ")]
    for question in QUESTIONS:
        mine = [cell.value for cell in found if (cell.metric, cell.method) == (question.name, key.counted[0])]
        apart = np.array(mine, dtype=np.float64) - 50
        if len(mine) >= _FEWEST_PEOPLE and apart.any():
            _, p_value = wilcoxon(apart)
            notes.append(f"{question.name}: p = {p_value:.3f} (Wilcoxon's signed ranks of {len(mine)} people).")
    if any(pair.dataset.startswith(SYNTHETIC_PREFIX) for pair in key.pairs):
        notes.append(ON_SYNTHETIC_DATA)
    title = "Whose futures people prefer, beside Table 4 of the study"
    return msgspec.structs.replace(table, title=title, blocks=blocks, notes=tuple(notes))
