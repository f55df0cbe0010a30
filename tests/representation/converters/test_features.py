"""From the output of a HumanML3D model to joints."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.errors import InputFileError
from prbench.representation import Statistics, canonicalise, encode
from prbench.representation.converters import (
    check_features,
    feature_rows,
    features,
    joints_from_features,
    motions_from_features,
    on_body_of,
    placed_on,
    read_feature_statistics,
    relative_root,
)
from prbench.representation.encoding import retarget
from tests.representation.converters.bodies import person

FEATURES = encode(person())


def test_as_many_rows_as_frames_decode_to_the_motion() -> None:
    assert np.allclose(joints_from_features(FEATURES), person()[:-1], atol=1e-5)


def test_the_frame_that_encoding_loses_comes_back_from_the_last_row_s_velocities() -> None:
    assert len(FEATURES) == len(person()) - 1
    whole = joints_from_features(FEATURES, len(person()))
    assert np.allclose(whole, person(), atol=1e-5)
    assert np.linalg.norm(whole[-1] - whole[-2]) > 1e-4  # it is no copy


def test_rows_behind_the_sequence_are_padding() -> None:
    padded = np.concatenate([FEATURES[:60], np.full((30, 263), np.nan, dtype=np.float32)])
    assert np.array_equal(joints_from_features(padded, 60), joints_from_features(FEATURES[:60]))


def test_a_model_of_the_uniform_skeleton_comes_back_to_the_person_s_body() -> None:
    uniform = canonicalise(retarget(person()))
    decoded = joints_from_features(encode(uniform), len(uniform))
    own = placed_on(on_body_of(decoded, person()[0]), person()[0])
    assert np.abs(decoded - person()).max() > 0.04  # without the change of body joints are off by centimetres
    assert np.abs(own - person()).max() < 2e-4


@pytest.mark.parametrize(
    "layout",
    [
        lambda rows: rows[None],
        lambda rows: rows,
        lambda rows: rows.T[None, :, None, :],  # MDM
        lambda rows: rows.T[None],
    ],
)
def test_every_common_layout_is_understood(layout) -> None:
    assert np.array_equal(feature_rows(layout(FEATURES)), FEATURES[None])


def absolute(features: np.ndarray) -> np.ndarray:
    """Heading and place of each row, as GMD has them, by a loop over the definition."""
    rows = features.astype(np.float64)
    heading, place = 0.0, np.zeros(2)
    out = rows.copy()
    for index in range(len(rows)):
        out[index, :3] = heading, *place
        heading += rows[index, 0]
        c, s = np.cos(2 * heading), np.sin(2 * heading)
        x, z = rows[index, 1:3]  # seen from the next heading: turned back by it
        place = place + np.array([c * x - s * z, s * x + c * z])
    return out


def test_absolute_roots_decode_to_the_same_motion() -> None:
    joints = joints_from_features(absolute(FEATURES).astype(np.float32), root="absolute")
    assert np.allclose(joints, person()[:-1], atol=1e-4)


def test_an_absolute_root_that_starts_elsewhere_is_moved_to_the_origin() -> None:
    shifted = absolute(FEATURES)
    turn, there = 0.4, np.array([2.0, -1.0])  # half angle, metres
    c, s = np.cos(2 * turn), np.sin(2 * turn)
    x, z = shifted[:, 1].copy(), shifted[:, 2].copy()
    shifted[:, 0] += turn
    shifted[:, 1], shifted[:, 2] = c * x - s * z + there[0], s * x + c * z + there[1]
    assert np.allclose(relative_root(shifted)[:-1, :3], FEATURES[:-1, :3], atol=1e-6)


def test_absolute_taken_for_relative_is_noticed() -> None:
    with pytest.raises(InputFileError, match="root='absolute'"):
        joints_from_features(absolute(FEATURES).astype(np.float32))


def test_statistics_are_read_and_zeros_become_one(tmp_path) -> None:
    mean, std = np.arange(263, dtype=np.float64), np.ones(263)
    std[4] = 0.0
    np.save(tmp_path / "Mean.npy", mean)
    np.save(tmp_path / "Std.npy", std)
    statistics = read_feature_statistics(tmp_path / "Mean.npy", tmp_path / "Std.npy")
    assert statistics.mean.dtype == np.float32
    assert statistics.std[4] == 1.0
    restored = statistics.restore(np.full((2, 263), 2.0, dtype=np.float32))
    assert np.allclose(restored, mean + 2)


@pytest.fixture(scope="module")
def released(samples) -> Statistics:
    """The statistics that the dataset publishes."""
    folder = samples / "humanml3d"
    return read_feature_statistics(folder / "Mean.npy", folder / "Std.npy")


def test_statistics_of_the_evaluator_are_noticed_both_ways(released) -> None:
    evaluator = released.for_evaluator()
    check_features(released.restore(released.standardise(FEATURES)))
    with pytest.raises(InputFileError, match="with the statistics of another model"):
        joints_from_features(evaluator.restore(released.standardise(FEATURES)))
    with pytest.raises(InputFileError, match="with the statistics of another model"):
        joints_from_features(released.restore(evaluator.standardise(FEATURES)))


def test_a_still_body_shows_foreign_statistics_by_its_contacts(released) -> None:
    still = encode(np.repeat(person()[:1], 40, axis=0))
    centred = Statistics(np.zeros(263, dtype=np.float32), released.std)
    with pytest.raises(InputFileError, match="columns 259 to 262: expected foot contacts near 0 or 1"):
        joints_from_features(centred.restore(centred.for_evaluator().standardise(still)))


def test_features_that_were_never_restored_are_noticed(released) -> None:
    for start in (300, 420, 700, 1100, 1240, 1500):  # walking from 420 and from 1240, standing otherwise
        with pytest.raises(InputFileError, match="never restored"):
            joints_from_features(released.standardise(encode(person(120, start))))


def test_a_body_that_stands_still_is_no_reason_to_complain() -> None:
    still = np.repeat(person()[:1], 40, axis=0)
    assert np.allclose(joints_from_features(encode(still), 40), still, atol=1e-5)


def unlike(features: np.ndarray, *, times: float) -> np.ndarray:
    """The same motion with root steps that do not belong to it; contacts say nothing."""
    changed = features.copy()
    changed[:, 1:3] *= times
    return changed


# At 20 frames a second. A person of the kitchen stands for most of the time; at sample 1,000 a way begins.
WALKING = encode(person(606, 1000)[::6])


@pytest.mark.parametrize("rows", [50, len(WALKING)])
def test_the_person_who_is_to_walk_walks(rows) -> None:
    """Slower pelvises have no vote on steps, so that the tests below would ask nothing."""
    steps = np.linalg.norm(WALKING[:rows, 1:3], axis=1)
    assert steps.mean() > features._WALKS


def test_a_single_motion_whose_steps_disagree_is_kept() -> None:
    batch = np.stack([WALKING] * 15 + [unlike(WALKING, times=4.0)])
    motions = motions_from_features(batch, [len(WALKING)] * 16, source="glide")
    assert np.array_equal(motions[0], joints_from_features(WALKING))
    assert np.array_equal(motions[15], joints_from_features(unlike(WALKING, times=4.0), check=False))


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_motions_whose_steps_alone_disagree_are_kept(count) -> None:
    assert len(motions_from_features([unlike(WALKING, times=0.3)] * count, [50] * count, source="glide")) == count


@pytest.mark.parametrize(
    "convert", [joints_from_features, lambda one, **given: motions_from_features([one], [50], **given)]
)
def test_one_motion_whose_steps_differ_by_more_than_ten_says_how_to_go_on(convert) -> None:
    alone = unlike(WALKING, times=12.0)[:50]
    going_on = r"columns 1 and 2: .* go on with motions_from_features\(\.\.\., check=False\)"
    with pytest.raises(InputFileError, match=going_on):
        convert(alone)
    assert np.isfinite(convert(alone, check=False)).all()


def test_a_batch_whose_steps_disagree_is_refused_with_the_way_on() -> None:
    batch = [unlike(WALKING, times=4.0)] * 9 + [WALKING] * 7
    with pytest.raises(InputFileError, match=r"glide, row 0 \(sequence a\), columns 1 and 2: .*check=False") as refused:
        motions_from_features(batch, [50] * 16, source="glide", sequences=["a", *"bcdefghijklmnop"])
    assert "likewise in 9 of 16 motions" in str(refused.value)
    assert len(motions_from_features(batch, [50] * 16, source="glide", check=False)) == 16


def test_people_who_stand_have_no_vote() -> None:
    standing = encode(np.repeat(person()[:1], len(person()), axis=0))
    batch = [standing] * 20 + [unlike(WALKING, times=4.0)] * 4
    with pytest.raises(InputFileError, match="likewise in 4 of 4 motions"):
        motions_from_features(batch, [50] * 24)


def test_one_motion_of_many_that_flies_or_has_odd_contacts_is_kept() -> None:
    flying, odd = WALKING.copy(), WALKING.copy()
    flying[:, 4:67] += np.random.default_rng(0).normal(size=(len(WALKING), 63))
    odd[:, 259:] *= 9
    assert len(motions_from_features([flying, odd, *[WALKING] * 3], [50] * 5, source="glide")) == 5
