"""Score every row of the study's tables on one table of windows, and write the tables and charts.

Scores of a row are kept, so that the same command goes on where it stopped.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

import prbench
from prbench.errors import PrbenchError, UsageError
from prbench.files.storage import atomic_path, sole_writer, text_digest, turn_into_paths, write_json, write_text
from prbench.harness.methods.loading import weights_digest
from prbench.sequences.schema import open_parquet
from prbench.shown import quoted
from prbench_benchmarks.motion_prediction.batch import Condition
from prbench_benchmarks.motion_prediction.charts import draw_chart
from prbench_benchmarks.motion_prediction.folds import Fold, SplitChoice, default_split, folds, share_of
from prbench_benchmarks.motion_prediction.protocol import load_prediction_protocol
from prbench_benchmarks.motion_prediction.published_numbers import TableRow, load_tables
from prbench_benchmarks.motion_prediction.references import references, score_reference
from prbench_benchmarks.motion_prediction.scoring import Scores, SimilarPasts, score_predictor
from prbench_benchmarks.motion_prediction.table import WindowsTable
from prbench_benchmarks.motion_prediction.tables.as_markdown import as_builtins, as_markdown
from prbench_benchmarks.motion_prediction.tables.charts import horizon_panels, value_panels
from prbench_benchmarks.motion_prediction.tables.from_runs import scores_of_runs
from prbench_benchmarks.motion_prediction.tables.gaze_value import ValueOfCondition, values_of_conditions
from prbench_benchmarks.motion_prediction.tables.layout import PredictionLayout, lay_out
from prbench_benchmarks.motion_prediction.tables.predictors import predictor_of, samples_of, weights_of

MARKDOWN = "tables.md"
JSON = "tables.json"
HORIZONS = "horizons.png"
VALUE = "value_of_gaze.png"
_DIGEST = b"prbench_settings"
_SPLITS = {
    "published": "the study's test split",
    "dataset": "the dataset's test split",
    "participants": "each participant left out once",
}
Progress = Callable[[int, int, str], None]
"""Called with finished rows, all rows, and the row that comes next."""


@dataclass(frozen=True, kw_only=True)
class TablesRequest:
    """What a user asks for.

    Raises:
        UsageError: for less than one sample or window.
    """

    windows: Path
    out: Path
    split: SplitChoice | None = None
    """None for the study's where the table has one, else the dataset's."""
    samples: int = 50
    limit: int | None = None
    """Largest number of scored windows, of every recording its share; None for all."""
    weights: Path | None = None
    """Folder with the user's weights by name."""
    runs: tuple[Path, ...] = ()
    """Finished runs on these windows, whose scores stand for their rows; their windows are scored in all other rows."""
    seed: int = 0
    device: str = "cpu"

    def __post_init__(self) -> None:
        turn_into_paths(self, "windows", "out", "weights", "runs")
        if self.samples < 1:
            raise UsageError(f"--samples: expected one or more, found {self.samples}.")
        if self.runs and (self.split is not None or self.limit is not None):
            raise UsageError("--runs: the runs tell which windows are scored; leave --split and --limit out.")
        if self.limit is not None and self.limit < 1:
            raise UsageError(f"--limit: expected one or more, found {self.limit}.")


@dataclass(frozen=True)
class TablesReport:
    """The result."""

    folder: Path
    layout: PredictionLayout
    values: tuple[ValueOfCondition, ...]
    scored: tuple[str, ...]
    """Rows that were scored now; the others were there, or are missing."""
    charts: tuple[Path, ...]


def run_tables(request: TablesRequest, progress: Progress = lambda *_: None) -> TablesReport:
    """Score what is missing, and write tables, numbers and charts into the folder.

    Raises:
        TableError: if the windows cannot be read.
        UsageError: if no window is left to be scored.
        StorageError: if the folder cannot be written.
    """
    table = WindowsTable.open(request.windows)
    split = request.split or default_split(table)
    whole = list(folds(table, split))
    scores = scores_of_runs(request.runs, table) if request.runs else {}
    parts = _of_runs(whole, table, scores) if scores else _limited(table, whole, request.limit)
    # Similar pasts are looked for among all windows of the split, whatever the limit.
    everything = np.unique(np.concatenate([*(fold.test for fold in whole), *(fold.test for fold in parts)]))
    work = _Work(request, table, split, parts)
    rows = load_tables().rows
    missing: dict[str, str] = {}
    scored = []
    with sole_writer(request.out):
        for done, row in enumerate(rows):
            progress(done, len(rows), row.label)
            if row.name in scores:
                continue
            found = work.kept(row)
            if found is None:
                try:
                    found = work.score(row, everything)
                except PrbenchError as error:
                    missing[row.name] = quoted(error)
                    continue
                scored.append(row.name)
            scores[row.name] = found
        progress(len(rows), len(rows), "tables")
        layout = lay_out(table.info, len(table.joints.names), _SPLITS[split], request.samples, scores, missing)
        # Scores of each method that stands in the tables under several conditions; parts removed are no condition.
        found: dict[str, dict[Condition, Scores]] = {}
        for row in rows:
            if row.name in scores and not row.is_ablation and row.method not in references():
                found.setdefault(row.method, {})[row.condition] = scores[row.name]
        values = values_of_conditions({method: each for method, each in found.items() if len(each) > 1})
        write_text(request.out / MARKDOWN, as_markdown(layout, values))
        write_json(request.out / JSON, as_builtins(layout, values))
        charts = []
        for name, panels in ((HORIZONS, horizon_panels(rows, scores)), (VALUE, value_panels(values))):
            if any(any(panel.lines.values()) for panel in panels):
                draw_chart(panels, request.out / name, note=_note(layout))
                charts.append(request.out / name)
    return TablesReport(request.out, layout, values, tuple(scored), tuple(charts))


