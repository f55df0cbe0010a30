"""What GazeMotion's public program makes of weights and windows of ours.

``python -m tests.adapters.prediction.gazemotion_golden CHECKOUT`` writes ``gazemotion.npz`` beside this module; it
is https://github.com/CraneHzm/GazeMotion, made with commit 838ad9c. Its classes and its training step (``run_model``)
run unchanged, on the CPU (``cuda_idx``), in float32, without dropout, and with an optimiser that moves nothing. Weights
and windows are ours, drawn from seeds; the file holds results alone, so nothing of the repository is stored.
"""

from __future__ import annotations

import importlib
import sys
from argparse import Namespace
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import torch

FILE = Path(__file__).with_name("gazemotion.npz")
# Joints, observed and predicted frames, copies of the direction, width, blocks: the published network of MoGaze, a
# small one with fewer copies than joints, and the ablation without gaze.
CASES = {
    "published": (21, 10, 30, 21, 16, 16),
    "small": (3, 4, 6, 2, 5, 2),
    "without": (4, 5, 7, 0, 3, 1),
}
_WINDOWS = 2


def fill(parameters: Iterable[torch.nn.Parameter], seed: int) -> None:
    """Draw weights in the order of registration, which is ours and the program's: ±1/√rows, norms around 1."""
    random = np.random.RandomState(seed)  # whose stream never changes
    with torch.no_grad():
        for parameter in parameters:
            drawn = random.uniform(-1.0, 1.0, tuple(parameter.shape)) / np.sqrt(parameter.shape[0])
            parameter.copy_(torch.from_numpy(drawn.astype(np.float32)))


def windows(joints: int, frames: int, seed: int) -> torch.Tensor:
    """Return smooth walks of some joints, and unit directions as the last node: (windows, frames, joints + 1, 3)."""
    random = np.random.RandomState(seed)
    steps = random.uniform(-0.05, 0.05, (_WINDOWS, frames, joints, 3)).cumsum(axis=1)
    body = random.uniform(-1.0, 1.0, (_WINDOWS, 1, joints, 3)) + steps
    gaze = random.uniform(-1.0, 1.0, (_WINDOWS, 1, 1, 3)) + random.uniform(-0.1, 0.1, (_WINDOWS, frames, 1, 3)).cumsum(
        1
    )
    gaze /= np.linalg.norm(gaze, axis=-1, keepdims=True)
    return torch.from_numpy(np.concatenate([body, gaze], axis=2).astype(np.float32))


def published(case: str) -> dict[str, np.ndarray]:
    """Run the program's classes and one of its training steps of each network."""
    joints, observed, predicted, copies, width, blocks = CASES[case]
    options: Any = Namespace(
        input_n=observed, output_n=predicted, joint_number=joints, gaze_node_n=copies, gcn_latent_features=width,
        residual_gcns_num=blocks, dropout=0.0, gaze_cnn_kernel_size=3, gaze_cnn_layer_1=32, gaze_cnn_layer_2=32,
        gaze_cnn_layer_3=32, cuda_idx="cpu", use_gaze=0, velocity_loss=1, is_eval=False, save_predictions=False,
    )  # fmt: skip
    gaze = importlib.import_module("model.gaze_forecasting").gaze_forecasting(options)
    pose = importlib.import_module("model.pose_forecasting").pose_forecasting(options)
    fill(gaze.parameters(), 1)
    fill(pose.parameters(), 2)
    motion = windows(joints, observed + predicted, 3)
    flat = torch.cat([motion.flatten(2), motion[:, :, -1]], dim=2)  # the program's last three are the head's
    found = {}
    with torch.no_grad():
        ahead = gaze(motion[:, :observed, -1], input_n=observed)
        shown = torch.cat([motion[:, :observed, :-1].flatten(2), ahead], dim=2)
        found["gaze"] = ahead
        found["future"] = pose(shown, input_n=observed, output_n=predicted)
    for name, network in (("gaze", gaze), ("pose", pose)):
        step = importlib.import_module(f"main_mogaze_{name}_forecasting").run_model
        still = torch.optim.SGD(network.parameters(), lr=0.0)
        more = {"gaze_forecasting_model": gaze} if name == "pose" else {}
        error = step(network, still, is_train=1, data_loader=[flat], opt=options, **more)["prediction_error_average"]
        gradients = [parameter.grad for parameter in network.parameters() if parameter.grad is not None]
        found[f"{name}_error"] = torch.as_tensor(error)
        found[f"{name}_gradient"] = torch.stack([gradient.norm() for gradient in gradients])
        gaze.zero_grad()  # the step of the poses reaches the forecaster, which its optimiser does not move
    return {f"{case}/{name}": value.numpy() for name, value in found.items()}


if __name__ == "__main__":
    sys.path.insert(0, sys.argv[1])
    np.savez_compressed(FILE, **{name: array for case in CASES for name, array in published(case).items()})
