"""Scores a run or a submission on its tables."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path

from prbench.engine import Engine, InProcess
from prbench.errors import RunError, UsageError
from prbench.files.storage import sole_writer
from prbench.harness.methods.installed import name_problem
from prbench.harness.offline.files import read_conditions_file
from prbench.harness.planning import Selection, open_tables, select, supported
from prbench.harness.request import ProgressCallback, silent
from prbench.harness.run_folder import record as run_record
from prbench.harness.run_folder.folder import RunFolder
from prbench.harness.run_folder.predictions import Numbering, Predictions
from prbench.harness.score_predictions.again import score_run
from prbench.harness.score_predictions.complete import Wanted, require_complete, require_lengths
from prbench.harness.score_predictions.request import (
    GivenMotions,
    ScoreReport,
    ScoreRequest,
    Stated,
    stated_by_conditions,
    stated_by_request,
)
from prbench.harness.score_predictions.scored import (
    UNSTATED,
    About,
    Scored,
    Work,
    offline_record,
    predictions_digest,
    write_submission,
)
from prbench.harness.scoring import ScoringRules
from prbench.protocol.own_protocol import protocol_for
from prbench.sequences import SequenceTable
from prbench.shown import clean


def score_predictions(
    request: ScoreRequest,
    *,
    given: GivenMotions | None = None,
    engine: Engine | None = None,
    progress: ProgressCallback = silent,
) -> tuple[ScoreReport, ...]:
    """Score predictions against tables.

    Args:
        request: What to score.
        given: The motions where they are in memory; by default they are read from ``request.predictions``.
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
    tables = open_tables(request.data)
    work = Work(engine or InProcess(), progress)
    run = _run_of(request.predictions) if given is None else None
    with nullcontext() if request.out is None else sole_writer(request.out):
        if run is not None:
            return score_run(run, tables, request, work)
        return _score_submission(tables, request, given, work)


def _score_submission(
    tables: list[SequenceTable], request: ScoreRequest, given: GivenMotions | None, work: Work
) -> tuple[ScoreReport, ...]:
    """Score the motions of a file, or those in memory.

    Raises:
        UsageError: if the request contradicts its conditions file.
        PredictionsError: see :func:`prbench.harness.score_predictions.score_predictions`.
    """
    name = request.name or _name_of(request.predictions)
    protocol = protocol_for(request.protocol, (table.described_protocol for table in tables))
    stated, numbering = _stated(tables, request)
    chosen = [select(table, split=stated.split, limit=stated.limit) for table in tables]
    selections = [_supported(each, stated) for each in chosen]
    predictions = Predictions.open(request.predictions, numbering=numbering) if given is None else given.predictions
    samples = _require_fit(predictions, selections, stated, request)
    rules = ScoringRules(
        protocol.metrics,
        allow_length_mismatch=request.allow_length_mismatch,
        id_seed=stated.seed,
        native_fps=stated.native_fps,
    )
    condition = stated.condition.value if stated.condition else UNSTATED
    about = About(method=name, condition=condition, control=stated.control)
    scored = tuple(
        Scored.of(each, selection, predictions, samples=samples, rules=rules, protocol=protocol, about=about, work=work)
        for each, selection in zip(chosen, selections)
    )
    folders: tuple[Path | None, ...] = (None,) * len(scored)
    if request.out is not None:
        digest = predictions_digest(request.predictions) if given is None else given.digest
        record = offline_record(
            name, stated, scored, package=request.predictions.name, digest=digest, protocol=protocol
        )
        folders = write_submission(request.out, record, scored, protocol)
    origin = f"file {clean(request.predictions.name)}"
    return tuple(ScoreReport(one.scores, one.summary, at, origin, one.agreement) for one, at in zip(scored, folders))


def _stated(tables: list[SequenceTable], request: ScoreRequest) -> tuple[Stated, Numbering | None]:
    """Return what is known of the motions, and what the numbers of numbered files mean."""
    stated = stated_by_request(request)
    numbering = None
    if request.conditions is not None:
        conditions = read_conditions_file(request.conditions)
        stated = stated_by_conditions(conditions, tables, request)
        numbering = Numbering(request.conditions, conditions.opaque_id, tuple(conditions.sample.tolist()))
    if stated.native_fps is not None and request.allow_length_mismatch:
        raise UsageError("--allow-length-mismatch: motions that have to be resampled need the length of --native-fps.")
    return stated, numbering


def _supported(chosen: Selection, stated: Stated) -> Selection:
    selection = supported(chosen, max_frames=stated.max_frames, native_fps=stated.native_fps)
    if not len(selection):
        raise UsageError(
            f"--max-frames {stated.max_frames}: all {len(chosen)} chosen sequences of {chosen.table.info.dataset} are"
            " longer."
        )
    return selection


def _require_fit(
    predictions: Predictions, selections: list[Selection], stated: Stated, request: ScoreRequest
) -> list[int]:
    """The samples, if every sequence has its motions and those have the right lengths as far as is known yet."""
    wanted = Wanted(
        path=request.predictions,
        selections=tuple(selections),
        seed=stated.seed,
        samples=stated.samples,
        native_fps=stated.native_fps,
        conditions=request.conditions,
    )
    samples = require_complete(predictions, wanted)
    if not request.allow_length_mismatch:
        require_lengths(predictions, wanted, samples)
    return samples


def _name_of(path: Path) -> str:
    """Return the name of the file; a folder ``motions`` is named by the one that it stands in.

    Raises:
        UsageError: if the method cannot be called that.
    """
    path = path.absolute()
    name = path.parent.name if path.is_dir() and path.name == "motions" else path.stem
    if problem := name_problem(name):
        raise UsageError(f"{clean(path)}: {problem}. Say what the method is called with --name.")
    return name


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
