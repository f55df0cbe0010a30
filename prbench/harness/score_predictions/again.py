"""Score a run again, on the tables that it was made on."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from prbench.errors import UsageError
from prbench.harness.again import require_same_table
from prbench.harness.conditions import ConditionSource, derangement
from prbench.harness.controls import RECORDED_MOTION, SHUFFLED_GOAL
from prbench.harness.planning import Selection, select, supported
from prbench.harness.run_folder import record as run_record
from prbench.harness.run_folder.folder import RunFolder
from prbench.harness.run_folder.predictions import Predictions
from prbench.harness.run_folder.record import RunRecord
from prbench.harness.score_predictions.complete import Wanted, require_complete
from prbench.harness.score_predictions.request import ScoreReport, ScoreRequest
from prbench.harness.score_predictions.scored import About, Scored, Work, write_plain
from prbench.harness.scoring import ScoringRules
from prbench.protocol.manifests import BenchmarkProtocol
from prbench.protocol.own_protocol import FILE_NAME, protocol_for
from prbench.sequences import SequenceTable

_STATED_BY_THE_RUN = ("conditions", "condition", "control", "seed", "max_frames", "native_fps", "name")


def score_run(
    run: RunFolder, tables: list[SequenceTable], request: ScoreRequest, work: Work
) -> tuple[ScoreReport, ...]:
    """Score the motions of a run.

    Raises:
        UsageError: if the request says what the run itself says.
        RunError: if it is of another table.
        PredictionsError: if motions are missing.
    """
    _require_plain(request)
    # A run of an earlier version of prbench's own protocol is scored by today's.
    protocol = protocol_for(_protocol_file(run, request), (table.described_protocol for table in tables))
    scored = tuple(_scored(run, table, request, work, protocol) for table in tables)
    folders = (None,) * len(scored) if request.out is None else write_plain(request.out, scored, protocol)
    method = run.record.method
    return tuple(
        ScoreReport(one.scores, one.summary, at, method.origin, one.agreement, method.motionless)
        for one, at in zip(scored, folders)
    )


def scored_sequences(run: RunFolder, table: SequenceTable) -> Selection:
    """The sequences that a run was scored on.

    Raises:
        RunError: if it is of another table.
    """
    require_same_table(run, table)
    return _selections(ScoreRequest(predictions=run.path, data=(table.folder,)), run.record, table)[1]


def _protocol_file(run: RunFolder, request: ScoreRequest) -> Path | None:
    """File of the user's own protocol: the one asked for, else the run's; None for prbench's."""
    if request.protocol is not None:
        return request.protocol
    followed = run.protocol
    return run.path / FILE_NAME if followed is not None and followed.is_own else None


def _scored(
    run: RunFolder, table: SequenceTable, request: ScoreRequest, work: Work, protocol: BenchmarkProtocol
) -> Scored:
    require_same_table(run, table)
    chosen, selection = _selections(request, run.record, table)
    predictions = Predictions.open(run.dataset(table.info.dataset).predictions)
    wanted = Wanted(
        path=request.predictions,
        selections=(selection,),
        seed=run.record.seed,
        samples=None,
        native_fps=None,
        conditions=None,
    )
    samples = require_complete(predictions, wanted)
    rules = _rules(request, run.record, selection, protocol)
    record = run.record
    about = About(
        method=record.method.name,
        condition=record.condition,
        control=record.control,
        obstacles=record.method.wants_obstacles,
    )
    return Scored.of(
        chosen, selection, predictions, samples=samples, rules=rules, protocol=protocol, about=about, work=work
    )


def _require_plain(request: ScoreRequest) -> None:
    """A run says itself how its motions were made."""
    for name in _STATED_BY_THE_RUN:
        if getattr(request, name) is not None:
            raise UsageError(
                f"--{name.replace('_', '-')}: {request.predictions} is a run, whose run.json says how its motions were"
                " made. Leave the option out."
            )


def _selections(request: ScoreRequest, record: RunRecord, table: SequenceTable) -> tuple[Selection, Selection]:
    """The chosen sequences, and those of them that have to be there."""
    limit = record.limit if request.limit is None else request.limit
    chosen = select(table, split=request.split or record.split, limit=limit)
    if record.sequences and request.limit is None:
        chosen = chosen.chosen(np.isin(chosen.sequence_ids, record.sequences))
    return chosen, supported(chosen, max_frames=record.method.max_frames, native_fps=record.method.native_fps)


def _rules(request: ScoreRequest, record: RunRecord, selection: Selection, protocol: BenchmarkProtocol) -> ScoringRules:
    recorded_motion = record.method.kind == run_record.CONTROL and record.method.name in RECORDED_MOTION
    other_goals = None
    if recorded_motion and record.control == SHUFFLED_GOAL:
        order = derangement(selection, seed=record.seed)
        other_goals = ConditionSource.read(selection).goal_location[order]
    return ScoringRules(
        protocol.metrics,
        recorded_motion=recorded_motion,
        other_goals=other_goals,
        run_of=record.method.name,
        allow_length_mismatch=request.allow_length_mismatch,
    )
