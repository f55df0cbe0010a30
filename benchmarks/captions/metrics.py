"""Metrics of captions: BLEU, ROUGE, CIDEr-D and BERTScore (docs/specification/captions.md#metrics).

A candidate is one text, its references are one or more; nothing is lemmatised. BLEU and ROUGE are those of the packages
``sacrebleu`` and ``rouge-score`` (extra ``captions``), BERTScore that of ``bert-score`` (extra ``bertscore``).
"""

from __future__ import annotations

import importlib
import math
import re
from collections import Counter
from collections.abc import Sequence
from itertools import zip_longest
from typing import Any

import numpy as np
from jaxtyping import Float

from prbench.errors import MissingExtraError, UnloadableExtraError

References = Sequence[Sequence[str]]  # of each candidate
LONGEST = 160  # tokens of a motion, and pieces or words of a caption; public programs cut at 20 words or 40 tokens
WEARER = ("#C C", "#C", "the camera wearer", "the wearer", "C")  # all become the last one; pronouns stay
_NAMES = re.compile(rf"(?<!\w)(?:{'|'.join(map(re.escape, WEARER))})(?!\w)", re.IGNORECASE)
_LONGEST_GRAM = 4


def normalised(text: str) -> str:
    """Return a text in which every name of the wearer is the last of :data:`WEARER`, and nothing else is changed."""
    return _NAMES.sub(WEARER[-1], text)


def bleu(candidates: Sequence[str], references: References, order: int = 4, **settings: Any) -> tuple[Any, str]:
    """BLEU-n of a whole corpus by sacrebleu; without smoothing it is 0 where no n-gram of some length is found.

    Args:
        candidates: Texts that are scored.
        references: Texts that each of them is compared with.
        order: Longest n-gram.
        settings: Settings of sacrebleu's ``BLEU``; by default its tokeniser ``13a``, case, and no smoothing.

    Returns:
        sacrebleu's result (``score`` from 0 to 100, ``precisions``, ``bp``, ``sys_len``, ``ref_len``), and the
        signature that names all settings and the version.

    Raises:
        MissingExtraError: if sacrebleu is not installed.
    """
    chosen = {"tokenize": "13a", "smooth_method": "none", "max_ngram_order": order} | settings
    metric = _package("sacrebleu.metrics", "sacrebleu", "captions", "BLEU").BLEU(**chosen)
    # sacrebleu wants the first references of all candidates, then the second ones; None where one has fewer.
    score = metric.corpus_score(list(candidates), list(zip_longest(*references)))
    return score, str(metric.get_signature())


def rouge(
    candidates: Sequence[str], references: References, kind: str = "rougeL", *, stemmer: bool = False
) -> Float[np.ndarray, "clips 3"]:
    """Precision, recall and F (β = 1) of ``rouge1``, ``rouge2`` or ``rougeL``, each against the best reference.

    The package ignores case and punctuation.

    Raises:
        MissingExtraError: if rouge-score is not installed.
    """
    scorer = _package("rouge_score.rouge_scorer", "rouge-score", "captions", "ROUGE").RougeScorer([kind], stemmer)
    found = [scorer.score_multi(list(texts), text)[kind] for text, texts in zip(candidates, references, strict=True)]
    return np.array(found).reshape(-1, 3)


def captioning_rouge_l(candidate: str, references: Sequence[str], *, beta: float = 1.2) -> float:
    """ROUGE-L of the captioning programs: whitespace tokens, F of the best precision and the best recall."""
    words = candidate.split()
    found = []
    for reference in references:
        others = reference.split()
        lengths = [0] * (len(others) + 1)  # of the longest common subsequence with each beginning of the reference
        for word in words:
            before = lengths.copy()
            for place, other in enumerate(others):
                grown = before[place] + 1
                lengths[place + 1] = grown if word == other else max(lengths[place], before[place + 1])
        found.append((lengths[-1] / max(len(words), 1), lengths[-1] / max(len(others), 1)))
    precision, recall = map(max, zip(*found))
    return (1 + beta**2) * precision * recall / max(recall + beta**2 * precision, 1e-12)


def cider_d(candidates: Sequence[str], references: References, *, sigma: float = 6.0) -> Float[np.ndarray, " clips"]:
    """CIDEr-D of each candidate, from 0 to 10; whitespace tokens.

    The mean over n = 1..4, and over references, of the cosine of n-grams weighted by count × log(clips / clips whose
    references hold the n-gram). Counts are clipped to the reference's, and other lengths cost exp(−Δ² / 2σ²). It
    depends on the whole set of references: a single clip scores 0.

    Args:
        candidates: Texts that are scored.
        references: Texts that each of them is compared with.
        sigma: Difference of lengths, in bigrams.
    """

    def grams(text: str) -> Counter[tuple[str, ...]]:
        words = text.split()
        sizes = range(1, _LONGEST_GRAM + 1)
        return Counter(tuple(words[at : at + n]) for n in sizes for at in range(len(words) - n + 1))

    clips = Counter(gram for texts in references for gram in {gram for text in texts for gram in grams(text)})

    def vectors(text: str) -> list[dict[tuple[str, ...], float]]:
        weights: list[dict[tuple[str, ...], float]] = [{} for _ in range(_LONGEST_GRAM)]
        for gram, count in grams(text).items():
            weights[len(gram) - 1][gram] = count * math.log(len(references) / max(clips[gram], 1))
        return weights

    scores = np.zeros(len(references))
    for place, (text, texts) in enumerate(zip(candidates, references, strict=True)):
        for other in texts:
            apart = max(len(text.split()) - 1, 0) - max(len(other.split()) - 1, 0)
            share = 10.0 * math.exp(-(apart**2) / (2 * sigma**2)) / _LONGEST_GRAM / len(texts)
            for mine, theirs in zip(vectors(text), vectors(other)):
                norms = math.hypot(*mine.values()) * math.hypot(*theirs.values())
                common = sum(min(mine[gram], theirs[gram]) * theirs[gram] for gram in mine.keys() & theirs.keys())
                scores[place] += share * common / norms if norms else 0.0
    return scores


def bert_score(
    candidates: Sequence[str],
    references: References,
) -> tuple[Float[np.ndarray, " clips"], str]:
    """F1 of BERTScore, each against the best reference: IDF of the references, rescaled, so it can be negative.

    Returns:
        The scores, and the library's hash string.

    Raises:
        MissingExtraError: if bert-score is not installed.
        UnloadableExtraError: if its model cannot be loaded.
    """
    module = _package("bert_score", "bert-score", "bertscore", "BERTScore")
    texts = [text for each in references for text in each]
    try:
        scorer = module.BERTScorer(lang="en", idf=True, idf_sents=texts, rescale_with_baseline=True)
    except OSError as error:
        remedy = "Load its model once where there is internet, and copy the hub's cache (HF_HOME)."
        raise UnloadableExtraError(
            "bert-score", "BERTScore", str(error).partition("\n")[0].rstrip("."), remedy
        ) from error
    # Empty candidates get the package's raw 0 here: with transformers 5 it fails on them.
    base = float(scorer.baseline_vals[2])
    found = np.full(len(candidates), -base / (1 - base))
    pairs = [(text, list(each)) for text, each in zip(candidates, references, strict=True) if text.strip()]
    if pairs:
        found[[bool(text.strip()) for text in candidates]] = scorer.score(*map(list, zip(*pairs)))[2].numpy()
    return found, scorer.hash


def _package(module: str, package: str, extra: str, purpose: str) -> Any:
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise MissingExtraError(package, extra, purpose) from error
