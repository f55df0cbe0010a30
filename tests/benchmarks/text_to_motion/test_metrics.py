from __future__ import annotations

import numpy as np
import pytest
from scipy import linalg

from prbench_benchmarks.text_to_motion.metrics import (
    EmbeddedPairs,
    Repeated,
    diversity,
    draw_diversity_pairs,
    draw_multimodality_pairs,
    fid,
    multimodal_distance,
    multimodality,
    r_precision,
    ranks,
    retrieval,
)


@pytest.fixture(scope="module")
def golden(samples):
    return np.load(samples / "metrics" / "text_to_motion.npz", allow_pickle=False)


def test_golden_r_precision_and_matching(golden):
    result = r_precision(golden["text"], golden["motion"])
    np.testing.assert_allclose(result.top, golden["r_precision"], rtol=0, atol=1e-9)
    assert (result.n_pairs, result.n_dropped) == (96, 0)
    assert multimodal_distance(golden["text"], golden["motion"]) == pytest.approx(
        float(golden["matching_score"]), rel=0, abs=1e-9
    )


def test_golden_fid(golden):
    assert fid(golden["motion_real"], golden["motion"]) == pytest.approx(float(golden["fid"]), rel=0, abs=1e-9)


def test_golden_fid_of_20_samples_in_40_dimensions(golden):
    assert fid(golden["low_a"], golden["low_b"]) == pytest.approx(float(golden["fid_low"]), rel=0, abs=1e-6)


def test_golden_diversity_and_multimodality(golden):
    pairs = np.stack([golden["div_first"], golden["div_second"]])
    assert diversity(golden["motion"], pairs) == pytest.approx(float(golden["diversity"]), rel=0, abs=1e-9)
    pairs = np.stack([golden["mm_first"], golden["mm_second"]])
    assert multimodality(golden["mm"], pairs) == pytest.approx(float(golden["multimodality"]), rel=0, abs=1e-9)


def line(n: int) -> np.ndarray:
    """Embeddings 0, 1, 2 … along one axis."""
    return np.arange(n, dtype=np.float64)[:, None] * np.array([[1.0, 0.0]])


def test_r_precision_counts_the_motions_that_are_nearer():
    motion = line(32)
    text = motion + np.array([1.3, 0.0])  # the next two motions are nearer than the own one
    assert r_precision(text, motion).top.tolist() == pytest.approx([1 / 32, 2 / 32, 1.0])


def test_r_precision_ranks_motions_for_each_text_and_not_the_reverse():
    text, motion = line(32), line(32)
    motion[1:] += 1000.0  # motion 0 is the nearest to every text; text 31 is the nearest to every other motion
    assert r_precision(text, motion).top[0] == pytest.approx(1 / 32)
    text, motion = motion, text
    assert r_precision(text, motion).top[0] == pytest.approx(2 / 32)


def test_equal_embeddings_earn_nothing():
    assert r_precision(np.zeros((32, 4)), np.zeros((32, 4))).top.tolist() == [0.0, 0.0, 0.0]


def test_an_incomplete_batch_is_dropped():
    text, motion = line(70), line(70)
    motion[64:] += 500.0
    result = r_precision(text, motion)
    assert result.top.tolist() == [1.0, 1.0, 1.0]
    assert (result.n_pairs, result.n_dropped) == (64, 6)
    with pytest.raises(ValueError, match="at least 32 pairs, found 31"):
        r_precision(text[:31], motion[:31])


def test_duplicate_captions_are_counted_batch_by_batch():
    captions = ["a", "a", "a", "b", "b"] + [f"c{i}" for i in range(27)] + ["a"] + [f"d{i}" for i in range(31)]
    assert r_precision(line(64), line(64), captions).n_duplicates == 5


def test_permuting_the_texts_and_motions_of_a_batch_together_changes_nothing():
    generator = np.random.default_rng(0)
    text = generator.normal(size=(32, 6))
    motion = text + generator.normal(size=(32, 6))
    order = generator.permutation(32)
    assert r_precision(text[order], motion[order]).top.tolist() == r_precision(text, motion).top.tolist()
    assert r_precision(text[order], motion).top[0] < r_precision(text, motion).top[0]


