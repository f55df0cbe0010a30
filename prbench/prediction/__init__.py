"""Motion prediction: windows, the firewall around their futures, metrics, and predictors without learning.

Source: docs/specification/motion-prediction.md.
"""

from prbench.prediction.batch import Condition, Futures, ObservedBatch, Predictor, sample_generator
from prbench.prediction.protocol import PredictionProtocol, load_prediction_protocol
from prbench.prediction.table import WindowsTable

__all__ = [
    "Condition",
    "Futures",
    "ObservedBatch",
    "PredictionProtocol",
    "Predictor",
    "WindowsTable",
    "load_prediction_protocol",
    "sample_generator",
]