def _note(layout: PredictionLayout) -> str:
    estimated = " Bodies estimated from later head motion." if layout.estimated_bodies else ""
    return (
        f"{layout.dataset}: {layout.n_windows} windows of {layout.n_recordings} recordings, {layout.split}. Bars: 95 %"
        f" intervals over recordings.{estimated}"
    )


def _of_runs(whole: list[Fold], table: WindowsTable, scores: Mapping[str, Scores]) -> list[Fold]:
    """The windows that runs were made on; none of them is learnt from."""
    named = set(next(iter(scores.values())).columns["window_id"])
    test = np.flatnonzero([name in named for name in table.windows["window_id"].to_pylist()])
    return [Fold("", np.setdiff1d(whole[0].train, test), test)]


def _limited(table: WindowsTable, parts: list[Fold], limit: int | None) -> list[Fold]:
    """At most so many windows for testing in all."""
    kept = share_of(table, np.sort(np.concatenate([fold.test for fold in parts])), limit)
    found = [replace(fold, test=np.intersect1d(fold.test, kept)) for fold in parts]
    return [fold for fold in found if len(fold.test)]


class _Work:
    """Scores rows, and keeps the scores of each beside what they depend on."""

    def __init__(self, request: TablesRequest, table: WindowsTable, split: SplitChoice, parts: list[Fold]) -> None:
        self._request = request
        self._table = table
        self._parts = parts
        self._similar: SimilarPasts | None = None
        self._settings = (
            prbench.__version__,
            load_prediction_protocol().digest,
            table.info.content_digest,
            split,
            str(request.limit),
            str(request.samples),
            str(request.seed),
            *(str(name) for fold in parts for name in fold.test.tolist()),
        )
        self._window_ids = table.windows.take(np.sort(np.concatenate([fold.test for fold in parts])))[
            "window_id"
        ].to_pylist()

    def kept(self, row: TableRow) -> Scores | None:
        """Scores of an earlier call with the same settings; None if there are none."""
        path = self._path(row)
        if not path.is_file():
            return None
        found = open_parquet(path).read()
        if (found.schema.metadata or {}).get(_DIGEST) != self._digest(row).encode():
            return None
        return Scores.of(found)

    def score(self, row: TableRow, everything: np.ndarray) -> Scores:
        """Score a row, and keep its scores."""
        similar = self._similar_pasts(everything)
        known = references()
        scores = Scores()
        for fold in self._parts:
            if row.method in known:
                part = score_reference(known[row.method], self._table, fold.test, similar=similar)
            else:
                part = self._predicted(row, fold, similar)
            scores.add(part.columns)
        scores = scores.in_order(self._window_ids)
        scored = scores.table()
        path = self._path(row)
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(path) as draft:
            pq.write_table(scored.replace_schema_metadata({_DIGEST: self._digest(row).encode()}), draft)
        return scores

    def _predicted(self, row: TableRow, fold: Fold, similar: SimilarPasts) -> Scores:
        request = self._request
        predictor = predictor_of(row, self._table, fold.train, request.weights, device=request.device)
        return score_predictor(
            predictor,
            self._table,
            row.condition,
            fold.test,
            similar=similar,
            n_samples=samples_of(predictor, request.samples),
            seed=request.seed,
        )

    def _similar_pasts(self, everything: np.ndarray) -> SimilarPasts:
        if self._similar is None:
            closer_than = load_prediction_protocol().evaluation.similar_past
            self._similar = SimilarPasts.of(self._table, everything, closer_than=closer_than)
        return self._similar

    def _path(self, row: TableRow) -> Path:
        return self._request.out / "scores" / f"{row.name}.parquet"

    def _digest(self, row: TableRow) -> str:
        try:
            weights = weights_digest(weights_of(row, self._request.weights))
        except UsageError:
            weights = None  # the row says why when it is to be scored
        return text_digest(*self._settings, row.name, weights or "")
