"""Every motion is checked; batches too large for memory are halved; native rates are resampled."""

from __future__ import annotations

import dataclasses
from functools import partial

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from prbench.contract import Condition, ConditionBatch, Cost, Gaze, Motions
from prbench.errors import AdapterError, InputFileError, PredictionsError, TableError
from prbench.harness.methods.motions import (
    at_native_rate,
    coordinate_problem,
    generate_checked,
    native_frames,
    resampled,
)
from prbench.harness.planning import select
from prbench.harness.run import run_method
from prbench.harness.score_predictions import ScoreRequest, score_predictions
from tests import fakes
from tests.fakes import fake_sequence, smooth_motion
from tests.harness.test_run import request
from tests.harness.test_score_predictions import write
from tests.method_fixtures import adapter_source

IDS = ("rec/a", "rec/b", "rec/c")


def batch(n_frames=(4, 6, 5), *, fps=20.0, initial=None, previous=None) -> ConditionBatch:
    n = len(n_frames)
    given = {}
    condition = Condition.NONE
    if initial is not None:
        condition = Condition.GOAL_LOCATION
        given = {
            "text": ("",) * n,
            "initial_joints": initial,
            "previous_joints": previous,
            "goal_location": np.zeros((n, 3)),
        }
    return ConditionBatch(
        condition=condition,
        n_frames=np.array(n_frames),
        fps=fps,
        opaque_id=tuple(map(str, range(n))),
        noise_seed=tuple(range(n)),
        **given,
    )


class Method:
    """Walks with frame number and row along x; ``change`` spoils what it returns."""

    name = "method"
    conditions = frozenset({Condition.NONE})

    def __init__(self, change=lambda motions: motions, *, memory=100):
        self.change, self.memory, self.sizes = change, memory, []

    def generate(self, batch, *, seed):
        self.sizes.append(len(batch))
        if len(batch) > self.memory:
            raise MemoryError
        joints = np.zeros((len(batch), int(batch.n_frames.max()), 22, 3))
        joints[..., 0] = np.arange(joints.shape[1])[None, :, None]
        joints[..., 1] = np.array(batch.noise_seed)[:, None, None]
        return self.change(Motions(joints, batch.n_frames, Cost(10)))


def run(method, asked=None):
    return generate_checked(method, asked or batch(), seed=0, method="m", sequence_ids=IDS)


def test_good_motions_come_back_as_float32_without_surplus_frames_whatever_the_padding_holds():
    def longer(motions):
        joints = np.pad(motions.joints, ((0, 0), (0, 3), (0, 0), (0, 0)), constant_values=np.nan)
        joints[0, 4:] = np.nan
        return Motions(joints, motions.n_frames)

    motions, halvings = run(Method(longer))
    assert motions.joints.dtype == np.float32
    assert motions.joints.shape == (3, 6, 22, 3)
    assert halvings == 0


def spoilt(row, frame, value):
    def change(motions):
        motions.joints[row, frame, 7, 2] = value
        return motions

    return change


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300])
def test_nan_and_infinity_are_refused_with_method_sequence_and_frame(value):
    with pytest.raises(AdapterError, match=r"method 'm', sequence rec/b, frame 5: expected finite .* at joint 7"):
        run(Method(spoilt(1, 5, value)))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m.joints, "expected prbench.contract.Motions, found ndarray"),
        (lambda m: None, "found NoneType"),
        (lambda m: Motions(m.joints[:2], m.n_frames[:2]), r"expected joints of shape \(3, 6 or more, 22, 3\)"),
        (lambda m: Motions(m.joints, m.n_frames + 1), "sequence rec/a: expected 4 frames, found 5"),
        (lambda m: Motions(m.joints[:, :5], m.n_frames), "sequence rec/b: expected 6 frames, found 5 in joints"),
    ],
)
def test_wrong_types_shapes_and_lengths_are_refused(change, message):
    with pytest.raises(AdapterError, match=message):
        run(Method(change))


def unchecked(motions, **changes):
    """Motions with other fields, as without the type checks of the tests."""
    made = object.__new__(Motions)
    for name in ("joints", "n_frames", "cost"):
        object.__setattr__(made, name, changes.get(name, getattr(motions, name)))
    return made


