"""Everything that a third party imports to add a method."""

from prbench.contract.adapter import (
    ENTRY_POINT_GROUP,
    Adapter,
    Cost,
    Gaze,
    LoadAdapter,
    Motions,
    Trainable,
    TrainingRun,
)
from prbench.contract.conditions import GIVEN, Condition, ConditionBatch
from prbench.contract.noise import batch_noise, sequence_noise

__all__ = [
    "ENTRY_POINT_GROUP",
    "GIVEN",
    "Adapter",
    "Condition",
    "ConditionBatch",
    "Cost",
    "Gaze",
    "LoadAdapter",
    "Motions",
    "Trainable",
    "TrainingRun",
    "batch_noise",
    "sequence_noise",
]
