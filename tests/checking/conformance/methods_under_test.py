"""One right method and many wrong ones, each with a single fault; installed as a package of their own by conftest.

The file is copied into that package, so it imports nothing of the tests.
"""

from __future__ import annotations

import mmap
import os
import sys
import time
import uuid
from pathlib import Path

import numpy as np

from prbench.contract import Condition, Motions

OPTIONS = frozenset({"sway"})
STANDING = np.array(
    [
        [0.00, 0.95, 0.00], [0.08, 0.87, 0.00], [-0.08, 0.87, 0.00], [0.00, 1.07, 0.00], [0.09, 0.48, 0.01],
        [-0.09, 0.48, 0.01], [0.00, 1.20, 0.00], [0.09, 0.07, 0.00], [-0.09, 0.07, 0.00], [0.00, 1.26, 0.00],
        [0.10, 0.02, 0.13], [-0.10, 0.02, 0.13], [0.00, 1.47, -0.01], [0.08, 1.38, 0.00], [-0.08, 1.38, 0.00],
        [0.00, 1.56, 0.05], [0.18, 1.40, 0.00], [-0.18, 1.40, 0.00], [0.21, 1.13, 0.00], [-0.21, 1.13, 0.00],
        [0.22, 0.87, 0.04], [-0.22, 0.87, 0.04],
    ]
)  # fmt: skip


class Glide:
    """Slides the initial pose (or a standing one) towards the goal (or forward), swaying as its noise says."""

    name = "glide"
    conditions = frozenset({Condition.GOAL_LOCATION, Condition.TEXT})

    def __init__(self, method: str = "glide") -> None:
        self.name = method

    def generate(self, batch, *, seed):
        joints = self.joints(batch, self.start(batch), self.way(batch), self.sway(batch, seed))
        return self.motions(joints, batch.n_frames)

    def start(self, batch):
        if batch.initial_joints is None:
            return np.broadcast_to(STANDING, (len(batch), 22, 3))
        return batch.initial_joints.astype(np.float64)

    def way(self, batch):
        if batch.goal_location is None:
            return np.tile([0.0, 0.0, 1.5], (len(batch), 1))
        to_goal = batch.goal_location - self.start(batch)[:, 0]
        to_goal[:, 1] = 0.0
        distance = np.linalg.norm(to_goal, axis=1, keepdims=True)
        return to_goal * np.clip(1 - 0.4 / np.maximum(distance, 1e-9), 0, None)

    def sway(self, batch, seed):
        return 0.05 * np.array([np.random.default_rng(drawn).normal(size=2) for drawn in batch.noise_seed])

    def progress(self, batch):
        frame = np.arange(int(batch.n_frames.max()))
        return np.clip(frame / np.maximum(batch.n_frames[:, None] - 1, 1), 0, 1)

    def joints(self, batch, start, way, sway):
        progress = self.progress(batch)
        offset = progress[..., None] * way[:, None]
        offset[..., [0, 2]] += np.sin(np.pi * progress)[..., None] * sway[:, None]
        return start[:, None] + offset[:, :, None]

    def motions(self, joints, n_frames):
        return Motions(joints, n_frames)


def unchecked(joints, n_frames):
    """Motions as a method makes them where nobody checks annotations."""
    motions = object.__new__(Motions)
    for name, value in (("joints", joints), ("n_frames", n_frames), ("cost", None)):
        object.__setattr__(motions, name, value)
    return motions


def turned(points, angle):
    """Points turned about +Y, radians."""
    x, y, z = np.moveaxis(points, -1, 0)
    return np.stack([np.cos(angle) * x + np.sin(angle) * z, y, np.cos(angle) * z - np.sin(angle) * x], axis=-1)


class NoConditions(Glide):
    conditions = frozenset()


class ImpossibleMaxFrames(Glide):
    max_frames = 0


class TooShort(Glide):
    max_frames = 30


class Limited(Glide):
    max_frames = 196


class NativeRate(Glide):
    native_fps = 30.0
    max_frames = 361  # the protocol's twelve seconds


class CannotLoad(Glide):
    def __init__(self, method):
        raise RuntimeError("no room for weights")


class MissingWeights(Glide):
    def weights_for(self, condition):
        return Path("nowhere/glide.npz")


class WeightsAsText(Glide):
    def weights_for(self, condition):
        return "glide.npz"


class WeightsOfOneCondition(Glide):
    def weights_for(self, condition):
        return {Condition.TEXT: None}[condition]


