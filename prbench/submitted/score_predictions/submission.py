"""Score motions that came as a file, of all tables together."""

from __future__ import annotations

from pathlib import Path

from prbench.errors import UsageError
from prbench.evaluation.planning import Selection, select
from prbench.evaluation.preparation import supported
from prbench.evaluation.scoring import ScoringRules
from prbench.manifests import load_protocol
from prbench.methods.names import name_problem
from prbench.runs.predictions import Numbering, Predictions
from prbench.sequences import SequenceTable
from prbench.shown import clean
from prbench.submitted.offline.read import read_conditions_file
from prbench.submitted.score_predictions.board import UNSTATED, offline_record, write_submission
from prbench.submitted.score_predictions.complete import Wanted, require_complete, require_lengths
from prbench.submitted.score_predictions.request import ScoreReport, ScoreRequest
from prbench.submitted.score_predictions.scored import About, Scored, Work
from prbench.submitted.score_predictions.stated import Stated, stated_by_conditions, stated_by_request


def score_submission(tables: list[SequenceTable], request: ScoreRequest, work: Work) -> tuple[ScoreReport, ...]:
    """Score the motions of a file.

    Raises:
        UsageError: if the request contradicts its conditions file.
        PredictionsError: see :func:`prbench.submitted.score_predictions.score_predictions`.
    """
    name = request.name or _name_of(request.predictions)
    stated, numbering = _stated(tables, request)
    chosen = [select(table, split=stated.split, limit=stated.limit) for table in tables]
    selections = [_supported(each, stated) for each in chosen]
    predictions = Predictions.open(request.predictions, numbering=numbering)
    samples = _require_fit(predictions, selections, stated, request)
    rules = ScoringRules(
        load_protocol().metrics,
        allow_length_mismatch=request.allow_length_mismatch,
        id_seed=stated.seed,
        native_fps=stated.native_fps,
    )
    condition = stated.condition.value if stated.condition else UNSTATED
    about = About(method=name, condition=condition, control=stated.control)
    scored = tuple(
        Scored.of(each, selection, predictions, samples=samples, rules=rules, about=about, work=work)
        for each, selection in zip(chosen, selections)
    )
    folders: tuple[Path | None, ...] = (None,) * len(scored)
    if request.out is not None:
        folders = write_submission(request.out, offline_record(request.predictions, name, stated, scored), scored)
    origin = f"file {clean(request.predictions.name)}"
    return tuple(ScoreReport(one.scores, one.summary, at, origin) for one, at in zip(scored, folders))


def _stated(tables: list[SequenceTable], request: ScoreRequest) -> tuple[Stated, Numbering | None]:
    """What is known of the motions, and what the numbers of numbered files mean."""
    stated, numbering = stated_by_request(request), None
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
    """Of the file; a folder ``motions`` is named by the one that it stands in.

    Raises:
        UsageError: if the method cannot be called that.
    """
    path = path.absolute()
    name = path.parent.name if path.is_dir() and path.name == "motions" else path.stem
    if problem := name_problem(name):
        raise UsageError(f"{clean(path)}: {problem}. Say what the method is called with --name.")
    return name
