"""Splits: stored lists of public names, and a draw over all recordings of a table."""

import csv
import hashlib
import json
import random
from collections import Counter
from importlib import resources
from itertools import combinations

import msgspec
import numpy as np
import pytest

from prbench.curation.splits import balanced_choice, draw_splits
from prbench.protocol.manifests import load_manifest, load_protocol
from prbench.randomness import hash_fraction
from prbench.sequences.sequence import Recording

RULE = load_protocol().splits
UNLISTED = load_manifest("hot3d")
LISTS = ("hd-epic", "mogaze")


def recording(name, seconds, person="P0", *, group=None, split=""):
    return Recording(name, person, split, group or name, float(seconds), {}, "read", "")


def shares(recordings, splits):
    """Share of the length in each split."""
    seconds = Counter()
    for each in recordings:
        seconds[splits[each.recording_id]] += each.duration
    return {name: value / sum(seconds.values()) for name, value in seconds.items()}


def many(count, *, people=9, seed=0):
    generator = np.random.default_rng(seed)
    lengths = generator.gamma(2.0, 60.0, count) + 1
    return [recording(f"r{i:03d}", lengths[i], f"P{generator.integers(people)}") for i in range(count)]


def rows_of(dataset):
    text = (resources.files("prbench_data_manifests") / "splits" / f"{dataset}.csv").read_text("utf-8")
    return list(csv.DictReader(line for line in text.splitlines() if not line.startswith("#")))


@pytest.mark.parametrize(
    ("dataset", "counts"),
    [
        ("hd-epic", {"train": 98, "validation": 11, "test": 47}),  # the study: 109 and 47
        ("mogaze", {"train": 5, "validation": 1, "test": 5}),
    ],
)
def test_a_stored_list_names_each_recording_once_and_keeps_groups_whole(dataset, counts):
    rows = rows_of(dataset)
    names = [row["recording_id"] for row in rows]
    assert len(names) == len(set(names)) == sum(counts.values())
    assert Counter(row["split"] for row in rows) == counts
    assert len({(row["split_group"], row["split"]) for row in rows}) == len({row["split_group"] for row in rows})
    assert load_manifest(dataset).splits == {row["recording_id"]: row["split"] for row in rows}


def test_the_list_of_hd_epic_is_drawn_from_the_public_annotations(samples):
    videos = json.loads((samples / "hd-epic-official/assoc_info.json").read_text())
    tracks = {name: sum(len(each["tracks"]) for each in video.values()) for name, video in videos.items()}
    rows = {row["recording_id"]: row for row in rows_of("hd-epic")}
    assert rows.keys() == tracks.keys()
    without = {"P02-20240210-113925", "P02-20240211-182630", "P06-20240510-140459"}
    names = sorted(tracks.keys() - without, key=lambda name: hash_fraction("hd-epic", name))
    people = sorted({row["participant_id"] for row in rows.values()})
    lengths = np.array([[tracks[name] * (name[:3] == person) for person in people] for name in names], dtype=float)
    tested = balanced_choice(lengths, lengths.sum(axis=0) * 5492 / 18134, 47)
    rest = np.flatnonzero(~tested)
    held = rest[balanced_choice(lengths[rest], lengths.sum(axis=0) * RULE.validation, 11)]
    assert {names[i] for i in np.flatnonzero(tested)} == {n for n, row in rows.items() if row["split"] == "test"}
    assert {names[i] for i in held} == {n for n, row in rows.items() if row["split"] == "validation"}
    assert lengths[tested].sum() / lengths.sum() == pytest.approx(5492 / 18134, abs=0.0005)


@pytest.mark.parametrize("dataset", LISTS)
def test_a_partial_copy_moves_no_listed_recording(dataset):
    manifest = load_manifest(dataset)
    whole = [recording(name, 60) for name in manifest.splits]
    assert draw_splits(whole, manifest, RULE) == manifest.splits
    assert draw_splits(whole[::7], manifest, RULE) == {
        each.recording_id: manifest.splits[each.recording_id] for each in whole[::7]
    }