class Raises(Glide):
    def way(self, batch):
        if batch.goal_location is not None:
            raise KeyError("goal")
        return super().way(batch)


class Exits(Glide):
    def way(self, batch):
        sys.exit("bye")


class ForgetsToReturn(Glide):
    def motions(self, joints, n_frames):
        Motions(joints, n_frames)


class BareArray(Glide):
    def motions(self, joints, n_frames):
        return joints


class FrameShort(Glide):
    def motions(self, joints, n_frames):
        return unchecked(joints[:, :-1], n_frames)


class FlatJoints(Glide):
    def motions(self, joints, n_frames):
        return unchecked(joints.reshape(*joints.shape[:2], 66), n_frames)


class FramesFirst(Glide):
    def motions(self, joints, n_frames):
        return unchecked(joints.transpose(1, 0, 2, 3), n_frames)


class AllAsLongAsTheLongest(Glide):
    def motions(self, joints, n_frames):
        return unchecked(joints, np.full(len(n_frames), n_frames.max()))


class WholeMillimetres(Glide):
    def motions(self, joints, n_frames):
        return unchecked((joints * 1000).astype(np.int64), n_frames)


class HalfPrecision(Glide):
    def motions(self, joints, n_frames):
        return Motions(joints.astype(np.float16), n_frames)


class NotANumber(Glide):
    def joints(self, batch, start, way, sway):
        joints = super().joints(batch, start, way, sway)
        joints[0, 3] = np.nan
        return joints


class SystemEntropy(Glide):
    def sway(self, batch, seed):
        return 0.05 * np.random.default_rng(uuid.uuid4().int).normal(size=(len(batch), 2))


class OwnGenerator(Glide):
    def __init__(self, method):
        self.name, self.generator = method, np.random.default_rng(0)

    def sway(self, batch, seed):
        return 0.05 * self.generator.normal(size=(len(batch), 2))


class GlobalNumpy(Glide):
    def sway(self, batch, seed):
        return 0.05 * np.random.normal(size=(len(batch), 2))  # noqa: NPY002


class SeedsGlobalNumpy(Glide):
    def sway(self, batch, seed):
        drawn = []
        for noise_seed in batch.noise_seed:
            np.random.seed(noise_seed % 2**32)  # noqa: NPY002
            drawn.append(np.random.normal(size=2))  # noqa: NPY002
        return 0.05 * np.array(drawn)


class RunSeed(Glide):
    def sway(self, batch, seed):
        return 0.05 * np.random.default_rng(seed).normal(size=(len(batch), 2))


class OpaqueIds(Glide):
    def sway(self, batch, seed):
        return 0.05 * np.array([np.random.default_rng(int(name[:8], 16)).normal(size=2) for name in batch.opaque_id])


class HashOfText(Glide):
    def sway(self, batch, seed):
        return 0.05 * np.array([np.random.default_rng(abs(hash(text))).normal(size=2) for text in batch.text])


class FirstNoiseSeed(Glide):
    def sway(self, batch, seed):
        return 0.05 * np.random.default_rng(batch.noise_seed[0]).normal(size=(len(batch), 2))


class BatchMean(Glide):
    def way(self, batch):
        return np.broadcast_to(super().way(batch).mean(axis=0), (len(batch), 3))


class PaceOfTheLongest(Glide):
    def progress(self, batch):
        frames = int(batch.n_frames.max())
        return np.broadcast_to(np.arange(frames) / max(frames - 1, 1), (len(batch), frames))


class AmplifiesRounding(Glide):
    """What chaos does: the last digits of the sums decide; here of a sum over the batch, as in a matrix product."""

    def joints(self, batch, start, way, sway):
        start = start.copy()
        last_digits = np.sin(1e9 * (start[:, 0] + 1e-9 * np.arange(len(batch))[:, None]))
        return super().joints(batch, start, way + 0.05 * last_digits, sway)


class Squeezes(Glide):
    def motions(self, joints, n_frames):
        return unchecked(joints.squeeze(), n_frames)


class NoLongSequences(Glide):
    def progress(self, batch):
        progress = np.zeros((len(batch), 240))
        progress[:, : int(batch.n_frames.max())] = super().progress(batch)[:, :240]
        return progress[:, : int(batch.n_frames.max())]


class SpoiltByOtherConditions(Glide):
    spoilt = False

    def way(self, batch):
        self.spoilt |= batch.condition not in self.conditions
        return super().way(batch) + 0.1 * self.spoilt


