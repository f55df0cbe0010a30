from __future__ import annotations

import numpy as np

from prbench_adapters.diffusion.batching import parts_of_similar_length


def _lists(n_frames: list[int], largest: int) -> list[list[int]]:
    return [part.tolist() for part in parts_of_similar_length(np.array(n_frames), largest)]


def test_a_part_ends_where_the_shortest_would_be_padded_by_more_than_a_quarter():
    assert _lists([50, 40, 51, 100], 8) == [[1, 0], [2], [3]]


def test_a_part_ends_when_it_is_full():
    assert _lists([10, 10, 10, 10, 10], 2) == [[0, 1], [2, 3], [4]]


def test_every_row_is_in_one_part():
    n_frames = np.random.default_rng(0).integers(20, 240, 50)
    parts = parts_of_similar_length(n_frames, 7)
    assert sorted(np.concatenate(parts).tolist()) == list(range(50))
    assert all(n_frames[part].max() <= 1.25 * n_frames[part].min() for part in parts)
