"""R-precision, FID, multimodal distance, diversity, multimodality and retrieval on a table."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial.distance import cdist

import prbench
from prbench.contract import Adapter, Condition, ConditionBatch, Trainable
from prbench.errors import PredictionsError, RunError, UsageError
from prbench.files.storage import text_digest
from prbench.harness.methods.loading import chosen_condition, load_adapter, weights_digest
from prbench.harness.methods.motions import Declared, generate_checked, native_frames
from prbench.harness.run_folder import RunFolder
from prbench.protocol.manifests import load_protocol
from prbench.randomness import noise_seed
from prbench.representation import encode
from prbench.viewing.replay.read import RunMotions
from prbench_adapters.training.store import Motion, Row, cut, open_table
from prbench_benchmarks.text_to_motion import clips as clips_of
from prbench_benchmarks.text_to_motion import metrics
from prbench_benchmarks.text_to_motion.clips import Draw, Extractor, Pass, draw, recorded_features
from prbench_benchmarks.text_to_motion.networks import SNIPPET, EvaluatorConfiguration
from prbench_benchmarks.text_to_motion.report import NearMotion, ResultRow, Retrieval, TextEvaluation
from prbench_benchmarks.text_to_motion.training import load_evaluator

_REPETITIONS = 20
_REPETITIONS_WITH_MULTIMODALITY = 5
_PROMPTS = 1000
REAL = "real"
MISMATCHED = "real, texts shuffled"
Progress = Callable[[int, int, str], None]  # Called with finished repetitions, all repetitions, and a word.
Features = Float[np.ndarray, "n 263"]


@dataclass(frozen=True, kw_only=True)
class TextEvaluationRequest:
    """One evaluation.

    Attributes:
        evaluator: A trained evaluator's weights.
        corpus: A built corpus or dataset.
        kinds: Kinds of captions; empty for all.
        method: The method whose motions are evaluated; None for recorded motions alone.
        weights: Weights of the method; None for its default.
        options: Options of the method.
        batch_size: Motions that the method makes at once.
        repetitions: Number of repetitions; by default 20, and 5 with multimodality.
        retrieval: Rank texts and motions among all pairs as well.
        nearest: Run whose motions' nearest clips are sought in place of the metrics; None for none.
        limit: Motions of each dataset of that run at most, in the order of their ids; None for all.
        neighbours: Clips that are named for each motion.
        prompts: Prompts that a method is given in a repetition; fewer if there are fewer.
    """

    evaluator: Path
    corpus: Path
    split: str = "test"
    kinds: frozenset[str] = frozenset()
    method: str | None = None
    weights: Path | None = None
    options: Mapping[str, str] = field(default_factory=dict)
    batch_size: int = 64
    repetitions: int | None = None
    multimodality: bool = False
    retrieval: bool = False
    nearest: Path | None = None
    limit: int | None = None
    neighbours: int = 3
    prompts: int = _PROMPTS
    diversity_pairs: int = metrics.DIVERSITY_PAIRS
    seed: int = 0
    device: str = "cpu"
    threads: int = 1
    words: Path | None = None
    text_path: str | None = None

    @property
    def chosen_repetitions(self) -> int:
        """Number of repetitions: as asked for, or the usual one."""
        return self.repetitions or (_REPETITIONS_WITH_MULTIMODALITY if self.multimodality else _REPETITIONS)


@dataclass
class _Row:
    """The repetitions of one row so far.

    Attributes:
        with_retrieval: Measure retrieval in every repetition.
    """

    with_retrieval: bool
    values: dict[str, list[float]] = field(default_factory=dict)
    rankings: list[metrics.RPrecision] = field(default_factory=list)
    retrievals: list[metrics.Retrieved] = field(default_factory=list)
    motions: int = 0

    def add(self, pairs: metrics.EmbeddedPairs, more: dict[str, float]) -> None:
        """Take in one repetition: what its pairs measure, and other values."""
        ranking = metrics.r_precision(pairs.text, pairs.motion, pairs.captions)
        measured = dict(zip(metrics.R_PRECISION, ranking.top.tolist()))
        measured[metrics.DISTANCE] = metrics.multimodal_distance(pairs.text, pairs.motion)
        for name, value in (measured | more).items():
            self.values.setdefault(name, []).append(value)
        self.rankings.append(ranking)
        if self.with_retrieval:
            self.retrievals.append(metrics.retrieval(pairs))
        self.motions = len(pairs.captions)

    def result(self, source: str, **of_method: Any) -> ResultRow:
        """Return the row after at least one repetition."""
        retrieval = []
        for query, candidates, hit in self.retrievals[0] if self.retrievals else ():
            measured = [each[query, candidates, hit] for each in self.retrievals]
            numbers = {name: metrics.Repeated.of([one[name] for one in measured]) for name in metrics.RETRIEVAL}
            retrieval.append(Retrieval(query=query, candidates=candidates, hit=hit, **numbers))
        return ResultRow(
            source=source,
            metrics={name: metrics.Repeated.of(self.values[name]) for name in metrics.METRICS if name in self.values},
            motions=self.motions,
            ranked_pairs=self.rankings[-1].n_pairs,
            dropped_pairs=self.rankings[-1].n_dropped,
            duplicate_captions=float(np.mean([each.n_duplicates for each in self.rankings])),
            repetitions=len(self.rankings),
            retrieval=tuple(retrieval),
            **of_method,
        )


@dataclass(frozen=True)
class _Passes:
    """What all repetitions share.

    Attributes:
        supported: Those that the method can generate.
        texts: Embedded once for all repetitions; only crops change.
    """

    request: TextEvaluationRequest
    evaluator: Extractor
    clips: tuple[Row, ...]
    supported: tuple[Row, ...]
    texts: dict[str, np.ndarray]
    adapter: Adapter | None

    def embedded(self, drawn: Sequence[Draw], features: Sequence[Features]) -> metrics.EmbeddedPairs:
        """Put motions beside their texts in the evaluator's space."""
        text = np.stack([self.texts[one.caption] for one in drawn])
        return metrics.EmbeddedPairs(tuple(one.caption for one in drawn), text, self.evaluator.embed_motions(features))

    def recorded(self, taken: Pass) -> metrics.EmbeddedPairs:
        """All clips, with the crops and captions of a pass."""
        configuration = self.evaluator.configuration
        drawn = [draw(clip, taken, configuration) for clip in self.clips]
        return self.embedded(drawn, [recorded_features(*pair, configuration) for pair in zip(self.clips, drawn)])

    def generated(self, taken: Pass) -> metrics.EmbeddedPairs:
        """Motions of the method for the prompts of a pass."""
        clips = self._prompts(taken, self.request.prompts)
        drawn = [draw(clip, taken, self.evaluator.configuration) for clip in clips]
        prompts = [(clip.sequence_id, one, taken.repetition) for clip, one in zip(clips, drawn)]
        return self.embedded(drawn, self._features(prompts))

    def multimodality(self, taken: Pass) -> float:
        """Compare motions of the same prompts with different noise."""
        # Noise of no other pass.
        first = (taken.repetition + 1) * metrics.MULTIMODALITY_SAMPLES + self.request.chosen_repetitions
        clips = self._prompts(taken, metrics.MULTIMODALITY_PROMPTS)
        prompts = [
            (clip.sequence_id, draw(clip, taken, self.evaluator.configuration), sample)
            for clip in clips
            for sample in range(first, first + metrics.MULTIMODALITY_SAMPLES)
        ]
        found = self.evaluator.embed_motions(self._features(prompts))
        pairs = metrics.draw_multimodality_pairs(metrics.MULTIMODALITY_SAMPLES, taken.generator("pairs"))
        return metrics.multimodality(found.reshape(len(clips), metrics.MULTIMODALITY_SAMPLES, -1), pairs)

    def motions(self, pairs: metrics.EmbeddedPairs, reference: np.ndarray, taken: Pass) -> dict[str, float]:
        """FID to recorded motions, and diversity."""
        motion = pairs.motion
        generator = taken.generator("diversity")
        drawn = metrics.draw_diversity_pairs(len(motion), generator, n_pairs=self.request.diversity_pairs)
        return {metrics.FID: metrics.fid(reference, motion), metrics.DIVERSITY: metrics.diversity(motion, drawn)}

    def _prompts(self, taken: Pass, most: int) -> list[Row]:
        number = min(most, len(self.supported))
        places = taken.generator("prompts").choice(len(self.supported), number, replace=False)
        return [self.supported[place] for place in places]

    def _features(self, prompts: Sequence[tuple[str, Draw, int]]) -> list[Features]:
        """Generate motions for sequence ids with their texts and lengths, each with a sample's noise, and encode them.

        Motions of similar length are made together, so that little is computed for padding; the place breaks ties, so
        that the order is fixed.
        """
        adapter, request, configuration = self.adapter, self.request, self.evaluator.configuration
        assert adapter is not None
        order = sorted(range(len(prompts)), key=lambda place: (prompts[place][1].n_frames, place))
        found: dict[int, Features] = {}
        for start in range(0, len(order), request.batch_size):
            places = order[start : start + request.batch_size]
            chosen = [prompts[place] for place in places]
            batch = ConditionBatch(
                condition=Condition.TEXT,
                n_frames=np.array([one.n_frames for _, one, _ in chosen], dtype=np.int64),
                fps=configuration.fps,
                # Methods must not recognise sequences, so they see a digest in place of the id.
                opaque_id=tuple(text_digest("opaque", str(request.seed), name)[:16] for name, _, _ in chosen),
                noise_seed=tuple(noise_seed(request.seed, name, sample) for name, _, sample in chosen),
                text=tuple(one.caption for _, one, _ in chosen),
            )
            ids = [name for name, _, _ in chosen]
            motions, _ = generate_checked(adapter, batch, seed=request.seed, method=adapter.name, sequence_ids=ids)
            for place, (name, one, _), joints in zip(places, chosen, motions.joints):
                source = f"{adapter.name}'s motion for {name}"
                found[place] = generated_features(joints[: one.n_frames], configuration, name=source)
        return [found[place] for place in range(len(prompts))]


