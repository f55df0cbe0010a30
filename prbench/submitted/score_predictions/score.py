"""From a run or a submission and tables to scores."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path

from prbench.engine import Engine, InProcess
from prbench.errors import RunError
from prbench.evaluation.progress import ProgressCallback, silent
from prbench.locks import sole_writer
from prbench.runs import record as run_record
from prbench.runs.folder import RunFolder
from prbench.submitted.offline.export import open_tables
from prbench.submitted.score_predictions.again import score_run
from prbench.submitted.score_predictions.request import ScoreReport, ScoreRequest
from prbench.submitted.score_predictions.scored import Work
from prbench.submitted.score_predictions.submission import score_submission


def score_predictions(
    request: ScoreRequest,
    *,
    engine: Engine | None = None,
    progress: ProgressCallback = silent,
) -> tuple[ScoreReport, ...]:
    """Score predictions against tables.

    Args:
        request: What to score.
        engine: Where the work is done; changes no value.
        progress: Called after every scored window.

    Returns:
        One report a table, in the order of the tables.

    Raises:
        PredictionsError: if sequences are missing, repeated or unknown (named), or a motion has a wrong shape, another
            length than the recorded one, or NaN; or if the conditions file is not of these tables.
        RunError: if a run folder belongs to another table.
        TableError: if a table is missing, empty or of an unknown version.
        UsageError: if the request contradicts its conditions file.
        StorageError: if the results cannot be written.
    """
    tables, work = open_tables(request.data), Work(engine or InProcess(), progress)
    run = _run_of(request.predictions)
    with nullcontext() if request.out is None else sole_writer(request.out):
        return score_submission(tables, request, work) if run is None else score_run(run, tables, request, work)


def _run_of(path: Path) -> RunFolder | None:
    """The run that a path belongs to: its folder, its part for a dataset, or the predictions in there.

    Raises:
        RunError: if the folder holds the scores of a submission, without motions.
    """
    for base in (path, path.parent, path.parent.parent):
        if not (base / run_record.FILE_NAME).is_file():
            continue
        run = RunFolder.open(base)
        parts = [run.dataset(table.dataset) for table in run.record.tables]
        if path == base or any(path in (part.path, part.predictions) for part in parts):
            if run.record.method.kind == run_record.FILE:
                raise RunError(
                    f"{base}: holds the scores of {run.record.method.package}, not its motions. Score that file again."
                )
            return run
    return None
