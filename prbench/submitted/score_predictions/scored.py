"""The scores of one table: what was chosen of it, the long form, and the summary."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from prbench.engine import Engine
from prbench.evaluation.planning import Selection
from prbench.evaluation.progress import Progress, ProgressCallback
from prbench.evaluation.scoring import ScoringRules, score_selection
from prbench.evaluation.summarise import ScoredSet, summarise
from prbench.runs.predictions import Predictions
from prbench.runs.summary import DatasetSummary


@dataclass(frozen=True)
class Work:
    """Where the work is done, and who is told how far it is."""

    engine: Engine
    progress: ProgressCallback


@dataclass(frozen=True, kw_only=True)
class About:
    """What a summary says of the motions beside their scores."""

    method: str
    condition: str
    control: str | None


@dataclass(frozen=True)
class Scored:
    """The results of one table."""

    chosen: Selection
    """The sequences of split and limit."""
    selection: Selection
    """Of these, the ones that were scored."""
    scores: pa.Table
    summary: DatasetSummary

    @classmethod
    def of(
        cls,
        chosen: Selection,
        selection: Selection,
        predictions: Predictions,
        *,
        samples: Sequence[int],
        rules: ScoringRules,
        about: About,
        work: Work,
    ) -> Scored:
        """Score the motions of a table and summarise them."""
        windows = score_selection(selection, predictions, samples=samples, rules=rules, engine=work.engine)
        scores = pa.concat_tables(_reported(windows, selection, work.progress)).combine_chunks()
        scored = ScoredSet(
            info=selection.table.info,
            recording_of=dict(zip(selection.sequence_ids, selection.recording_ids)),
            chosen=len(chosen),
            method=about.method,
            condition=about.condition,
            control=about.control,
            split=selection.split,
            samples=len(samples),
        )
        return cls(chosen, selection, scores, summarise(scores, scored))


def _reported(windows: Iterator[pa.Table], selection: Selection, progress: ProgressCallback) -> Iterator[pa.Table]:
    done = 0
    for window in windows:
        yield window
        done += len(np.unique(window["sequence_id"].to_numpy()))
        progress(Progress(selection.table.info.dataset, "score", done, len(selection)))