class Tensor:
    """As torch's is called."""


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"joints": np.zeros((3, 6, 21, 3))}, r"found \(3, 6, 21, 3\) of float64"),
        ({"joints": np.zeros((3, 6, 22, 3), dtype=int)}, r"with decimals, found \(3, 6, 22, 3\) of int64"),
        ({"joints": [[[[0.0]]]]}, "expected joints as a NumPy array, found list"),
        ({"joints": Tensor()}, r"found .*Tensor\. Give joints\.detach\(\)\.cpu\(\)\.numpy\(\)"),
        ({"n_frames": [[4], [6, 5]]}, r"sequence rec/a: expected 4 frames, found n_frames of shape \(0,\)"),
        ({"cost": 7}, "expected cost as prbench.contract.Cost or None, found 7"),
    ],
)
def test_wrong_fields_are_refused_although_no_type_check_runs(changes, message):
    with pytest.raises(AdapterError, match=message):
        run(Method(lambda motions: unchecked(motions, **changes)))


def test_a_method_that_writes_into_its_batch_changes_nothing_but_its_own_copy():
    class Careless(Method):
        def generate(self, batch, *, seed):
            motions = super().generate(batch, seed=seed)
            changed = Motions(motions.joints.copy(), batch.n_frames)
            batch.n_frames[:] = 2
            batch.goal_location[:] = np.nan
            return changed

    asked = batch(initial=np.zeros((3, 22, 3)), previous=np.zeros((3, 22, 3)))
    with pytest.raises(AdapterError, match="sequence rec/a: expected 4 frames, found 2"):
        run(Careless(), asked)
    assert asked.n_frames.tolist() == [4, 6, 5]
    assert not np.isnan(asked.goal_location).any()


@pytest.mark.parametrize("error", [KeyError("weights"), SystemExit(3)])
def test_an_exception_of_the_method_is_named_with_the_batch(error):
    def fail(motions):
        raise error

    told = rf"failed: {type(error).__name__}: .* \(.*test_motions\.py, line \d+\)\. .* rec/a to rec/c\.$"
    with pytest.raises(AdapterError, match=told):
        run(Method(fail))


class Converts(Method):
    """A converter inside knows opaque ids alone."""

    def __init__(self, convert):
        super().__init__()
        self.convert = convert

    def generate(self, batch, *, seed):
        self.convert(f"row 1 (sequence {batch.opaque_id[1]})")
        return super().generate(batch, seed=seed)


def refuse(where):
    raise InputFileError("features", where, expected="263 numbers", found="251")


def opaque():
    return dataclasses.replace(batch(), opaque_id=("f00a", "f00b", "f00c"))


def test_what_a_converter_refuses_names_the_method_and_the_sequence_of_the_table():
    with pytest.raises(AdapterError, match=r"method 'm' failed: features, row 1 \(sequence rec/b\): expected 263"):
        run(Converts(refuse), opaque())


def test_a_batch_too_large_for_memory_is_halved_and_gives_the_same_motions():
    whole, _ = run(Method())
    method = Method(memory=1)
    halved, halvings = run(method)
    assert method.sizes == [3, 1, 2, 1, 1]
    assert halvings == 2
    assert halved.cost == Cost(30)
    assert np.array_equal(halved.n_frames, whole.n_frames)
    valid = np.arange(6) < whole.n_frames[:, None]
    assert np.array_equal(halved.joints[valid], whole.joints[valid])


@pytest.mark.parametrize("name", ["OutOfMemoryError", "RuntimeError"])
def test_torch_running_out_of_memory_counts_as_such(name):
    error = type(name, (RuntimeError,), {})("DefaultCPUAllocator: can't allocate memory: you tried 9 bytes")

    class Torch(Method):
        def generate(self, batch, *, seed):
            if len(batch) > 2:
                raise error
            return super().generate(batch, seed=seed)

    assert run(Torch())[1] == 1


def test_a_single_sequence_that_does_not_fit_is_an_error():
    with pytest.raises(AdapterError, match=r"out of memory on the single sequence rec/a\. Use"):
        run(Method(memory=0))


@pytest.mark.parametrize(("native", "frames"), [(30.0, 7), (20.0, 5), (10.0, 3), (7.0, 3)])
def test_native_frames_cover_the_whole_sequence(native, frames):
    assert native_frames(np.array([5]), fps=20.0, native_fps=native)[0] == frames  # 0.2 s


@pytest.mark.parametrize("native", [30.0, 20.0, 12.5, 60.0])
def test_a_motion_of_constant_velocity_survives_any_native_rate(native):
    asked = batch((41, 53))
    frames = native_frames(asked.n_frames, fps=20.0, native_fps=native)
    time = np.arange(frames.max()) / native
    joints = np.broadcast_to(time[None, :, None, None] * [1.0, 2.0, -1.0], (2, len(time), 22, 3)).copy()
    joints[0, frames[0] :] = np.nan  # padding must leave no trace
    back = resampled(Motions(joints, frames), asked.n_frames, step=native / 20.0)
    for row, n in enumerate(asked.n_frames):
        expected = np.arange(n)[:, None] / 20.0 * [1.0, 2.0, -1.0]
        inside = np.arange(n) / 20.0 <= (frames[row] - 1) / native + 1e-9
        assert inside.all()
        assert np.allclose(back.joints[row, :n, 5], expected, atol=1e-6)