class NeedsWords(Glide):
    def sway(self, batch, seed):
        for text in batch.text:
            text.split()[0]
        return super().sway(batch, seed)


class DepthUp(Glide):
    def joints(self, batch, start, way, sway):
        return super().joints(batch, start, way, sway)[..., [0, 2, 1]] * [1, -1, 1]


class Centimetres(Glide):
    def joints(self, batch, start, way, sway):
        return 100 * super().joints(batch, start, way, sway)


class OneJointFarOut(Glide):
    def joints(self, batch, start, way, sway):
        joints = super().joints(batch, start, way, sway)
        joints[:, 1:2, 15] += [150.0, 0.0, 0.0]
        return joints


class LeftAndRightSwapped(Glide):
    def joints(self, batch, start, way, sway):
        other = [0, 2, 1, 3, 5, 4, 6, 8, 7, 9, 11, 10, 12, 14, 13, 15, 17, 16, 19, 18, 21, 20]
        return super().joints(batch, start, way, sway)[:, :, other]


class Floats(Glide):
    def joints(self, batch, start, way, sway):
        return super().joints(batch, start, way, sway) + np.array([0.0, 0.3, 0.0])


class Elsewhere(Glide):
    conditions = frozenset({Condition.TEXT})

    def start(self, batch):
        return super().start(batch) + np.array([3.0, 0.0, 2.0])


class StartsFromAStandingPose(Glide):
    def start(self, batch):
        raised = STANDING.copy()
        raised[[18, 20]] += [[0.05, 0.35, 0.2], [0.1, 0.7, 0.4]]
        raised[[19, 21]] += [[-0.05, 0.35, 0.2], [-0.1, 0.7, 0.4]]
        return np.broadcast_to(raised, (len(batch), 22, 3))


class AnyHeading(Glide):
    conditions = frozenset({Condition.TEXT})

    def joints(self, batch, start, way, sway):
        # 45 degrees off or more, whatever the noise says: three motions are too few to leave that to chance.
        heading = np.pi + 0.75 * np.pi * np.tanh(20 * sway[:, :1, None])
        return turned(super().joints(batch, start, way, sway), heading)


class Stretches(Glide):
    conditions = frozenset({Condition.TEXT})

    def joints(self, batch, start, way, sway):
        joints = super().joints(batch, start, way, sway)
        pelvis = joints[:, :, :1] * [1, 0, 1]
        body = turned(joints - pelvis, 0.4 * self.progress(batch)[..., None])
        return pelvis + body * (1 + 0.15 * self.progress(batch)[..., None, None])


class NothingFilledIn(Glide):
    def joints(self, batch, start, way, sway):
        return np.zeros((len(batch), int(batch.n_frames.max()), 22, 3))


class Leaks(Glide):
    kept: list

    def joints(self, batch, start, way, sway):
        pages = mmap.mmap(-1, len(batch) * 320_000)  # never from what the process has freed before
        pages.write(bytes(len(pages)))
        self.__dict__.setdefault("kept", []).append(pages)
        return super().joints(batch, start, way, sway)


class Dies(Glide):
    def way(self, batch):
        sys.stderr.write("about to die\n")
        os._exit(7)


class DiesOnBlankTextAndHangsOnTheLongest(Glide):
    def sway(self, batch, seed):
        if not all(batch.text):
            os.kill(os.getpid(), 11)
        if batch.n_frames.max() == 241:
            time.sleep(3600)
        return super().sway(batch, seed)


FAULTS = {cls.__name__.lower(): cls for cls in (Glide, *Glide.__subclasses__())}
"""Every method by the name that it is installed under."""


def load_as(fault, *, name=None):
    """What the entry point of this name calls."""

    def load(weights, *, options, device):
        unknown = set(options) - OPTIONS
        if unknown:
            raise ValueError(f"unknown option {unknown.pop()!r}")
        if weights is not None:
            raise ValueError("glide has no weights")
        return FAULTS[fault](name or fault)

    return load


globals().update({f"load_{name}": load_as(name) for name in FAULTS})


def load_takesanyoption(weights, *, options, device):
    return Glide("takesanyoption")


def load_takesanyweights(weights, *, options, device):
    return load_as("glide")(None, options=options, device=device).__class__("takesanyweights")


def load_misnamed(weights, *, options, device):
    return load_as("glide")(weights, options=options, device=device)
