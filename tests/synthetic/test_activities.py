"""Invented people who do everyday things: believable, reproducible, and truly described."""

from __future__ import annotations

import itertools
import re

import numpy as np
import pytest

from prbench.geometry.skeleton import WRISTS, Joint
from prbench.synthetic.activities import NarratedMotion, identity_of, narrated_recording
from prbench.synthetic.activities.narrate import PATTERNS, amount_word, speed_word, spoken_name
from prbench.synthetic.activities.script import SITTING, STANDING
from prbench.synthetic.people import PRESETS
from tests.synthetic.plausibility import LIMITS, implausible, measure_motions

SEED = 11


@pytest.fixture(scope="module")
def recordings() -> list[NarratedMotion]:
    """Nine recordings of activities and three of picks and puts."""
    return [narrated_recording(SEED, index) for index in range(12)]


def clips_of(motions: list[NarratedMotion], *activities: str):
    """(motion, narration, joints of the span) of the atomic actions that consist of one of the activities."""
    for motion in motions:
        for row in motion.narrations:
            if row.kind == "atomic_action" and len(row.activities) == 1 and row.activities[0] in activities:
                first, last = (round(time * motion.rate) for time in (row.start, row.end))
                yield motion, row, motion.joints[first : last + 1]


def heading(joints: np.ndarray) -> np.ndarray:
    """From the hips, unwrapped, radians."""
    across = joints[:, Joint.LEFT_HIP] - joints[:, Joint.RIGHT_HIP]
    return np.unwrap(np.arctan2(-across[:, 2], across[:, 0]))


def words(text: str) -> set[str]:
    return set(re.findall(r"[a-z]+", text.lower()))


def test_motions_are_plausible(recordings):
    activities = [motion for index, motion in enumerate(recordings) if index % 4 != 3]
    clips = [joints[::12] for _, _, joints in clips_of(activities, *PATTERNS)]
    limits = {**LIMITS, "planted_slide": (-1.0, 1e-3)}  # brisk walks stretch the leg: some tenths of a millimetre
    assert implausible(measure_motions(activities, clips), limits) == {}


def test_every_activity_has_its_patterns():
    for name, patterns in PATTERNS.items():
        assert len(set(patterns)) >= (12 if name in ("pick", "put") else 8), name
    assert len(STANDING) + len(SITTING) > 20


def test_the_vocabulary_has_about_four_hundred_words():
    known = {word for patterns in PATTERNS.values() for text in patterns for word in words(re.sub(r"{\w+}", " ", text))}
    things = {spoken_name(kind.name) for preset in PRESETS.values() for kind in preset.objects}
    assert 320 < len(known | words(" ".join(things))) < 500


def test_texts_are_sentences_about_the_wearer(recordings):
    texts = [row.texts[0] for motion in recordings for row in motion.narrations if row.kind == "atomic_action"]
    assert all(re.fullmatch(r"(C|The person) [a-z][^{}]*\.", text) for text in texts)
    assert not any("  " in text or " ." in text or " ," in text for text in texts)
    share = np.mean([text.startswith("C ") for text in texts])
    assert 0.65 < share < 0.95


def test_narrations_last_three_to_five_seconds_and_do_not_overlap(recordings):
    spans = []
    for motion in recordings:
        rows = [row for row in motion.narrations if row.kind == "atomic_action"]
        spans += [(row.start, row.end) for row in rows]
        assert all(one.end <= other.start + 1e-9 for one, other in itertools.pairwise(rows))
        assert rows[0].start == pytest.approx(0.215, abs=0.011)
        assert all(row.end <= motion.duration for row in motion.narrations)
    lengths = np.diff(spans, axis=1)
    assert lengths.max() <= 5.0 + 1e-9
    assert np.median(lengths) > 3.0
    assert (lengths > 2.0).mean() > 0.9


