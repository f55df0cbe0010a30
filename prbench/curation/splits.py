"""Splits of recordings: their own, else those of the dataset's stored list, else a draw over the table's recordings.

Source: docs/specification/curation.md#splits.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.distance import cdist

from prbench.protocol.manifests import Manifest, SplitRule
from prbench.randomness import hash_fraction
from prbench.sequences.sequence import Recording

# Weight of everybody's length together beside that of each person: the share of the test part matters first.
_TOGETHER = 10.0
# Exchanges end where the first pair does not help, so the draw begins in several places and keeps the best end.
_STARTS = 8


def draw_splits(recordings: Sequence[Recording], manifest: Manifest, rule: SplitRule) -> dict[str, str]:
    """Return the split of each recording; recordings of one ``split_group`` share it.

    Neither the order of the recordings nor what was curated from them changes a draw: it follows from names,
    participants and lengths.

    Args:
        recordings: All of one table. A ``split`` that is not empty stays.
        manifest: The dataset's name and stored list.
        rule: Shares of a draw.
    """
    settled: dict[str, str] = {}
    for each in recordings:
        if split := each.split or manifest.splits.get(each.recording_id, ""):
            settled[each.split_group] = split
    # Whole seconds, so that a rounding in a clock moves nobody. What could not be read has no length, and no say.
    drawn = {each.split_group for each in recordings if each.split_group not in settled and round(each.duration)}
    groups = sorted(drawn, key=lambda name: (hash_fraction(manifest.name, name), name))
    row = {name: number for number, name in enumerate(groups)}
    people = sorted({each.participant_id for each in recordings})
    seconds = np.zeros((len(groups), len(people)))
    for each in recordings:
        if each.split_group in row:
            seconds[row[each.split_group], people.index(each.participant_id)] += round(each.duration)
    left = np.arange(len(groups))
    for split, share, fewest in (("test", rule.test, rule.fewest_units), ("validation", rule.validation, 0)):
        lengths = np.sort(seconds[left].sum(axis=1))
        fitting = int(np.searchsorted(np.cumsum(lengths), (share + rule.tolerance) * seconds.sum(), side="right"))
        count = min(max(math.floor(share * len(groups) + 0.5), fewest), fitting)
        if groups and not settled:
            count = max(count, 1)  # a table without a test part could not be scored at all
        chosen = left[balanced_choice(seconds[left], share * seconds.sum(axis=0), count)]
        settled |= {groups[number]: split for number in chosen}
        left = np.setdiff1d(left, chosen)
    return {each.recording_id: each.split or settled.get(each.split_group, "train") for each in recordings}


def balanced_choice(
    lengths: Float[np.ndarray, "groups people"], wanted: Float[np.ndarray, " people"], count: int
) -> Bool[np.ndarray, " groups"]:
    """Choose groups of recordings that together come as close to the wanted lengths as exchanges of pairs lead.

    Args:
        lengths: What each group holds of each person, in any unit. The order of the rows decides between equal choices.
        wanted: What is wanted of each person, same unit.
        count: Number of groups to choose.

    Returns:
        True for the chosen groups.
    """
    best = np.zeros(len(lengths), dtype=bool)
    least = math.inf
    unit = max(lengths.sum(), 1.0)
    values = np.column_stack((lengths, _TOGETHER * lengths.sum(axis=1))) / unit
    target = np.append(wanted, _TOGETHER * wanted.sum()) / unit
    for start in range(_STARTS if count else 0):
        chosen = np.zeros(len(lengths), dtype=bool)
        chosen[(start * count + np.arange(count)) % len(lengths)] = True
        while True:
            missing = target - values[chosen].sum(axis=0)
            error = float(missing @ missing)
            given = np.flatnonzero(chosen)
            taken = np.flatnonzero(~chosen)
            errors = cdist(missing + values[given], values[taken], "sqeuclidean")
            if not errors.size or errors.min() > error - 1e-12:
                break
            out, into = np.unravel_index(errors.argmin(), errors.shape)
            chosen[given[out]] = False
            chosen[taken[into]] = True
        if error < least - 1e-12:
            best = chosen
            least = error
    return best
