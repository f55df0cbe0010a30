"""Tables 1, 2 and 3 of the study of motion prediction (*GazeMoDiff*) on any windows, and what gaze is worth.

The rows stand in ``tables.toml``, the printed numbers, typed again, in ``published``. Windows overlap, so intervals are
over recordings, and rows are compared on the same windows (docs/specification/motion-prediction.md#the-value-of-gaze).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import msgspec
import numpy as np

from prbench.board.collect import run_folders
from prbench.datasets import SYNTHETIC_PREFIX
from prbench.errors import PrbenchError, RunError, UsageError
from prbench.harness.benchmark import load_benchmark
from prbench.harness.clusters import SIGNIFICANCE
from prbench.harness.intervals import ClusteredValues, Comparison, Estimate, clustered, compare, metric_interval
from prbench.harness.methods.loading import load_adapter, require_weights
from prbench.harness.run_folder import read_scores
from prbench.protocol.manifests import read_toml
from prbench.protocol.published import printed_rows
from prbench.sequences.table import by_share
from prbench.shown import quoted
from prbench.tables import DASH, Block, Cell, Column, Row, Table
from prbench_benchmarks.motion_prediction import scoring
from prbench_benchmarks.motion_prediction.batch import Condition, Predictor
from prbench_benchmarks.motion_prediction.benchmark import run_on
from prbench_benchmarks.motion_prediction.metrics import prediction_metrics
from prbench_benchmarks.motion_prediction.predictors import ConstantVelocity, NearestPast, ZeroVelocity
from prbench_benchmarks.motion_prediction.protocol import load_prediction_protocol
from prbench_benchmarks.motion_prediction.scoring import Scores, SimilarPasts
from prbench_benchmarks.motion_prediction.table import WindowsTable

TABLES = ("1", "2", "3")  # Numbers of the study's tables of scores.
PUBLISHED_METRICS = ("ade", "fde", "mmade", "mmfde")  # Ids of the metrics in them, metres, less is better.
PUBLISHED_DATASETS = ("mogaze", "gimo")
_PACKAGE = "prbench_benchmarks.motion_prediction"
_WITHOUT_LEARNING = {each.name: each for each in (ZeroVelocity(), ConstantVelocity())}
# Metrics for which the value of a condition is told; those at the goal exist in anchored windows alone.
_VALUE_METRICS = ("ade", "fde", "ade_mean", "wrist_to_goal", "wrist_to_goal_mean", "pelvis_at_event")
_EVERY = "all"  # Stands for the windows of all anchors.
_NUMBERS = tuple(Column(key=name, title=name.upper(), digits=3) for name in PUBLISHED_METRICS)
_COLUMNS = (Column(key="method", title="Method", text=True), *_NUMBERS)
_VALUE_COLUMNS = (
    *(Column(key=name, title=name, text=True) for name in ("method", "windows", "metric", "told")),
    Column(key="difference", title="difference, m", digits=3),
    Column(key="p", title="p"),
)


class TableRow(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A row of one or several tables.

    Attributes:
        variant: The row's variant among the published numbers; empty for a row that the study does not have.
        weights: Name of the configuration and of the weights; empty for what needs none.
        starts_from: Weights of another row, above this one, that its training starts from.
    """

    label: str
    method: str
    condition: Condition
    variant: str
    weights: str
    tables: tuple[str, ...]
    starts_from: str = ""

    @property
    def name(self) -> str:
        """Unique, and fit to be a file's name."""
        return f"{self.weights or self.method}-{self.condition.value.replace('+', '-')}"

    @property
    def is_ablation(self) -> bool:
        """Stands among the ablations alone: its weights are never those that come with the method."""
        return self.tables == ("3",)


