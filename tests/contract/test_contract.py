"""The contract that a third party meets: what a batch accepts, what motions mean, and how samplers obey noise seeds."""

from __future__ import annotations

import contextlib
import dataclasses
import random
import subprocess
import sys

import numpy as np
import pytest
import torch

from prbench.contract import GIVEN, Condition, ConditionBatch, Motions, batch_noise, sequence_noise


def fields_of(condition: Condition, n: int = 3) -> dict:
    pose = np.arange(n * 66, dtype=np.float32).reshape(n, 22, 3)
    made = {
        "text": tuple("abc"[:n]),
        "initial_joints": pose,
        "previous_joints": pose + 1000,
        "goal_joints": pose + 2000,
        "goal_location": pose[:, 0] + 3000,
    }
    return {name: made[name] for name in GIVEN[condition]}


def batch(condition: Condition, n: int = 3, **changes) -> ConditionBatch:
    common = {
        "condition": condition,
        "n_frames": np.arange(50, 50 + n),
        "fps": 20.0,
        "opaque_id": tuple("xyz"[:n]),
        "noise_seed": tuple(range(n)),
    }
    return ConditionBatch(**{**common, **fields_of(condition, n), **changes})


@pytest.mark.parametrize("condition", Condition)
def test_a_field_that_the_condition_gives_must_be_there(condition):
    for name in GIVEN[condition]:
        with pytest.raises(ValueError, match=rf"'{name}' must be given"):
            batch(condition, **{name: None})


@pytest.mark.parametrize("condition", Condition)
def test_a_field_that_the_condition_does_not_give_must_not_be_there(condition):
    everything = fields_of(Condition.GOAL_POSE) | fields_of(Condition.GOAL_LOCATION)
    for name in everything.keys() - GIVEN[condition]:
        with pytest.raises(ValueError, match=rf"'{name}' must not be given"):
            batch(condition, **{name: everything[name]})


def test_rows_of_different_number_are_refused():
    with pytest.raises(ValueError, match=r"'text' has 2 rows, the batch has 3"):
        batch(Condition.TEXT, text=("a", "b"))
    with pytest.raises(ValueError, match=r"one entry a sequence"):
        batch(Condition.NONE, noise_seed=(1, 2))


@pytest.mark.parametrize("condition", Condition)
def test_a_part_of_a_batch_is_complete_in_itself(condition):
    whole = batch(condition)
    part = whole.rows(1, 3)
    assert len(part) == 2
    for field in dataclasses.fields(part):
        mine, theirs = getattr(part, field.name), getattr(whole, field.name)
        expected = theirs[1:3] if isinstance(theirs, tuple | np.ndarray) else theirs
        assert np.array_equal(mine, expected)


def test_motions_leave_their_padding_out():
    joints = np.full((2, 4, 22, 3), np.nan)
    joints[0, :2], joints[1, :4] = 1.0, 2.0
    ragged = Motions(joints, np.array([2, 4])).ragged()
    assert ragged[:, 0, 0].tolist() == [1, 1, 2, 2, 2, 2]


SEEDS = (3, 2**63 - 1, 40, 0)


def draws() -> list[float]:
    """One number of every global generator."""
    return [float(torch.rand(1)), float(np.random.rand()), random.random()]  # noqa: NPY002


def sample(n: int, *, steps: int = 3) -> torch.Tensor:
    """A sampler as public ones are: noise at the start and in every step, from torch's global generator."""
    x = torch.randn(n, 5, 1, 7)
    for _ in range(steps):
        x = 0.5 * x + torch.randn_like(x)
    return x


def test_what_is_drawn_depends_on_the_seed_alone() -> None:
    found = []
    for before in (0, 5):
        torch.rand(before), np.random.rand(before), random.seed(before)  # noqa: NPY002
        with sequence_noise(SEEDS[1]):
            found.append(draws())
    assert found[0] == found[1]
    with sequence_noise(SEEDS[0]):
        assert all(one != other for one, other in zip(draws(), found[0], strict=True))


def test_seeds_that_differ_in_the_upper_half_alone_draw_other_numbers() -> None:
    found = []
    for seed in (7, 7 + 2**40):
        with sequence_noise(seed):
            found.append(draws())
    assert found[0][1] != found[1][1]
    assert found[0][2] != found[1][2]
    assert found[0][0] == found[1][0], "torch takes the lower 32 bits on the CPU; say otherwise in the docstring"


@pytest.mark.unchecked_shapes  # checking arguments draws from `random`
@pytest.mark.parametrize("block", [lambda: sequence_noise(9), lambda: batch_noise((9, 10))])
def test_behind_the_block_generators_go_on_as_if_nothing_had_been_drawn(block) -> None:
    torch.manual_seed(1), np.random.seed(1), random.seed(1)  # noqa: NPY002
    expected = [draws(), draws()][1]
    torch.manual_seed(1), np.random.seed(1), random.seed(1)  # noqa: NPY002
    draws()
    with contextlib.suppress(KeyError), block():
        draws()
        raise KeyError  # a sampler that fails leaves nothing behind either
    assert draws() == expected
    assert torch.randn.__module__ != "prbench.contract"


def test_a_row_gets_the_same_motion_in_any_batch() -> None:
    with batch_noise(SEEDS):
        together = sample(4)
    with batch_noise(SEEDS[::-1]):
        backwards = sample(4)
    alone = []
    for seed in SEEDS:
        with batch_noise([seed]):
            alone.append(sample(1)[0])
    assert torch.equal(together, backwards.flip(0))
    assert torch.equal(together, torch.stack(alone))
    assert len({float(row.sum()) for row in together}) == 4
    assert 0.8 < float(together.std()) < 1.5


def test_every_way_of_asking_for_noise_is_understood() -> None:
    shape = (2, 3)
    calls = [
        lambda: torch.randn(2, 3),
        lambda: torch.randn(shape),
        lambda: torch.randn(torch.Size(shape)),
        lambda: torch.randn(size=shape),
        lambda: torch.randn(*shape, device="cpu", dtype=torch.float32, requires_grad=True).detach(),
        lambda: torch.randn_like(torch.empty(shape)),
    ]
    found = []
    for call in calls:
        with batch_noise((1, 2)):
            found.append(call())
    assert all(torch.equal(one, found[0]) for one in found)
    with batch_noise((1, 2)):
        assert torch.randn_like(torch.empty(shape, dtype=torch.float64)).dtype == torch.float64
        own = torch.randn(5, generator=torch.Generator().manual_seed(4))
    assert torch.equal(own, torch.randn(5, generator=torch.Generator().manual_seed(4)))


@pytest.mark.parametrize("draw", [lambda: torch.randn(7, 3), lambda: torch.randn(()), lambda: torch.randn(1, 2)])
def test_a_draw_that_is_not_one_a_row_is_refused_with_the_way_on(draw) -> None:
    with pytest.raises(ValueError, match=r"for the 2 sequences of the batch.*sequence_noise"), batch_noise((1, 2)):
        draw()


def test_importing_the_contract_imports_no_torch() -> None:
    code = "import sys, prbench.contract; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
