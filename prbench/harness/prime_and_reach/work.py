"""The work of a run of prime-and-reach on the sequences of one table: batches, scores, and what stands beside them."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np
import pyarrow as pa
from jaxtyping import Float, Int

from prbench.contract import Condition
from prbench.engine import Engine
from prbench.harness.agreement import agreement_with_people, require_agreement
from prbench.harness.benchmark import CaseWork
from prbench.harness.best_of import ChoiceRules
from prbench.harness.carry_on import Carrying, measure_carried
from prbench.harness.conditions import ConditionSource, ConditionStream, derangement, run_salt
from prbench.harness.controls import (
    HOLDS_RECORDINGS,
    NEAREST_NEIGHBOUR,
    RECORDED_MOTION,
    SHUFFLED_GOAL,
    control_motions,
)
from prbench.harness.planning import Selection, plan_batches
from prbench.harness.prime_and_reach.question import MotionQuestion
from prbench.harness.request import RunRequest
from prbench.harness.run_folder.carry_on import write_carried_on
from prbench.harness.run_folder.coded_scores import CodedScores
from prbench.harness.run_folder.folder import DatasetFolder
from prbench.harness.run_folder.predictions import Predictions
from prbench.harness.run_folder.record import MethodRecord
from prbench.harness.scoring import ScoringRules, score_selection
from prbench.protocol.manifests import BenchmarkProtocol


class MotionWork(CaseWork):
    """See :class:`prbench.harness.benchmark.CaseWork`."""

    def __init__(
        self,
        request: RunRequest,
        selection: Selection,
        *,
        method: MethodRecord,
        condition: Condition,
        protocol: BenchmarkProtocol,
    ) -> None:
        self._request = request
        self._selection = selection
        self._method = method
        self._condition = condition
        self._protocol = protocol
        self._source: ConditionSource | ConditionStream = ConditionStream(selection, obstacles=method.wants_obstacles)
        self._scored_goals: Float[np.ndarray, "n 3"] | None = None
        self._carrying = Carrying.of(selection) if request.carry_on else None
        # These put conditions of sequences together that lie anywhere in the table.
        if request.control == SHUFFLED_GOAL or request.carry_on or request.method == NEAREST_NEIGHBOUR:
            whole = ConditionSource.read(selection, obstacles=method.wants_obstacles)
            if request.control == SHUFFLED_GOAL:
                whole = whole.with_goals_of(derangement(selection, seed=request.seed))
                if request.method in RECORDED_MOTION:
                    self._scored_goals = whole.goal_location
            self._source = whole

    @property
    def holds_recordings(self) -> bool:
        """See :attr:`CaseWork.holds_recordings`."""
        return self._request.method in HOLDS_RECORDINGS

    @property
    def plan(self) -> list[Int[np.ndarray, "_"]]:
        """Batches of similar length; where puts carry on, those of the picks come first."""
        return self._plan

    @cached_property
    def _plan(self) -> list[Int[np.ndarray, "_"]]:
        if self._carrying is None:
            return plan_batches(self._selection.n_frames, self._request.batch_size)
        return [batch for half in self._halves for batch in half]

    @cached_property
    def _halves(self) -> tuple[list[Int[np.ndarray, "_"]], ...]:
        """The batches of picks, and those of puts: a put cannot start before its pick has ended."""
        assert self._carrying is not None
        return tuple(self._plan_of(np.sort(rows)) for rows in (self._carrying.picks, self._carrying.puts))

    def _plan_of(self, rows: Int[np.ndarray, " rows"]) -> list[Int[np.ndarray, "_"]]:
        """Plan the batches of some sequences."""
        return [rows[batch] for batch in plan_batches(self._selection.n_frames[rows], self._request.batch_size)]

    def round_of(self, batch: int) -> int:
        """1 for a batch of puts that start where generated picks end."""
        return int(self._carrying is not None and batch >= len(self._halves[0]))

    def questions(self, wanted: frozenset[int], files: DatasetFolder) -> Iterator[tuple[int, MotionQuestion]]:
        """See :meth:`CaseWork.questions`."""
        request = self._request
        salt = run_salt(request.seed, self._selection.table.identity)
        given = None
        if request.is_control:
            given = control_motions(request.method, self._selection, self._source, self.plan)
        carried: list[tuple[ConditionSource, np.ndarray]] = []
        if any(map(self.round_of, wanted)):
            carried = [self._carried(files, sample) for sample in range(request.samples)]
        for index, rows in enumerate(self.plan):
            # Controls come in order: those of finished batches are made and passed over.
            motions = next(given) if given is not None else None
            if index not in wanted:
                continue
            source, places = self._source.around(rows)
            sources = [source for source, _ in carried] or [source] * request.samples
            first = [one.batch(places, self._condition, seed=request.seed, salt=salt, sample=0) for one in sources]
            yield (
                index,
                MotionQuestion(
                    # Motions of one sample are consecutive draws, so that one of one is the sample itself.
                    conditions=tuple(
                        source.redrawn(first[draw // request.best_of], places, seed=request.seed, sample=draw)
                        for draw in range(request.samples * request.best_of)
                    ),
                    choice=ChoiceRules.of(
                        self._protocol, best_of=request.best_of, head_tilt_deg=source.head_tilt_deg[places]
                    ),
                    given=motions,
                    placements=tuple(placements[rows] for _, placements in carried),
                ),
            )

    def _carried(self, files: DatasetFolder, sample: int) -> tuple[ConditionSource, np.ndarray]:
        assert self._carrying is not None
        assert isinstance(self._source, ConditionSource), "a put needs its pick"
        predictions = Predictions.open(files.predictions)
        predictions.make_ready()
        return self._carrying.source(self._source, predictions, sample)

    def scores(self, files: DatasetFolder, engine: Engine) -> Iterator[pa.Table]:
        """See :meth:`CaseWork.scores`."""
        rules = ScoringRules(
            self._protocol.metrics,
            recorded_motion=self._request.method in RECORDED_MOTION,
            other_goals=self._scored_goals,
            run_of=self._method.name,
        )
        samples = range(self._request.samples)
        yield from score_selection(self._selection, files.predictions, samples=samples, rules=rules, engine=engine)

    def write_beside(self, files: DatasetFolder, scores: CodedScores) -> None:
        """Write the agreement with recorded people and, where puts carry on, the seams."""
        agreement_with_people(self._selection, scores, protocol=self._protocol).write(files.path)
        self._write_carried(files, scores)

    def require_beside(self, files: DatasetFolder, scores: CodedScores) -> None:
        """Compare the agreement with what follows from the scores; written anew where an earlier version wrote none."""
        agreement = agreement_with_people(self._selection, scores, protocol=self._protocol)
        require_agreement(files, agreement)
        if not files.agreement.is_file():
            agreement.write(files.path)
        self._write_carried(files, scores)

    def _write_carried(self, files: DatasetFolder, scores: CodedScores) -> None:
        if self._carrying is not None:
            samples = range(self._request.samples)
            found = measure_carried(self._selection, files.predictions, scores, samples=samples)
            write_carried_on(files.path, found)
