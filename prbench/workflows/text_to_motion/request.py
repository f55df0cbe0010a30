"""What an evaluation is asked for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from prbench.evaluation.text_to_motion.metrics import DIVERSITY_PAIRS
from prbench.workflows.text_to_motion.generated import MethodRequest

REPETITIONS, REPETITIONS_WITH_MULTIMODALITY = 20, 5
PROMPTS = 1000


@dataclass(frozen=True, kw_only=True)
class TextEvaluationRequest:
    """One evaluation."""

    evaluator: Path
    """A trained evaluator's weights."""
    corpus: Path
    """A built corpus or dataset."""
    split: str = "test"
    kinds: frozenset[str] = frozenset()
    """Of captions; empty for all."""
    method: MethodRequest | None = None
    """None for recorded motions alone."""
    repetitions: int | None = None
    """By default 20, and 5 with multimodality."""
    multimodality: bool = False
    prompts: int = PROMPTS
    """That a method is given a repetition; fewer if there are fewer."""
    diversity_pairs: int = DIVERSITY_PAIRS
    seed: int = 0
    device: str = "cpu"
    threads: int = 1
    words: Path | None = None
    text_path: str | None = None

    @property
    def chosen_repetitions(self) -> int:
        """As asked for, or the usual number."""
        return self.repetitions or (REPETITIONS_WITH_MULTIMODALITY if self.multimodality else REPETITIONS)