def evaluate_text(request: TextEvaluationRequest, progress: Progress = lambda *_: None) -> TextEvaluation:
    """Evaluate recorded motions, and a method's if one is named.

    Raises:
        UsageError: if the request does not fit together.
        TableError: if the table has too few clips.
        InputFileError: if the evaluator's weights are none.
        AdapterError: if the method cannot be loaded, takes no text, or breaks the contract.
        RunError: if the run of ``nearest`` is none, has no motions, or is of another benchmark or frame rate.
        PredictionsError: if a motion of that run cannot be read.
    """
    torch.set_num_threads(request.threads)
    tables = [open_table(request.corpus)]
    evaluator = load_evaluator(
        request.evaluator, tables, device=request.device, words=request.words, text_path=request.text_path
    )
    configuration = evaluator.configuration
    read = clips_of.EvaluatedClips.read(request.corpus, split=request.split, kinds=request.kinds, fps=configuration.fps)
    info = read.table.info
    about: dict[str, Any] = {name: getattr(request, name) for name in ("split", "seed", "diversity_pairs")}
    about |= {"vectorisation": evaluator.vectorisation, "evaluator_sha256": evaluator.digest}
    about |= {"dataset": info.dataset, "corpus_content_digest": info.content_digest}
    about |= {"clips": len(read.clips), "left_out": read.left_out, "distinct_captions": len(read.captions())}
    about |= {"representation": configuration.representation, "kinds": tuple(sorted(request.kinds))}
    about |= {"prbench_version": prbench.__version__}
    if request.nearest is not None:
        return TextEvaluation(**about, rows=(), **_nearest(request, request.nearest, evaluator, read.clips))
    adapter = None
    supported = read.clips
    if request.method is not None:
        adapter = load_adapter(request.method, request.weights, request.options, request.device)
        chosen_condition(request.method, adapter, Condition.TEXT)
        if isinstance(adapter, Trainable) and request.weights is None:
            raise UsageError(f"the method '{request.method}' learns from a table first; give it --weights.")
        # The clips of which the method can generate as many frames as they may ask for.
        declared = Declared.by(adapter, origin=f"adapter '{adapter.name}'")
        if declared.max_frames is not None:
            lengths = np.array([clips_of.longest(clip, configuration) for clip in read.clips])
            fps = configuration.fps
            native = native_frames(lengths, fps=fps, native_fps=declared.native_fps or fps)
            supported = tuple(clip for clip, n in zip(read.clips, native) if n <= declared.max_frames)
    fewest = min(len(supported), request.prompts) if adapter else len(read.clips)
    # Diversity draws two disjoint sets of so many motions from one pass.
    if fewest <= request.diversity_pairs:
        raise UsageError(
            f"diversity over {request.diversity_pairs} pairs needs more than {request.diversity_pairs}"
            f" motions, found {fewest}. Use a larger split, or lower --diversity-pairs; the number is then"
            " comparable with others of as many pairs only."
        )
    texts = dict(zip(read.captions(), evaluator.embed_texts(read.captions())))
    passes = _Passes(request, evaluator, read.clips, supported, texts, adapter)
    real = _Row(request.retrieval)
    mismatched = _Row(request.retrieval)
    made = _Row(request.retrieval)
    for repetition in range(request.chosen_repetitions):
        # All rows are compared with the same pass over the recorded motions, one of its own: against the same crops,
        # real motion would get an FID of 0.
        reference = passes.recorded(Pass(request.seed, repetition, "reference")).motion
        taken = Pass(request.seed, repetition, "real")
        pairs = passes.recorded(taken).shuffled(taken.generator("order"))
        real.add(pairs, passes.motions(pairs, reference, taken))
        mismatched.add(pairs.mismatched(), {})
        if adapter is not None:
            extra = {}
            if request.multimodality:
                extra[metrics.MULTIMODALITY] = passes.multimodality(Pass(request.seed, repetition, "multimodality"))
            taken = Pass(request.seed, repetition, "generated")
            pairs = passes.generated(taken)
            made.add(pairs, passes.motions(pairs, reference, taken) | extra)
        progress(repetition + 1, request.chosen_repetitions, "repetitions")
    rows = [real.result(REAL), mismatched.result(MISMATCHED)]
    if request.method is not None:
        given = {"weights_sha256": weights_digest(request.weights), "options": request.options}
        rows.append(made.result(request.method, unsupported=len(read.clips) - len(supported), **given))
    return TextEvaluation(**about, rows=tuple(rows), notes=_notes(rows, request))


