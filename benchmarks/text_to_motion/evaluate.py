"""R-precision, FID, multimodal distance, diversity and multimodality on a table (Prime and Reach, section F)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float

import prbench
from prbench.errors import UsageError
from prbench_adapters.training.store import open_table
from prbench_benchmarks.text_to_motion.clips import EvaluatedClips, Extractor, Pass, draw, recorded_features
from prbench_benchmarks.text_to_motion.generated import Generator, MethodRequest, Prompt
from prbench_benchmarks.text_to_motion.metrics import (
    DIVERSITY_PAIRS,
    FEWEST,
    MULTIMODALITY,
    MULTIMODALITY_PROMPTS,
    MULTIMODALITY_SAMPLES,
    EmbeddedPairs,
    draw_multimodality_pairs,
    measure_motions,
    measure_pairs,
    multimodality,
)
from prbench_benchmarks.text_to_motion.networks import EvaluatorConfiguration
from prbench_benchmarks.text_to_motion.report import ResultRow, RowTally, TextEvaluation
from prbench_benchmarks.text_to_motion.training import LoadedEvaluator, load_evaluator

_REPETITIONS = 20
_REPETITIONS_WITH_MULTIMODALITY = 5
_PROMPTS = 1000
REAL = "real"
MISMATCHED = "real, texts shuffled"
Progress = Callable[[int, int, str], None]
"""Called with finished repetitions, all repetitions, and a word."""


@dataclass(frozen=True, kw_only=True)
class TextEvaluationRequest:
    """One evaluation."""

    evaluator: Path
    """A trained evaluator's weights."""
    corpus: Path
    """A built corpus or dataset."""
    split: str = "test"
    kinds: frozenset[str] = frozenset()
    """Kinds of captions; empty for all."""
    method: MethodRequest | None = None
    """The method; None for recorded motions alone."""
    repetitions: int | None = None
    """Number of repetitions; by default 20, and 5 with multimodality."""
    multimodality: bool = False
    prompts: int = _PROMPTS
    """Prompts that a method is given in a repetition; fewer if there are fewer."""
    diversity_pairs: int = DIVERSITY_PAIRS
    seed: int = 0
    device: str = "cpu"
    threads: int = 1
    words: Path | None = None
    text_path: str | None = None

    @property
    def chosen_repetitions(self) -> int:
        """Number of repetitions: as asked for, or the usual one."""
        return self.repetitions or (_REPETITIONS_WITH_MULTIMODALITY if self.multimodality else _REPETITIONS)


def silent(done: int, total: int, last: str) -> None:
    """Show nothing."""


def evaluate_text(request: TextEvaluationRequest, progress: Progress = silent) -> TextEvaluation:
    """Evaluate recorded motions, and a method's if one is named.

    Raises:
        UsageError: if the request does not fit together.
        TableError: if the table has too few clips.
        InputFileError: if the evaluator's weights are none.
        AdapterError: if the method cannot be loaded, takes no text, or breaks the contract.
    """
    torch.set_num_threads(request.threads)
    evaluator = load_evaluator(
        request.evaluator,
        [open_table(request.corpus)],
        device=request.device,
        words=request.words,
        text_path=request.text_path,
    )
    configuration = evaluator.extractor.configuration
    clips = EvaluatedClips.read(request.corpus, split=request.split, kinds=request.kinds, fps=configuration.fps)
    generator = Generator.load(request.method, seed=request.seed, fps=configuration.fps) if request.method else None
    evaluation = _Evaluation(request, evaluator, clips, generator)
    for repetition in range(request.chosen_repetitions):
        evaluation.repeat(repetition)
        progress(repetition + 1, request.chosen_repetitions, "repetitions")
    return evaluation.result()


