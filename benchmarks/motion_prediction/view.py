"""``prbench prediction view``: ask predictors about some windows, and have their futures drawn."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from prbench.datasets import SYNTHETIC_PREFIX
from prbench.errors import UsageError
from prbench.files.storage import turn_into_paths
from prbench.sequences.dataset_info import notice, require_may_pass_on
from prbench.sequences.table import find_sequence_id
from prbench.viewing.figures import FORMATS
from prbench.viewing.replay.scene import METHOD_COLOURS
from prbench.viewing.replay.sheet import file_kind
from prbench_benchmarks.motion_prediction.batch import Condition, Futures, ObservedBatch, Predictor, ask
from prbench_benchmarks.motion_prediction.folds import Fold, default_split, folds, share_of
from prbench_benchmarks.motion_prediction.futures import MOST_ROWS, Fan, ShownWindow, draw_futures
from prbench_benchmarks.motion_prediction.joint_sets import transform_each
from prbench_benchmarks.motion_prediction.metrics import displacements, frame_errors
from prbench_benchmarks.motion_prediction.protocol import load_prediction_protocol
from prbench_benchmarks.motion_prediction.published_numbers import TableRow
from prbench_benchmarks.motion_prediction.table import Truth, WindowsTable
from prbench_benchmarks.motion_prediction.tables.predictors import predictor_of, samples_of

DEFAULT_SAMPLES = 10
Progress = Callable[[int, int, str], None]


@dataclass(frozen=True, kw_only=True)
class FuturesRequest:
    """What a user wants to see.

    Raises:
        UsageError: if parts of it do not fit together.
    """

    windows: Path
    out: Path
    methods: tuple[str, ...]
    conditions: tuple[Condition, ...] = (Condition.POSE,)
    window_ids: tuple[str, ...] = ()
    """Ids, or parts of ids that fit one window only; empty for some of the test split."""
    limit: int | None = None
    """Windows that are shown where none is named; by default one."""
    samples: int = DEFAULT_SAMPLES
    weights: Path | None = None
    """Weights file of the method."""
    seed: int = 0
    device: str = "cpu"
    permitted: Collection[str] = ()
    """Datasets for which the user has permission to pass recorded motion on."""

    def __post_init__(self) -> None:
        turn_into_paths(self, "windows", "out", "weights")
        if self.out.suffix.lower() not in (*FORMATS, ".html"):
            raise UsageError(f"{self.out}: expected a file that ends in .png, .svg or .html.")
        if self.samples < 1 or (self.limit is not None and self.limit < 1):
            raise UsageError(f"expected one sample and one window or more, found {self.samples} and {self.limit}.")
        if self.window_ids and self.limit is not None:
            raise UsageError("--window names the windows already; leave --limit out.")
        if self.weights is not None and len(self.methods) > 1:
            raise UsageError("--weights: belongs to one method; name one --method.")
        if len(self.methods) * len(self.conditions) > len(METHOD_COLOURS):
            raise UsageError(
                f"expected at most {len(METHOD_COLOURS)} predictors (methods times conditions), found"
                f" {len(self.methods) * len(self.conditions)}."
            )


@dataclass(frozen=True)
class FuturesReport:
    """What was drawn."""

    out: Path
    windows: tuple[ShownWindow, ...]


def view_futures(request: FuturesRequest, progress: Progress = lambda *_: None) -> FuturesReport:
    """Draw futures into a picture or a page.

    Raises:
        RedistributionError: if the dataset's licence keeps recorded motion.
        TableError: if the windows cannot be read.
        UsageError: for a window or predictor that there is not, or too much for one picture.
        StorageError: if the file cannot be written.
    """
    is_page = request.out.suffix.lower() == ".html"
    if is_page:
        file_kind(request.out)
    table = WindowsTable.open(request.windows)
    # What was observed stands in every view.
    require_may_pass_on(table.info, "the view", request.permitted)
    fold = next(folds(table, default_split(table)))
    places = _places(table, fold, request)
    rows = len(places) * len(request.methods) * len(request.conditions)
    if not is_page and rows > MOST_ROWS:
        raise UsageError(f"{request.out}: expected at most {MOST_ROWS} rows in one picture, found {rows}.")
    # Windows that are shown are not learnt from, whoever names them.
    train = np.setdiff1d(fold.train, places)
    fans: list[list[Fan]] = [[] for _ in places]
    chosen = itertools.product(request.methods, request.conditions)
    for (method, condition), colour in zip(chosen, METHOD_COLOURS, strict=False):
        row = TableRow(label=method, method=method, condition=condition, variant="", weights=method, tables=())
        predictor = predictor_of(row, table, train, request.weights, device=request.device)
        for number, fan in enumerate(_fans(table, predictor, condition, places, colour, request)):
            fans[number].append(fan)
    shown = []
    for batch, truth in table.batches(_told_most(table), places, frame="room", size=len(places)):
        for number in range(len(batch)):
            shown.append(_window(table, batch, truth, number, tuple(fans[len(shown)]), request))
    windows = shown
    if is_page:
        from prbench_benchmarks.motion_prediction.future_page import write_future_page

        write_future_page(windows, request.out, progress)
    else:
        draw_futures(windows, request.out)
    return FuturesReport(request.out, tuple(windows))


def _places(table: WindowsTable, fold: Fold, request: FuturesRequest) -> np.ndarray:
    """Places of the windows in table order."""
    if not request.window_ids:
        return share_of(table, fold.test, request.limit or 1)
    known = table.windows["window_id"].to_pylist()
    wanted = [find_sequence_id(name, known, among=str(table.folder)) for name in request.window_ids]
    return np.sort([known.index(name) for name in wanted])


def _told_most(table: WindowsTable) -> Condition:
    return Condition.POSE_GAZE if table.info.has_gaze else Condition.POSE


def _fans(
    table: WindowsTable,
    predictor: Predictor,
    condition: Condition,
    places: np.ndarray,
    colour: str,
    request: FuturesRequest,
) -> Sequence[Fan]:
    """The futures of one predictor in each window, in the room."""
    found = []
    frame = load_prediction_protocol().evaluation.frame
    n_samples = samples_of(predictor, request.samples)
    for batch, truth in table.batches(condition, places, frame=frame, size=len(places)):
        futures = ask(predictor, batch, n_samples=n_samples, seed=request.seed)
        in_room = transform_each(truth.room_from_batch, futures.joints)
        label = f"{predictor.name}, {condition.value}"
        for number, joints in enumerate(in_room):
            found.append(Fan(label, colour, joints, _score(futures, truth, number)))
    return found


def _score(futures: Futures, truth: Truth, number: int) -> str:
    n = int(truth.n_scored[number])
    errors = frame_errors(futures.joints[number : number + 1, :, :n], truth.joints[number : number + 1, :n])
    found = displacements(errors)
    return f"ADE {found.ade[0]:.2f} m, FDE {found.fde[0]:.2f} m"


def _window(
    table: WindowsTable,
    batch: ObservedBatch,
    truth: Truth,
    number: int,
    fans: tuple[Fan, ...],
    request: FuturesRequest,
) -> ShownWindow:
    n = int(truth.n_scored[number])
    goal = truth.goal[number]
    n_observed = batch.observed_joints.shape[1]
    nothing = np.zeros(n_observed, dtype=bool)
    return ShownWindow(
        window_id=truth.window_ids[number],
        dataset=table.info.dataset,
        synthetic=table.info.dataset.startswith(SYNTHETIC_PREFIX),
        joint_set=table.joints,
        fps=batch.fps,
        observed=batch.observed_joints[number].astype(np.float64),
        recorded=truth.joints[number, :n].astype(np.float64),
        gaze=np.zeros((n_observed, 3)) if batch.gaze is None else batch.gaze[number].astype(np.float64),
        gaze_valid=nothing if batch.gaze_valid is None else batch.gaze_valid[number],
        goal=goal if np.isfinite(goal).all() else None,
        fans=fans,
        notice=notice(table.info, request.permitted),
    )