def on_a_line(*places: float) -> np.ndarray:
    return np.array(places)[:, None]


def test_ranks_worked_by_hand():
    """docs/specification/metrics.md#text-to-motion-metrics."""
    text, motion = on_a_line(0, 1, 2), on_a_line(0.4, 2.1, 1.85)
    (of_texts, equal), (of_motions, _) = ranks(text, motion, ["a", "b", "c"], candidates=3)
    assert of_texts.tolist() == equal.tolist() == [1, 3, 2]
    assert of_motions.tolist() == [1, 2, 1]
    assert multimodal_distance(text, motion) == pytest.approx(0.55)


def test_motions_and_texts_of_an_equal_caption_are_hits_in_the_second_column():
    """Texts 1 and 2 are one: motion 2 is a hit of text 1, before which stands none of another caption."""
    text, motion = on_a_line(0, 1, 1), on_a_line(0.4, 2.1, 1.1)
    (of_texts, equal_of_texts), (of_motions, equal_of_motions) = ranks(text, motion, ["a", "b", "b"], candidates=3)
    assert of_texts.tolist() == [1, 3, 1]
    assert equal_of_texts.tolist() == [1, 1, 1]
    assert of_motions.tolist() == [1, 2, 2]  # the other text of the same caption is exactly as near as the own one
    assert equal_of_motions.tolist() == [1, 1, 1]


def sorted_ranks(queries, asked, captions):
    """Sort what is asked, whatever is as near as a hit before it, and look where the first hit stands."""
    found = []
    for i, query in enumerate(queries):
        distances = [float(np.sqrt(sum((a - b) ** 2 for a, b in zip(query, other)))) for other in asked]
        for hits in ([i], [j for j, caption in enumerate(captions) if caption == captions[i]]):
            order = sorted(range(len(asked)), key=lambda j: (distances[j], j in hits))
            found.append(next(rank for rank, j in enumerate(order, 1) if j in hits))
    return np.array(found).reshape(-1, 2).T


def test_ranks_agree_with_sorting_where_many_distances_and_captions_are_equal(monkeypatch):
    monkeypatch.setattr("prbench_benchmarks.text_to_motion.metrics._QUERIES_AT_ONCE", 7)
    generator = np.random.default_rng(4)
    text, motion = (generator.integers(0, 4, size=(52, 2)).astype(np.float64) for _ in range(2))
    captions = [f"c{i}" for i in generator.integers(0, 12, size=52)]
    for candidates, n_batches in ((52, 1), (16, 3)):
        found = ranks(text, motion, captions, candidates=candidates)
        assert found.shape == (2, 2, n_batches * candidates)
        for start in range(0, n_batches * candidates, candidates):
            part = slice(start, start + candidates)
            for direction, (queries, asked) in enumerate(((text, motion), (motion, text))):
                expected = sorted_ranks(queries[part], asked[part], captions[part])
                np.testing.assert_array_equal(found[direction][:, part], expected)


