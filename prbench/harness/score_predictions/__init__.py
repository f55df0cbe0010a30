"""Score motions that lie on disk: those of a run folder, or a file that somebody hands in."""

from prbench.harness.score_predictions.request import GivenMotions, ScoreReport, ScoreRequest
from prbench.harness.score_predictions.score import score_predictions
from prbench.harness.score_predictions.scored import UNSTATED

__all__ = ["UNSTATED", "GivenMotions", "ScoreReport", "ScoreRequest", "score_predictions"]
