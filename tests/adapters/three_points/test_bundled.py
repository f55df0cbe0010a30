"""What the bundled weights of the trackers can do on people who are not in their training."""

from pathlib import Path

import numpy as np
import pytest

import prbench_adapters.three_points
from prbench_adapters.three_points.tracker import load_tracker
from prbench_benchmarks.three_points.batch import Condition, TrackedBatch, ask
from prbench_benchmarks.three_points.standing import load as standing
from prbench_benchmarks.three_points.table import TracksTable
from tests.adapters.cards import described

FOLDER = Path(prbench_adapters.three_points.__file__).with_name("weights")
METHODS = ("avatarposer", "bodiffusion")
LARGEST = 1_000_000  # bytes
FRAMES = 300
LEGS = [4, 5, 7, 8, 10, 11]


def shown(condition, tracks):
    """The first seconds of a track of the test split, and the body that was recorded."""
    chunk = next(iter(TracksTable.open(tracks).chunks(split="test", rows=1)))
    wrists = condition is Condition.HEAD_WRISTS
    valid = np.tile([True, wrists, wrists], (1, FRAMES, 1))
    arrays = {
        "position": chunk.frames("device_position")[:FRAMES].reshape(1, FRAMES, 3, 3),
        "rotation": chunk.frames("device_rotation")[:FRAMES].reshape(1, FRAMES, 3, 4),
        "offsets": chunk.vectors("offsets").reshape(1, 22, 3),
    }
    about = {"condition": condition, "fps": 60.0, "n_frames": np.array([FRAMES]), "key": (1,)}
    batch = TrackedBatch(valid=valid, rotation_valid=valid, **arrays, **about)
    return batch, chunk.frames("joints")[:FRAMES].reshape(1, FRAMES, 22, 3)


def test_every_bundled_file_is_looked_at_here():
    assert {path.stem for path in FOLDER.glob("*.safetensors")} == {f"{name}-small" for name in METHODS}


@pytest.mark.parametrize("name", METHODS)
def test_a_card_describes_its_weights(name):
    card = described(FOLDER / f"{name}-small.safetensors", largest=LARGEST)
    assert (card["method"], card["finished"]) == (name, True)
    assert {row["condition"] for row in card["evaluation"]} == set(Condition)


@pytest.mark.parametrize("condition", Condition)
@pytest.mark.parametrize("name", METHODS)
def test_legs_are_nearer_than_those_of_a_body_that_stands(name, condition, tracks):
    batch, recorded = shown(condition, tracks)
    errors = []
    for tracker in (load_tracker(name, None, options={}, device="cpu"), standing(None, options={}, device="cpu")):
        joints = ask(tracker, batch, seed=0).joints
        errors.append(np.linalg.norm(joints - recorded, axis=-1)[:, :, LEGS].mean())
    assert errors[0] < 0.5 * errors[1]