def _notes(rows: Sequence[ResultRow], request: TextEvaluationRequest) -> tuple[str, ...]:
    notes = ["± is 1.96 · standard deviation / √repetitions: how far chance moves these means, and nothing else."]
    fewest = min(row.motions for row in rows)
    if fewest < metrics.FEWEST:
        notes.append(f"FID is of {fewest} motions: biased upwards below {metrics.FEWEST}.")
    if request.diversity_pairs != metrics.DIVERSITY_PAIRS:
        notes.append(f"diversity is over {request.diversity_pairs} pairs instead of {metrics.DIVERSITY_PAIRS}.")
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


def _nearest(request: TextEvaluationRequest, path: Path, evaluator: Extractor, clips: Sequence[Row]) -> dict[str, Any]:
    """Return the clips ``nearest`` to each motion of a run, and ``notes``; of what is too long, the end is compared."""
    run = RunFolder.open(path)
    configuration = evaluator.configuration
    fps = (run.protocol or load_protocol()).fps
    if fps != configuration.fps:
        expected = f"motions of {configuration.fps:g} frames per second, as the evaluator was trained"
        raise RunError(f"{run.path}: expected {expected}, found {fps:g}.")
    motions: dict[tuple[str, int], np.ndarray] = {}
    for table in run.record.tables:
        stored = RunMotions.open(run, table.dataset, label="").predictions
        for name, sample in sorted(zip(stored.ids, stored.samples))[: request.limit]:
            motions[name, sample] = stored.motions([name], sample).values

    def embedded(named: Iterable[tuple[str, np.ndarray]]) -> np.ndarray:
        features = []
        for name, joints in named:
            n_frames = min(len(joints), configuration.max_frames) // SNIPPET * SNIPPET
            if not n_frames:
                raise PredictionsError(f"{run.path}, {name}: expected {SNIPPET} frames or more, found {len(joints)}.")
            # The end: a reach is recognised by where it arrives. Clips are cut alike, so that a copy of one is at 0.
            whole = Motion(joints, joints[0], joints[-1], np.full(3, np.nan))
            end = cut(whole, len(joints) - n_frames, n_frames, name=name)
            features.append(generated_features(end.joints, configuration, name=name))
        return evaluator.embed_motions(features)

    recorded = embedded((clip.sequence_id, clip.motion.joints) for clip in clips)
    near = []
    for (name, sample), embedding in zip(motions, embedded((key[0], motion) for key, motion in motions.items())):
        distances = cdist(embedding[None], recorded)[0]  # float64
        for rank, place in enumerate(np.argsort(distances, kind="stable")[: request.neighbours], start=1):
            about = {"clip": clips[place].sequence_id, "distance": float(distances[place]), "texts": clips[place].texts}
            near.append(NearMotion(sequence_id=name, sample=sample, rank=rank, **about))
    longer = sum(len(joints) > configuration.max_frames for joints in motions.values())
    notes = (
        f"{run.path}: {len(motions)} motions of {run.record.method.name}, {longer} of them longer than the"
        f" {configuration.max_frames} frames that the evaluator reads; of these, as of longer clips, the end counts.",
        "distances compare within one evaluator only; the nearest clip may still be far.",
    )
    return {"nearest": tuple(near), "notes": notes}


def generated_features(
    joints: Float[np.ndarray, "n 22 3"], configuration: EvaluatorConfiguration, *, name: str
) -> Features:
    """Features of a generated motion, which is canonical as it is; its last step is taken once more for the last row.

    Raises:
        InputFileError: if a pose cannot be encoded; it begins with ``name``.
    """
    # A row of features describes the step to the next frame, and the last frame has none.
    beyond = 2 * joints[-1] - joints[-2]
    return encode(joints, next_joints=beyond, mode=configuration.representation, source=name, upright=False)
