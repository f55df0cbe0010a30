"""Score motions that lie on disk: those of a run folder, or a file that somebody hands in."""

from prbench.submitted.score_predictions.board import UNSTATED
from prbench.submitted.score_predictions.request import ScoreReport, ScoreRequest
from prbench.submitted.score_predictions.score import score_predictions

__all__ = ["UNSTATED", "ScoreReport", "ScoreRequest", "score_predictions"]