@pytest.mark.parametrize(("count", "tested"), [(40, 12), (137, 41), (236, 71)])
def test_a_draw_holds_its_share_of_the_length_of_all_and_of_everybody(count, tested):
    recordings = many(count)
    splits = draw_splits(recordings, UNLISTED, RULE)
    assert Counter(splits.values())["test"] == tested
    found = shares(recordings, splits)
    assert found["test"] == pytest.approx(0.30, abs=0.01)
    assert found["validation"] == pytest.approx(0.07, abs=0.02)
    for person in {each.participant_id for each in recordings}:
        own = [each for each in recordings if each.participant_id == person]
        assert shares(own, splits).get("test", 0.0) == pytest.approx(0.30, abs=0.15)


def test_a_draw_follows_from_the_recordings_alone_not_from_their_order_or_clock():
    recordings = many(60)
    first = draw_splits(recordings, UNLISTED, RULE)
    mixed = random.Random(5).sample(recordings, len(recordings))
    assert draw_splits(mixed, UNLISTED, RULE) == first
    rounded = [recording(each.recording_id, round(each.duration), each.participant_id) for each in recordings]
    assert draw_splits(rounded, UNLISTED, RULE) == first
    assert draw_splits(recordings, load_manifest("adt"), RULE) != first, "other names, another draw"


@pytest.mark.parametrize(
    ("lengths", "tested"),
    [
        ((100,) * 10, 3),
        ((450, 1400, 1500, 1500, 1500, 1500, 700, 800, 500, 500, 500), 6),  # short ones make room for more
        ((10,) * 12 + (300,), 9),  # nine at least, where they fit
        ((100,), 1),
        ((100, 100), 1),
    ],
)
def test_the_test_part_holds_as_many_recordings_as_fit_up_to_nine(lengths, tested):
    recordings = [recording(f"r{i}", seconds, f"P{i % 4}") for i, seconds in enumerate(lengths)]
    splits = draw_splits(recordings, UNLISTED, RULE)
    assert Counter(splits.values())["test"] == tested


def test_exchanges_of_pairs_come_as_near_as_trying_every_choice():
    for seed in range(5):
        lengths = np.random.default_rng(seed).integers(40, 300, 10).astype(float)[:, None]
        wanted = lengths.sum(axis=0) * 0.3
        found = abs(lengths[balanced_choice(lengths, wanted, 4)].sum() - wanted[0])
        best = min(abs(sum(each) - wanted[0]) for each in combinations(lengths[:, 0], 4))
        assert found <= best + 5.0


def test_recordings_of_one_group_share_a_split_and_one_that_was_not_read_has_no_say():
    twins = [recording(f"{side}{i}", 60 + i, f"P{i % 5}{side}", group=f"a{i}") for i in range(30) for side in "ab"]
    splits = draw_splits(twins, UNLISTED, RULE)
    assert all(splits[f"a{i}"] == splits[f"b{i}"] for i in range(30))
    failed = Recording("c", "unknown", "", "c", 0.0, {}, "failed", "damaged")
    assert draw_splits([*twins, failed], UNLISTED, RULE) == splits | {"c": "train"}


def test_a_list_names_a_twin_through_the_other_and_own_splits_stay():
    listed = msgspec.structs.replace(UNLISTED, splits={"b0": "test", "x": "train"})
    named = [recording("a0", 60, group="a0"), recording("b0", 60, group="a0"), recording("x", 60)]
    assert draw_splits(named, listed, RULE) == {"a0": "test", "b0": "test", "x": "train"}
    own = [recording("x", 60, split="validation"), recording("y", 60, split="test")]
    assert draw_splits(own, listed, RULE) == {"x": "validation", "y": "test"}
    assert draw_splits([recording("x", 60), recording("new", 60)], listed, RULE) == {"x": "train", "new": "train"}


def test_the_hash_fraction_of_a_known_name() -> None:
    leading = hashlib.sha256(b"adt/a").digest()[0]
    assert hash_fraction("adt", "a") == pytest.approx(leading / 256, abs=1 / 256)
