"""Score motions that lie on disk: those of a run folder, or a file that somebody hands in."""

from prbench.evaluation.score_predictions.board import UNSTATED
from prbench.evaluation.score_predictions.request import ScoreReport, ScoreRequest
from prbench.evaluation.score_predictions.score import score_predictions

__all__ = ["UNSTATED", "ScoreReport", "ScoreRequest", "score_predictions"]