def test_the_initial_velocity_keeps_its_value_at_another_rate():
    generator = np.random.default_rng(0)
    initial, previous = generator.normal(size=(2, 1, 22, 3)).astype(np.float32)
    asked = batch((41,), initial=initial, previous=previous)
    native = at_native_rate(asked, 30.0)
    assert (native.fps, native.n_frames[0]) == (30.0, 61)
    assert np.allclose((native.initial_joints - native.previous_joints) * 30, (initial - previous) * 20, atol=1e-4)


def test_a_method_with_its_own_rate_is_asked_at_it_and_answers_on_the_table_grid():
    class Native(Method):
        native_fps = 40.0

    motions, _ = run(Native())
    assert np.array_equal(motions.n_frames, [4, 6, 5])
    assert np.allclose(motions.joints[1, :, 0, 0], [0, 2, 4, 6, 8, 10])


class Seeing(Method):
    """Looks along z from 0.1 m before its head, which turns by a degree a frame."""

    gaze = True

    def generate(self, batch, *, seed):
        motions = super().generate(batch, seed=seed)
        turn = np.deg2rad(np.arange(motions.joints.shape[1]))
        direction = np.stack((np.sin(turn), np.zeros_like(turn), np.cos(turn)), axis=-1)
        rays = np.broadcast_to(direction, (len(batch), *direction.shape)).copy()
        origin = motions.joints[:, :, 15] + (0.0, 0.0, 0.1)
        return self.look(dataclasses.replace(motions, gaze=Gaze(origin, rays)))

    def look(self, motions):
        return motions


def test_gaze_comes_back_as_float32_with_its_motions_in_halves_too():
    motions, _ = run(Seeing())
    halved, halvings = run(Seeing(memory=2))
    assert halvings > 0
    for one in (motions, halved):
        assert one.gaze is not None
        assert one.gaze.direction.dtype == np.float32
        assert np.allclose(one.gaze.direction[1, 5], [np.sin(np.deg2rad(5)), 0, np.cos(np.deg2rad(5))])
        assert np.allclose(one.gaze.origin[2, 4], [4, 2, 0.1])


def test_gaze_at_another_rate_is_resampled_with_the_motion_and_keeps_length_one():
    method = Seeing()
    method.native_fps = 10.0
    motions, _ = run(method)
    assert motions.gaze is not None
    half = np.deg2rad(0.5)
    assert np.allclose(motions.gaze.direction[0, 1], [np.sin(half), 0, np.cos(half)], atol=1e-6)
    assert np.allclose(motions.gaze.origin[0, 1], [0.5, 0, 0.1])
    assert np.allclose(np.linalg.norm(motions.gaze.direction, axis=-1), 1, atol=1e-6)


def _changed(name, change):
    class Changed(Seeing):
        def look(self, motions):
            # Past the types of the constructor, which only tests check.
            object.__setattr__(motions.gaze, name, change(np.array(getattr(motions.gaze, name))))
            return motions

    return Changed()


def _with(place, value):
    def change(values):
        values[place] = value
        return values

    return change


@pytest.mark.parametrize(
    ("method", "reason"),
    [
        (_changed("direction", _with((1, 2), 0.0)), "b, gaze, frame 2: expected a gaze direction of length 1, found 0"),
        (_changed("direction", _with((1, 2, 0), np.nan)), "b, gaze, frame 2: expected a gaze direction of length 1"),
        (_changed("origin", _with((0, 3, 1), 0.5)), "a, gaze, frame 3: expected eyes within 0.3 m of the head joint"),
        (_changed("origin", lambda rays: rays[:, :3]), r"gaze.origin as a NumPy array of shape \(3, 6 or more, 3\)"),
        (_changed("direction", lambda rays: rays.astype(int)), r"with decimals, found \(3, 6, 3\) of int64"),
        (_changed("direction", lambda rays: rays.tolist()), "found list"),
    ],
)
def test_gaze_that_is_no_ray_from_its_head_is_refused_by_sequence_and_frame(method, reason):
    with pytest.raises(AdapterError, match=reason):
        run(method)


def test_padding_of_gaze_may_hold_anything():
    motions, _ = run(_changed("direction", _with((0, slice(4, None)), np.nan)))
    assert motions.gaze is not None