def test_left_and_right_are_what_the_body_does(recordings):
    seen = 0
    for _, row, joints in clips_of(recordings, "turn", "walk turning", "curve"):
        turned = heading(joints)[-1] - heading(joints)[0]
        said = words(row.texts[0]) & {"left", "right"}
        assert not said or said == {"left" if turned > 0 else "right"}, row.texts[0]
        seen += len(said)
    assert seen > 10


def test_sidesteps_go_where_the_words_say(recordings):
    for _, row, joints in clips_of(recordings, "sidestep"):
        left = joints[0, Joint.LEFT_HIP] - joints[0, Joint.RIGHT_HIP]
        moved = (joints[-1] - joints[0])[Joint.PELVIS] @ left
        said = words(row.texts[0]) & {"left", "right"}
        assert not said or said == {"left" if moved > 0 else "right"}, row.texts[0]


def test_the_hand_of_the_words_is_the_hand_that_moves(recordings):
    seen = 0
    for _, row, joints in clips_of(recordings, "wave", "wipe", "stir", "scratch head", "reach"):
        said = words(row.texts[0]) & {"left", "right"}
        moved = joints[:, WRISTS] - joints[:, [Joint.PELVIS]]
        way = np.linalg.norm(np.diff(moved, axis=0), axis=-1).sum(axis=0)
        if said:
            assert said == {"left" if way[0] > way[1] else "right"}, row.texts[0]
            seen += 1
    assert seen > 8


def test_speed_words_fit_the_pelvis(recordings):
    seen = 0
    for motion, row, joints in clips_of(recordings, "walk straight", "walk turning"):
        step = round(0.1 * motion.rate)
        speed = np.linalg.norm(np.diff(joints[::step, Joint.PELVIS][:, [0, 2]], axis=0), axis=1) / 0.1
        plateau = float(np.median(speed[speed > 0.5 * speed.max()]))
        if "slowly" in row.texts[0]:
            assert plateau < 0.72
            seen += 1
        if "briskly" in row.texts[0]:
            assert plateau > 1.22
            seen += 1
    assert seen > 3


def test_borders_of_the_words_are_those_of_the_page():
    assert [speed_word(speed) for speed in (0.69, 0.71, 1.24, 1.26)] == ["slowly", "", "", "briskly"]
    assert [amount_word(angle) for angle in (59.0, 61.0, 134.0, 136.0)] == ["slightly", "", "", "around"]


def test_sitting_people_sit_and_standing_up_ends_it(recordings):
    seen = 0
    for motion, _, joints in clips_of(recordings, "sit", "sit down", "stand up"):
        standing = float(np.median(motion.joints[:40, Joint.PELVIS, 1]))
        height = joints[:, Joint.PELVIS, 1]
        assert height.min() < 0.75 * standing
        seen += 1
    assert seen > 2


def test_a_quarter_of_the_recordings_picks_and_puts(recordings):
    kinds = [{name for row in motion.narrations for name in row.activities} & {"pick", "put"} for motion in recordings]
    assert [bool(kind) for kind in kinds] == [index % 4 == 3 for index in range(12)]
    texts = [row.texts[0] for _, row, _ in clips_of(recordings, "pick", "put")]
    assert len(texts) > 10
    assert len(set(texts)) > 10


def test_test_people_never_appear_in_training():
    casts = [identity_of(SEED, index) for index in range(200)]
    people = {split: {cast.participant_id for cast in casts if cast.split == split} for split in ("train", "test")}
    assert people["train"]
    assert people["test"]
    assert not people["train"] & people["test"]
    assert len({cast.recording_id for cast in casts}) == 200


@pytest.mark.parametrize(
    ("name", "spoken"),
    [("cup_red", "red cup"), ("BlackCeramicMug", "black ceramic mug"), ("egg box", "egg box"), ("jug", "jug")],
)
def test_objects_are_spoken_of_in_words(name, spoken):
    assert spoken_name(name) == spoken