class _Evaluation:
    """The state between repetitions."""

    def __init__(
        self,
        request: TextEvaluationRequest,
        evaluator: LoadedEvaluator,
        clips: EvaluatedClips,
        generator: Generator | None,
    ) -> None:
        self.request, self.evaluator, self.clips, self.generator = request, evaluator, clips, generator
        self.extractor: Extractor = evaluator.extractor
        self.configuration: EvaluatorConfiguration = evaluator.extractor.configuration
        self.texts = dict(zip(clips.captions(), self.extractor.embed_texts(clips.captions())))
        self.real, self.mismatched, self.generated = RowTally(), RowTally(), RowTally()
        self.supported = [
            clip for clip in clips.clips if generator is None or generator.supports(clip, self.configuration)
        ]
        self._require_enough()

    def repeat(self, repetition: int) -> None:
        """One repetition of every row; all are compared with the same pass over the recorded motions."""
        # FID is taken against a pass of its own: against the same crops, real motion would get 0.
        reference = self._recorded(Pass(self.request.seed, repetition, "reference")).motion
        taken = Pass(self.request.seed, repetition, "real")
        pairs = self._recorded(taken).shuffled(taken.generator("order"))
        self._add(self.real, pairs, reference, taken)
        self.mismatched.add(measure_pairs(pairs.mismatched()), {}, len(pairs.captions))
        if self.generator is not None:
            taken = Pass(self.request.seed, repetition, "generated")
            extra = {MULTIMODALITY: self._multimodality(repetition)} if self.request.multimodality else {}
            self._add(self.generated, self._generated(taken), reference, taken, extra)

    def result(self) -> TextEvaluation:
        """Everything that was measured, with what decides it."""
        rows = [self.real.result(REAL), self.mismatched.result(MISMATCHED)]
        if self.generator is not None:
            unsupported = len(self.clips.clips) - len(self.supported)
            rows.append(self.generated.result(self.generator.request.name, self.generator, unsupported))
        info = self.clips.table.info
        request = self.request
        return TextEvaluation(
            vectorisation=self.evaluator.vectorisation,
            evaluator_sha256=self.evaluator.digest,
            representation=self.configuration.representation,
            dataset=info.dataset,
            corpus_content_digest=info.content_digest,
            split=request.split,
            kinds=tuple(sorted(request.kinds)),
            clips=len(self.clips.clips),
            left_out=self.clips.left_out,
            distinct_captions=len(self.texts),
            seed=request.seed,
            diversity_pairs=request.diversity_pairs,
            prbench_version=prbench.__version__,
            rows=tuple(rows),
            notes=_notes(rows, request),
        )

    def _add(
        self,
        row: RowTally,
        pairs: EmbeddedPairs,
        reference: Float[np.ndarray, "recorded dimension"],
        taken: Pass,
        extra: dict[str, float] | None = None,
    ) -> None:
        motions = measure_motions(
            pairs.motion, reference, taken.generator("diversity"), diversity_pairs=self.request.diversity_pairs
        )
        row.add(measure_pairs(pairs), motions | (extra or {}), len(pairs.captions))

    def _recorded(self, taken: Pass) -> EmbeddedPairs:
        drawn = [draw(clip, taken, self.configuration) for clip in self.clips.clips]
        features = [recorded_features(*pair, self.configuration) for pair in zip(self.clips.clips, drawn)]
        return self._pairs([one.caption for one in drawn], features)

    def _generated(self, taken: Pass) -> EmbeddedPairs:
        n_prompts = min(self.request.prompts, len(self.supported))
        chosen = taken.generator("prompts").choice(len(self.supported), n_prompts, replace=False)
        clips = [self.supported[place] for place in chosen]
        drawn = [draw(clip, taken, self.configuration) for clip in clips]
        prompts = [Prompt(clip.sequence_id, one, taken.repetition) for clip, one in zip(clips, drawn)]
        return self._pairs([one.caption for one in drawn], self._features(prompts))

    def _multimodality(self, repetition: int) -> float:
        """Motions of the same prompts with different noise, in a pass of their own."""
        taken = Pass(self.request.seed, repetition, "multimodality")
        n_prompts = min(MULTIMODALITY_PROMPTS, len(self.supported))
        chosen = taken.generator("prompts").choice(len(self.supported), n_prompts, replace=False)
        first = (repetition + 1) * MULTIMODALITY_SAMPLES + self.request.chosen_repetitions  # noise of no other pass
        prompts = [
            Prompt(self.supported[place].sequence_id, draw(self.supported[place], taken, self.configuration), sample)
            for place in chosen
            for sample in range(first, first + MULTIMODALITY_SAMPLES)
        ]
        embedded = self.extractor.embed_motions(self._features(prompts))
        pairs = draw_multimodality_pairs(MULTIMODALITY_SAMPLES, taken.generator("pairs"))
        return multimodality(embedded.reshape(n_prompts, MULTIMODALITY_SAMPLES, -1), pairs)

    def _features(self, prompts: Sequence[Prompt]) -> list[np.ndarray]:
        assert self.generator is not None
        found = dict(self.generator.features(prompts, self.configuration))
        return [found[place] for place in range(len(prompts))]

    def _pairs(self, captions: Sequence[str], features: Sequence[np.ndarray]) -> EmbeddedPairs:
        # Texts are embedded once for all repetitions; only crops change.
        text = np.stack([self.texts[caption] for caption in captions])
        return EmbeddedPairs(tuple(captions), text, self.extractor.embed_motions(features))

    def _require_enough(self) -> None:
        fewest = min(len(self.supported), self.request.prompts) if self.generator else len(self.clips.clips)
        # Diversity draws two disjoint sets of so many motions from one pass.
        if fewest <= self.request.diversity_pairs:
            raise UsageError(
                f"diversity over {self.request.diversity_pairs} pairs needs more than {self.request.diversity_pairs}"
                f" motions, found {fewest}. Use a larger split, or lower --diversity-pairs; the number is then"
                " comparable with others of as many pairs only."
            )


def _notes(rows: Sequence[ResultRow], request: TextEvaluationRequest) -> tuple[str, ...]:
    notes = ["± is 1.96 · standard deviation / √repetitions: how far chance moves these means, and nothing else."]
    fewest = min(row.motions for row in rows)
    if fewest < FEWEST:
        notes.append(f"FID is of {fewest} motions: biased upwards below {FEWEST}.")
    if request.diversity_pairs != DIVERSITY_PAIRS:
        notes.append(f"diversity is over {request.diversity_pairs} pairs instead of {DIVERSITY_PAIRS}.")
    for row in rows:
        if row.duplicate_captions and row.source != MISMATCHED:
            notes.append(
                f"{row.source}: {row.duplicate_captions:.0f} of {row.ranked_pairs} ranked texts equal another one of"
                " their 32; the other's motion counts as a wrong one."
            )
        if row.unsupported:
            notes.append(f"{row.source}: {row.unsupported} clips are longer than the method can generate.")
    notes.append("the evaluator is a network fitted to a training split: real motion is no upper bound.")
    return tuple(notes)