def test_gaze_is_declared_or_refused():
    silent = Seeing()
    silent.gaze = False
    with pytest.raises(AdapterError, match="expected motions without gaze, as it declares, found some"):
        run(silent)
    blind = Method()
    blind.gaze = True
    with pytest.raises(AdapterError, match="expected gaze with its motions, as it declares, found none"):
        run(blind)


MILLIMETRES = "positions are in millimetres. Multiply the joints by 0.001"


def with_value(value: float) -> np.ndarray:
    motion = smooth_motion("a", 12)
    motion[7, 20, 1] = value
    return motion


@pytest.mark.parametrize(
    ("motion", "told"),
    [
        (with_value(100.5), "frame 7: expected coordinates within 100 m of the origin, found ["),
        (with_value(-1e30), "at joint 20 (left wrist)."),
        (with_value(3e38), "frame 7: expected coordinates within 100 m of the origin, found ["),
        (with_value(np.nan), "frame 7: expected finite positions, found ["),
        (with_value(-np.inf), "frame 7: expected finite positions, found ["),
        (1000 * smooth_motion("a", 12), "positions are in millimetres. Multiply the joints by 0.001"),
        (100 * smooth_motion("a", 12), "positions are in centimetres. Multiply the joints by 0.01"),
        (smooth_motion("a", 12) + np.array([97.0, 0.0, -97.0]), "None"),
        (with_value(99.9), "None"),  # much too fast, which is for the scores to tell
    ],
)
def test_what_no_room_holds_is_named_with_frame_joint_and_unit(motion, told):
    assert told in str(coordinate_problem(motion))


@pytest.mark.parametrize("isolate", [False, True])
def test_a_run_refuses_millimetres_with_method_sequence_and_frame(install, table, tmp_path, isolate):
    body = "joints[:] = batch.initial_joints[:, None] * 1000"
    install("made", adapter_source(body=body))
    asked = request(table, tmp_path / "out", "made", condition=Condition.GOAL_LOCATION, limit=2, isolate=isolate)
    with pytest.raises(AdapterError, match=rf"made'.*synthetic-adt/rec.*, frame 0: expected .* 100 m .*{MILLIMETRES}"):
        run_method(asked)


def motions_of(table, factor: float) -> dict[str, np.ndarray]:
    ids = select(table, split="test", limit=None).sequence_ids
    return {name: factor * fake_sequence(int(name.split("/obj")[1].split("/")[0])).joints for name in ids}


def test_scoring_a_file_refuses_millimetres_and_names_file_sequence_and_frame(table, tmp_path):
    file = write(tmp_path / "mine.parquet", motions_of(table, 1000.0))
    with pytest.raises(PredictionsError, match=rf"mine\.parquet, synthetic-adt/.*, frame 0: .*{MILLIMETRES}"):
        score_predictions(ScoreRequest(predictions=file, data=(table.folder,)))


def spoil_part(folder, change) -> None:
    """Rewrite the first part of a run and forget its scores."""
    part = sorted((folder / "synthetic-adt/predictions").glob("*.parquet"))[0]
    rows = pq.read_table(part)
    joints = [change(np.array(row)).tolist() for row in rows["joints"].to_pylist()]
    column = rows.schema.get_field_index("joints")
    field = rows.schema.field(column)
    spoilt = rows.set_column(column, field, pa.array(joints, field.type))
    pq.write_table(spoilt, part, write_page_checksum=True)
    (folder / "synthetic-adt/scores.parquet").unlink()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda motion: motion[:1], "expected [0-9]+ frames, found 1 .*A run keeps no such motion of a method"),
        (lambda motion: motion * 1e30, "frame 0: expected coordinates within 100 m .*A run keeps no such motion"),
    ],
)
def test_a_kept_motion_that_no_run_would_keep_is_told_with_its_method(table, tmp_path, change, message):
    run_method(request(table, tmp_path / "out"))
    spoil_part(tmp_path / "out", change)
    for again in (
        lambda: run_method(request(table, tmp_path / "out")),
        lambda: score_predictions(ScoreRequest(predictions=tmp_path / "out", data=(table.folder,))),
    ):
        with pytest.raises(PredictionsError, match=rf"^method 'static', sequence .* in .*part-00000.*{message}"):
            again()


def test_a_recording_of_one_frame_is_blamed_on_the_table(tmp_path, monkeypatch):
    monkeypatch.setattr(fakes, "fake_sequence", partial(fakes.fake_sequence, n_frames=1))
    short = fakes.fake_dataset(tmp_path / "table", 8)
    with pytest.raises(TableError, match=r"table, synthetic-adt/.*: expected 2 frames or more, found 1\. Build"):
        run_method(request(short, tmp_path / "out"))