class PredictionTables(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The whole of ``tables.toml``."""

    titles: Mapping[str, str]
    rows: tuple[TableRow, ...]


@cache
def load_tables() -> PredictionTables:
    """Return the rows of Tables 1, 2 and 3 in the printed order, and what stands beside them."""
    return read_toml(_PACKAGE, "tables.toml", PredictionTables)


def published_scores(name: str) -> tuple[dict[str, str], ...]:
    """Read printed numbers in printed order.

    Args:
        name: ``table_1``, ``table_2``, ``table_3``, or ``apd`` for the diversities of the running text.

    Returns:
        ``dataset``, ``method``, ``variant``, ``metric``, ``value`` as printed in metres, and ``note`` of each.
    """
    return printed_rows(f"{_PACKAGE}.published", name)


def prediction_tables(
    windows: Path,
    runs: Sequence[Path] = (),
    *,
    weights: Path | None = None,
    failed: Mapping[str, str] = MappingProxyType({}),
    limit: int | None = None,
    samples: int = 50,
    seed: int = 0,
    device: str = "cpu",
    progress: Callable[[int, int, str], None] = lambda *_: None,
) -> list[Table]:
    """Score every row of the study's tables, and lay them out beside the printed numbers.

    Args:
        windows: Folder of the windows. Those of the study's test split are scored where there is one, else those of the
            dataset's.
        runs: Finished runs on these windows, whose scores stand for their rows; their windows are scored in all others.
        weights: Folder with the user's weights by the row's name, such as ``no-gaze.safetensors``.
        failed: Maps rows that are left out, by name, to the reason, which stands below the tables.
        limit: Largest number of scored windows, of every recording its share.
        samples: K of methods that draw samples.
        seed: Seed that futures are drawn from.
        device: Device that networks run on.
        progress: Called with finished rows, all rows, and the row that comes next.

    Returns:
        The three tables, and what head and gaze are worth where a method stands under several conditions.

    Raises:
        TableError: if the windows cannot be read.
        UsageError: if no window is left to be scored.
        RunError: see :func:`scores_of_runs`.
    """
    if runs and limit is not None:
        raise UsageError("--limit: the runs tell which windows are scored; leave it out.")
    table = WindowsTable.open(windows)
    require_weights(weights)
    column = split_column(table)
    test = table.chosen(**{column: "test"})
    has_training = "train" in set(table.runs[column].to_pylist())
    train = table.chosen(**{column: "train"}) if has_training else np.zeros(0, dtype=np.int64)
    everything = test  # similar pasts are looked for among all windows of the split, whatever the limit
    ids = np.array(table.windows["window_id"].to_pylist())
    scores = scores_of_runs(runs, table)
    if scores:
        test = np.flatnonzero(np.isin(ids, next(iter(scores.values())).columns["window_id"]))
        train = np.setdiff1d(train, test)
        everything = np.union1d(everything, test)
    elif limit is not None:
        recordings = table.runs["recording_id"].take(table.windows["row"].take(test)).to_pylist()
        test = test[np.isin(ids[test], by_share(ids[test].tolist(), recordings)[:limit])]
    similar = SimilarPasts.of(table, everything, closer_than=load_prediction_protocol().evaluation.similar_past)
    rows = load_tables().rows
    missing = dict(failed)
    for done, row in enumerate(rows):
        progress(done, len(rows), row.label)
        if row.name in scores or row.name in missing:
            continue
        if row.method in scoring.references():
            scores[row.name] = scoring.score_reference(scoring.references()[row.method], table, test, similar=similar)
            continue
        try:
            predictor = _predictor(row, table, train, weights, device)
            n_samples = samples
            if row.method in _WITHOUT_LEARNING:
                n_samples = 1
            elif row.method == NearestPast.name:
                n_samples = min(samples, len(train))
            scores[row.name] = scoring.score_predictor(
                predictor, table, row.condition, test, similar=similar, n_samples=n_samples, seed=seed
            )
        except PrbenchError as error:
            missing[row.name] = quoted(error)
    progress(len(rows), len(rows), "tables")
    split = "the study's test split" if column == "published_split" else "the dataset's test split"
    known = next(iter(scores.values())).columns
    part = (
        f"{table.info.dataset}, {table.info.joint_set}: {len(test)} windows of {len(set(known['recording_id']))}"
        f" recordings and {len(set(known['participant_id']))} participants, {split}, K = {samples}"
    )
    tables = [_laid_out(number, table, part, scores, missing, samples) for number in TABLES]
    value = _values_of_conditions(table.info.dataset, scores)
    return [*tables, value] if value.blocks else tables


def split_column(table: WindowsTable) -> str:
    """Return the column of the runs that says what is tested: the study's split where it has a test part."""
    return "published_split" if "test" in set(table.runs["published_split"].to_pylist()) else "split"


def _predictor(row: TableRow, table: WindowsTable, train: np.ndarray, weights: Path | None, device: str) -> Predictor:
    """Return the predictor of a row: without learning, remembered from training windows, or an installed one."""
    if row.method in _WITHOUT_LEARNING:
        return _WITHOUT_LEARNING[row.method]
    if row.method == NearestPast.name:
        if not len(train):
            raise UsageError(f"{row.method}: expected windows of a training split, found none in {table.folder}.")
        return NearestPast().remember(table.batches(row.condition, train))
    if weights is not None and weights.is_dir():
        places = (weights / f"{row.weights}.safetensors", weights / row.weights / "weights.safetensors")
        weights = next((path for path in places if path.is_file()), None)
    if row.is_ablation and weights is None:
        raise UsageError(f"no weights '{row.weights}': train them, and name their folder with --weights.")
    return load_adapter(row.method, weights, {}, device, group=load_benchmark("motion-prediction").methods)


def scores_of_runs(paths: Sequence[Path], table: WindowsTable) -> dict[str, Scores]:
    """Read the scores of runs by the name of the row that each is.

    Args:
        paths: Run folders, or folders that hold some.
        table: The windows that all were made on.

    Raises:
        RunError: for a run of another benchmark or table, one that is not finished, none at all, two of one row, or
            one that no row of the tables is.
    """
    found: dict[str, Scores] = {}
    for path in run_folders(paths):
        run, files = run_on(path, table)
        # Ablations have the method and condition of their whole method, and are known by the name of their weights or
        # of the run's folder.
        asked = (run.record.method.name, run.record.condition)
        known = {Path(run.record.method.weights or "").stem, path.name}
        rows = [row for row in load_tables().rows if (row.method, row.condition) == asked]
        if not rows:
            raise RunError(f"{path}: {asked[0]} under {asked[1]} is no row of the study's tables.")
        named = [row for row in rows if {row.weights, row.name} & known]
        row = (named or [row for row in rows if not row.is_ablation])[0]
        if row.name in found:
            raise RunError(f"{path}: a second run of the row '{row.label}'. Name one of them.")
        found[row.name] = _wide(files.scores, table)
        first = next(iter(found))
        if found[row.name].columns["window_id"] != found[first].columns["window_id"]:
            remedy = "Run both with the same --split and --limit."
            raise RunError(f"the runs of '{first}' and '{row.name}' are of different windows. {remedy}")
    return found


def _wide(path: Path, table: WindowsTable) -> Scores:
    """One row a window in table order, a column a metric; NaN where a window has no value."""
    long = read_scores(path)
    windows, of_row = np.unique(long["sequence_id"].to_numpy(), return_inverse=True)
    place = {name: number for number, name in enumerate(table.windows["window_id"].to_pylist())}
    order = np.argsort([place[name] for name in windows])
    rank = np.argsort(order)
    rows = table.windows.take([place[name] for name in windows[order]])
    about = table.runs.take(rows["row"])
    columns: dict[str, object] = {"window_id": windows[order].tolist(), "anchor": rows["anchor"].to_pylist()}
    columns |= {name: about[name].to_pylist() for name in ("recording_id", "participant_id", "segment")}
    metric = long["metric"].to_numpy()
    for name in dict.fromkeys(metric.tolist()):
        values = np.full(len(windows), np.nan)
        values[rank[of_row[metric == name]]] = long["value"].to_numpy()[metric == name]
        columns[str(name)] = values
    scores = Scores()
    scores.add(columns)
    return scores


def estimates(scores: Scores) -> dict[str, Estimate]:
    """Return the mean over windows of every score with its interval; scores that no window has are left out."""
    recordings = np.array(scores.columns["recording_id"])
    found = {}
    for info in prediction_metrics():
        values = scores.metrics.get(info.id, np.zeros(0))
        known = np.isfinite(values)
        if known.any():
            found[info.id] = metric_interval(info, values[known], recordings[known])
    return found


def paired(first: Scores, second: Scores, metric: str, *, anchor: str = _EVERY) -> ClusteredValues | None:
    """Return differences of a score of two predictors, or of one under two conditions; None where no window has it.

    Args:
        first: Scores of some windows.
        second: Scores of the same windows.
        metric: Id of the score.
        anchor: Only windows of this anchor.

    Raises:
        UsageError: if they are of different windows.
    """
    if first.columns["window_id"] != second.columns["window_id"]:
        raise UsageError("expected scores of the same windows, found others. Score both on one choice of one table.")
    ours = first.metrics.get(metric)
    others = second.metrics.get(metric)
    if ours is None or others is None:
        return None
    known = np.isfinite(ours) & np.isfinite(others)
    if anchor != _EVERY:
        known &= np.array(first.columns["anchor"]) == anchor
    recordings = np.array(first.columns["recording_id"])
    return clustered(ours[known] - others[known], recordings[known]) if known.any() else None


def _of_row(row: TableRow) -> dict[str, Any]:
    return {"condition": row.condition.value, "method": row.method, "variant": row.variant}


def _measured(each: Estimate) -> dict[str, Any]:
    counts = {"sequences": each.n_sequences, "recordings": each.n_recordings}
    return {"value": each.mean, "low": each.low, "high": each.high, **counts}


def _laid_out(
    number: str, table: WindowsTable, part: str, scores: Mapping[str, Scores], missing: Mapping[str, str], samples: int
) -> Table:
    """One table of the study: measured rows, printed ones of each dataset, the order of the methods, and notes."""
    rows = [row for row in load_tables().rows if number in row.tables]
    measured = {row.name: estimates(scores[row.name]) for row in rows if row.name in scores}
    units = {info.id: info.unit for info in prediction_metrics()}
    lines = []
    for row in rows:
        about = {"dataset": table.info.dataset, **_of_row(row)}
        found = measured.get(row.name, {}).items()
        cells = (Cell(metric=metric, unit=units[metric], **about, **_measured(each)) for metric, each in found)
        lines.append(Row(text={"method": row.label}, cells=tuple(cells)))
    blocks = [Block(title="measured", rows=tuple(lines))]
    notes = []
    # Methods from the smallest ADE on, each compared with the next one; references are no methods.
    methods = [row for row in rows if row.name in measured and row.method not in scoring.references()]
    methods.sort(key=lambda row: measured[row.name]["ade"].mean)
    pairs = itertools.pairwise(methods)
    steps = {worse: paired(scores[worse.name], scores[better.name], "ade") for better, worse in pairs}
    compared = compare({row.name: pair for row, pair in steps.items() if pair is not None})
    if steps:
        said = [methods[0].label]
        for row in steps:
            p_value = compared[row.name].adjusted_p_value
            doubt = "" if p_value is not None and p_value <= SIGNIFICANCE else ", not supported by the data"
            apart = compared[row.name].difference
            interval = "" if apart.low is None else f" [{apart.low:+.3f}, {apart.high:+.3f}]"
            said.append(f"{row.label} ({apart.mean:+.3f}{interval}{doubt})")
        notes.append(f"By ADE: {' < '.join(said)}")
    layout = table.info.dataset.removeprefix(SYNTHETIC_PREFIX)
    for dataset in (layout,) if layout in PUBLISHED_DATASETS else PUBLISHED_DATASETS:
        printed = []
        for row in rows:
            key = (dataset, row.method, row.variant)
            scored = published_scores(f"table_{number}")
            found = [each for each in scored if (each["dataset"], each["method"], each["variant"]) == key]
            of_row: dict[str, Any] = _of_row(row) | {"unit": "m", "origin": f"published: GazeMoDiff, Table {number}"}
            cells = []
            for each in found:
                of_row |= {name: each[name] for name in ("dataset", "metric", "note")}
                cells.append(Cell(value=float(each["value"]), **of_row))
            if found:
                text = {"method": row.label} | {each["metric"]: each["value"] for each in found}
                printed.append(Row(text=text, cells=tuple(cells)))
            odd = dict.fromkeys(each["note"] for each in found if each["note"])
            notes += [f"{row.label}, printed for {dataset}: {note}" for note in odd]
        blocks.append(Block(title=f"printed for {dataset}", rows=tuple(printed)))
    smaller = [n for n in load_prediction_protocol().evaluation.samples if n < samples]
    for row in rows:
        if row.name in missing:
            notes.append(f"{row.label}: {missing[row.name]}")
        one_design = row.name in measured and not any(f"ade@k{n}" in measured[row.name] for n in smaller)
        if smaller and one_design and row.method not in _WITHOUT_LEARNING:
            notes.append(
                f"{row.label}: its {samples} samples are one design, of which fewer are no part, so it has no scores of"
                " fewer."
            )
        learnt = row in methods and row.method not in _WITHOUT_LEARNING
        if learnt and samples > 1 and measured[row.name]["apd"].mean == 0:
            alone = f"its errors are those of one guess, not the best of {samples}"
            notes.append(f"{row.label}: it has one future: {alone}.")
    notes += _notes(table)
    about = {"title": load_tables().titles[number], "dataset": table.info.dataset, "part": part}
    return Table(number=number, columns=_COLUMNS, blocks=tuple(blocks), notes=tuple(notes), **about)


def _notes(table: WindowsTable) -> list[str]:
    n_joints = len(table.joints.names)
    notes = [
        "Metres over the flattened pose; 95 % intervals over recordings in brackets. Less is better.",
        f"A distance over {n_joints} joints is √{n_joints} = {np.sqrt(n_joints):.2f} times a joint's root mean square;"
        " compare other joint sets after dividing by that (MoGaze's study has 21 joints, GIMO's 23).",
    ]
    if table.info.dataset not in PUBLISHED_DATASETS:
        notes.append(
            "The printed numbers are of other recordings: they show the study's order, and are not to be compared."
        )
    if table.info.estimated_bodies:
        notes.append(
            "The bodies were estimated from whole tracks of the head: the numbers are agreement with an estimate, and"
            " never enter one mean with captured bodies."
        )
    return [*notes, "Ground truth and truncation floor know the future; they are no methods and are not ranked."]


def _values_of_conditions(dataset: str, scores: Mapping[str, Scores]) -> Table:
    """Compare every pair of conditions of each method, over all windows and for each anchor.

    A difference is that of the condition that tells more minus that which tells less, metres: below zero where the
    further knowledge helps. P-values are corrected for all methods and pairs of conditions of one metric and anchor.
    """
    # Parts that are removed are no condition.
    by_method: dict[str, dict[Condition, Scores]] = {}
    for row in load_tables().rows:
        if row.name in scores and not row.is_ablation and row.method not in scoring.references():
            by_method.setdefault(row.method, {})[row.condition] = scores[row.name]
    pairs: dict[tuple[str, str, str, Condition, Condition], ClusteredValues] = {}
    for method, found in by_method.items():
        for less, more in itertools.combinations([each for each in Condition if each in found], 2):
            anchors = sorted(set(found[less].columns["anchor"]))
            for anchor in [_EVERY, *anchors] if len(anchors) > 1 else [_EVERY]:
                for metric in _VALUE_METRICS:
                    pair = paired(found[more], found[less], metric, anchor=anchor)
                    if pair is not None:
                        pairs[method, anchor, metric, less, more] = pair
    compared: dict[tuple, Comparison] = {}
    for family in dict.fromkeys(key[1:3] for key in pairs):
        compared |= compare({key: pair for key, pair in pairs.items() if key[1:3] == family})
    rows = []
    for (method, anchor, metric, less, more), each in compared.items():
        step = f"{less.value} → {more.value}"
        p_value = DASH if each.adjusted_p_value is None else f"{each.adjusted_p_value:.3f}"
        about: dict[str, Any] = {"dataset": dataset, "unit": "m", "condition": step, "method": method}
        about |= {"variant": f"{metric}, windows: {anchor}", "note": f"p = {p_value}"}
        cell = Cell(metric="difference", **about, **_measured(each.difference))
        text = {"method": method, "windows": anchor, "metric": metric, "told": step, "p": p_value}
        rows.append(Row(text=text, cells=(cell,)))
    title = "What the head and gaze are worth"
    blocks = (Block(rows=tuple(rows), signed=True),)
    return Table(title=title, columns=_VALUE_COLUMNS, dataset=dataset, blocks=blocks)