def some_pairs(n: int = 70) -> EmbeddedPairs:
    generator = np.random.default_rng(5)
    text = generator.normal(size=(n, 6))[np.arange(n) // 2]
    motion = text + generator.normal(size=(n, 6))
    return EmbeddedPairs(tuple(f"c{i // 2}" for i in range(n)), text, motion)


def test_the_order_of_pairs_changes_no_retrieval_among_all():
    pairs = some_pairs()
    measured = retrieval(pairs)
    shuffled = retrieval(pairs.shuffled(np.random.default_rng(6)))
    among_all = [key for key in measured if key[1] == 70]
    assert len(among_all) == 4
    assert all(shuffled[key] == measured[key] for key in among_all)
    assert measured["text", 70, "own"]["r_at_1"] > retrieval(pairs.mismatched())["text", 70, "own"]["r_at_1"]


def test_retrieval_among_32_is_r_precision_where_texts_ask():
    pairs = some_pairs()
    measured = retrieval(pairs)
    assert {key[1] for key in measured} == {32, 70}
    top = r_precision(pairs.text, pairs.motion, pairs.captions).top
    assert measured["text", 32, "own"]["r_at_1"] == top[0]
    assert measured["text", 32, "same caption"]["r_at_1"] > top[0]
    assert len(retrieval(some_pairs(32))) == 4  # all of them are the one batch


def test_median_rank_and_recalls_worked_by_hand():
    """Six motions are nearer to each of 40 texts than its own, fewer to the last six: ranks 7, 6, 5, 4, 3, 2, 1."""
    pairs = EmbeddedPairs(tuple(str(i) for i in range(40)), line(40) + np.array([3.1, 0.0]), line(40))
    measured = retrieval(pairs)["text", 40, "own"]
    assert measured == {"r_at_1": 1 / 40, "r_at_5": 5 / 40, "r_at_10": 1.0, "median_rank": 7.0}


def test_equal_embeddings_find_nothing_and_other_than_finite_ones_are_refused():
    nothing = ranks(np.zeros((4, 2)), np.zeros((4, 2)), ["a", "b", "c", "d"], candidates=4)
    assert nothing.tolist() == np.full((2, 2, 4), 4).tolist()
    with pytest.raises(ValueError, match="not finite"):
        ranks(np.full((4, 2), np.nan), np.zeros((4, 2)), range(4), candidates=4)


def test_fid_of_two_normal_sets_worked_by_hand():
    """Variances 1 and 4 along one axis, means 3 apart: 9 + 1 + 4 - 2·2 = 10."""
    first = np.array([[-1.0], [1.0]]) / np.sqrt(2)
    second = np.array([[-2.0], [2.0]]) / np.sqrt(2) + 3.0
    assert fid(first, second) == pytest.approx(10.0)


def test_fid_agrees_with_the_matrix_square_root():
    generator = np.random.default_rng(1)
    first = generator.normal(size=(1200, 12)) @ generator.normal(size=(12, 12))
    second = generator.normal(size=(1500, 12)) @ generator.normal(size=(12, 12)) + 0.4
    c1, c2 = np.cov(first, rowvar=False), np.cov(second, rowvar=False)
    root = linalg.sqrtm(c1 @ c2).real
    expected = np.square(first.mean(0) - second.mean(0)).sum() + np.trace(c1 + c2 - 2 * root)
    assert fid(first, second) == pytest.approx(expected, rel=1e-9)
    assert fid(first, first) == pytest.approx(0.0, abs=1e-9)


def test_fid_refuses_nan():
    embeddings = np.random.default_rng(2).normal(size=(1000, 3))
    embeddings[3, 1] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        fid(embeddings, embeddings)


def test_diversity_pairs_do_not_repeat_within_a_set_but_may_meet_themselves():
    first, second = draw_diversity_pairs(301, np.random.default_rng(3))
    assert len(set(first)) == len(set(second)) == 300
    assert len(set(first) & set(second)) >= 299
    with pytest.raises(ValueError, match="more than 300 motions, found 300"):
        draw_diversity_pairs(300, np.random.default_rng(3))


def test_diversity_worked_by_hand():
    assert diversity(np.array([[0.0, 0.0], [3.0, 4.0], [6.0, 8.0]]), np.array([[0, 1, 1], [1, 2, 1]])) == pytest.approx(
        10 / 3
    )


def test_multimodality_uses_the_same_draw_for_all_prompts():
    motion = np.stack([line(10), 2 * line(10)])
    assert multimodality(motion, np.array([[0, 3], [1, 5]])) == pytest.approx((1 + 2 + 2 + 4) / 4)
    assert draw_multimodality_pairs(10, np.random.default_rng(0)).shape == (2, 10)
    with pytest.raises(ValueError, match="at least 10 samples, found 9"):
        draw_multimodality_pairs(9, np.random.default_rng(0))


def test_repetitions_have_the_interval_of_the_population_standard_deviation():
    repeated = Repeated.of([1.0, 3.0, 1.0, 3.0])
    assert (repeated.mean, repeated.half_width) == (2.0, pytest.approx(1.96 * 1.0 / 2))
    assert Repeated.of([5.0]).half_width is None
