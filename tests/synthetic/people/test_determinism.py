"""Equal arguments, equal arrays; and nothing else matters."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys

import numpy as np
import pytest

from prbench.errors import UsageError
from prbench.synthetic.people import perform
from prbench.synthetic.performance import Performance


def digest(performance: Performance) -> str:
    sha = hashlib.sha256()
    tracks = [array for item in performance.objects for array in (item.position, item.rotation)]
    for array in (performance.joints, performance.rotations, performance.eye, performance.gaze, *tracks):
        sha.update(np.ascontiguousarray(array).tobytes())
    sha.update(repr([(e.event_id, e.event_time, e.prime_time, e.tag) for e in performance.events]).encode())
    return sha.hexdigest()


def act(index: int, **changes: object) -> Performance:
    arguments: dict = {"seed": 11, "index": index, "n_events": 4, "rate": 30.0} | changes
    return perform("adt", **arguments)


def test_equal_arguments_give_identical_arrays_whatever_was_performed_before() -> None:
    first = digest(act(4))
    act(0), perform("mogaze", seed=11, index=4, n_events=2, rate=30.0)
    assert digest(act(4)) == first


def test_another_process_with_another_hash_seed_gives_the_same() -> None:
    code = (
        "from prbench.synthetic.people import perform; import hashlib, numpy as np;"
        "p = perform('adt', seed=11, index=1, n_events=2, rate=30.0);"
        "print(hashlib.sha256(np.ascontiguousarray(p.joints).tobytes()).hexdigest())"
    )
    # All other variables stay: OPENBLAS_CORETYPE, where it is set, changes the last digits of matrix products.
    environment = os.environ | {"PYTHONHASHSEED": "7"}
    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
    here = perform("adt", seed=11, index=1, n_events=2, rate=30.0)
    assert printed.stdout.strip() == hashlib.sha256(np.ascontiguousarray(here.joints).tobytes()).hexdigest()


@pytest.mark.parametrize("change", [{"index": 5}, {"seed": 12}, {"world": "large"}])
def test_index_seed_and_world_each_change_the_recording(change: dict) -> None:
    assert digest(act(4)) != digest(act(**({"index": 4} | change)))


def test_the_rate_changes_how_often_a_recording_is_sampled_not_what_happens() -> None:
    slow, fast = act(4), act(4, rate=60.0)
    assert [e.event_id for e in slow.events] == [e.event_id for e in fast.events]
    joints = fast.joints[::2][: len(slow.joints)]
    assert np.abs(joints - slow.joints[: len(joints)]).max() < 0.05


def test_ids_are_sixteen_digits_and_distinct_within_a_recording() -> None:
    ids = [item.object_id for item in act(4).objects]
    assert len(set(ids)) == len(ids)
    assert all(len(number) == 16 and number.isdecimal() for number in ids)


def test_recording_ids_are_unique_per_seed_and_index() -> None:
    ids = {act(index, seed=seed, n_events=1).recording_id for index in (0, 1) for seed in (1, 2)}
    assert len(ids) == 4


def test_as_many_bystander_objects_as_asked_for() -> None:
    untouched = [item for item in act(4, bystander_objects=40).objects if item.movable and len(item.position) == 1]
    assert len(untouched) >= 40


def test_unknown_presets_are_refused_with_the_known_ones() -> None:
    with pytest.raises(UsageError, match="hd-epic"):
        perform("adtt", seed=0, index=0)
