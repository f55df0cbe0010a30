"""GazeMotion: the values of the published program, check values of its page, and what holds for any weights."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from prbench_adapters.prediction.gazemotion import GazeMotion, GazeMotionConfiguration, GraphConvolution
from tests.adapters.prediction import gazemotion_golden as golden
from tests.adapters.prediction.golden import largest_difference


def _network(case):
    joints, observed, predicted, copies, width, blocks = golden.CASES[case]
    sizes = {"n_joints": joints, "observed": observed, "predicted": predicted, "gaze_nodes": copies}
    sizes |= {"gaze": copies > 0, "width": width, "blocks": blocks, "dropout": 0.0}
    network = GazeMotion(GazeMotionConfiguration(**sizes))
    if network.forecaster is not None:
        golden.fill(network.forecaster.parameters(), 1)
    golden.fill(network.graph.parameters(), 2)
    motion = golden.windows(joints, observed + predicted, 3)
    return network, motion if copies else motion[:, :, :-1]


@pytest.fixture(scope="module")
def arrays():
    with np.load(golden.FILE, allow_pickle=False) as file:
        return dict(file)


@pytest.mark.parametrize("case", golden.CASES)
def test_futures_and_forecasts_of_the_published_program(case, arrays):
    network, motion = _network(case)
    observed = motion[:, : network.configuration.observed]
    shown = network.shown(observed)
    if network.forecaster is not None:
        assert largest_difference(shown[:, :, -1], arrays[f"{case}/gaze"]) < 1e-6
    future = network(shown).detach()
    assert largest_difference(future.flatten(2), arrays[f"{case}/future"]) < 1e-5
    assert float((future - observed[:, -1:, : network.configuration.n_joints]).detach().abs().max()) > 0.1, (
        "the graph matters"
    )


@pytest.mark.parametrize("case", golden.CASES)
def test_losses_and_gradients_of_a_published_training_step(case, arrays):
    network, motion = _network(case)
    losses = network.loss(motion)
    losses["loss"].backward()
    found = {"pose": [each.grad.norm() for each in network.graph.parameters()]}
    assert float(losses["joints"].detach()) == pytest.approx(float(arrays[f"{case}/pose_error"]), rel=1e-5)
    if network.forecaster is not None:
        assert math.degrees(losses["gaze"].detach()) == pytest.approx(float(arrays[f"{case}/gaze_error"]), rel=1e-5)
        # The program's loss is in degrees.
        found["gaze"] = [each.grad.norm() * 180 / math.pi for each in network.forecaster.parameters()]
    for name, gradients in found.items():
        np.testing.assert_allclose(torch.stack(gradients).numpy(), arrays[f"{case}/{name}_gradient"], rtol=2e-4)


@pytest.mark.parametrize(
    ("changes", "graph"),
    [
        ({"observed": 10, "predicted": 30}, 1_863_224),
        ({"observed": 10, "predicted": 30, "n_joints": 23}, 2_033_400),
        ({"observed": 10, "predicted": 30, "gaze": False}, 979_250),
        ({}, 3_635_344),
    ],
)
def test_the_published_numbers_of_parameters(changes, graph):
    network = GazeMotion(GazeMotionConfiguration(**{"n_joints": 21, **changes}))
    assert sum(parameter.numel() for parameter in network.graph.parameters()) == graph
    forecaster = {"gaze": 0, 10: 8_739, 15: 9_699}[changes.get("observed", 15) if changes.get("gaze", True) else "gaze"]
    assert sum(each.numel() for each in network.parameters()) - graph == forecaster


def test_a_graph_convolution_worked_by_hand():
    layer = GraphConvolution(1, 1, 2, 2)
    with torch.no_grad():
        layer.over_steps.copy_(torch.tensor([[1.0, 2.0], [0.0, 1.0]]))
        layer.channels.fill_(3.0)
        layer.over_nodes.copy_(torch.tensor([[1.0, 0.0], [1.0, 1.0]]))
        layer.bias.copy_(torch.tensor([0.0, 0.5]))
    found = layer(torch.tensor([[[[1.0, 3.0], [5.0, 9.0]]]]))
    # Steps: (1, 5) and (5, 19); three times that; node 1 is the sum of both.
    torch.testing.assert_close(found, torch.tensor([[[[3.0, 15.5], [18.0, 72.5]]]]))


def test_only_the_forecaster_learns_from_the_angle_and_only_the_graph_from_the_joints():
    network, motion = _network("small")
    losses = network.loss(motion)
    losses["gaze"].backward(retain_graph=True)
    assert all(each.grad is None for each in network.graph.parameters())
    network.zero_grad()
    (losses["joints"] + losses["velocity"]).backward()
    assert all(each.grad is None or not each.grad.any() for each in network.forecaster.parameters())


def test_a_perfect_forecast_has_no_angle_and_a_finite_gradient():
    network, motion = _network("small")
    motion[:, :, -1] = motion[:, :1, -1]
    last = network.forecaster[-2]
    torch.nn.init.zeros_(last.weight)
    torch.nn.init.zeros_(last.bias)
    losses = network.loss(motion)
    losses["loss"].backward()
    assert float(losses["gaze"].detach()) < 1e-6
    assert bool(torch.isfinite(last.weight.grad).all())


def test_all_samples_are_the_one_future():
    network, motion = _network("small")
    futures = network.eval().predict(motion[:, :4], [[1, 2, 3]] * len(motion))
    assert futures.shape == (2, 3, 6, 3, 3)
    assert torch.equal(futures[:, 0], futures[:, 2])


def test_with_few_coefficients_a_graph_that_changes_nothing_holds_the_last_pose():
    network = GazeMotion(
        GazeMotionConfiguration(n_joints=3, observed=4, predicted=6, coefficients=3, width=4, blocks=1)
    )
    torch.nn.init.zeros_(network.graph.end.channels)
    torch.nn.init.zeros_(network.graph.end.bias)
    observed = golden.windows(3, 4, 5)
    torch.testing.assert_close(network(observed), observed[:, -1:, :3].expand(-1, 6, -1, -1))


def test_without_forecast_the_measured_gaze_is_shown():
    network = GazeMotion(GazeMotionConfiguration(n_joints=3, observed=4, predicted=3, forecast=False, blocks=1))
    observed = golden.windows(3, 4, 5)
    assert torch.equal(network.shown(observed), observed)
    assert set(network.loss(golden.windows(3, 7, 5))) == {"loss", "joints", "velocity"}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"predicted": 14}, "'predicted' must be at least 15 with these settings, found 14"),
        ({"predicted": 1, "gaze": False}, "'predicted' must be at least 2"),
        ({"coefficients": 76}, "'coefficients' must be at most the 75 frames, found 76"),
        ({"dropout": 1.0}, "'dropout' must be at least 0 and below 1"),
        ({"blocks": 0}, "'blocks' must be at least 1"),
    ],
)
def test_sizes_that_make_no_network_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        GazeMotionConfiguration(n_joints=2, **changes)
