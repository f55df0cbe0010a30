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


FAULTS = {"glide": Glide}  # every method by the name that it is installed under


def fault(name, **changes):
    """Add a method that differs from the right one in what is given."""
    FAULTS[name] = type(name, (Glide,), changes)


def spoilt(change):
    """Return a ``joints`` that changes those of the right method."""
    return lambda self, batch, start, way, sway: change(Glide.joints(self, batch, start, way, sway), batch)


def swaying(draw):
    """Return a ``sway`` of other numbers, two for each row."""
    return lambda self, batch, seed: 0.05 * np.array(draw(self, batch, seed))


def doing(action):
    """Return a ``way`` that does something else before the right one."""

    def way(self, batch):
        action(self, batch)
        return Glide.way(self, batch)

    return way


def normal(seed):
    return np.random.default_rng(seed).normal(size=2)


def of_the_first(batch):
    return np.random.default_rng(batch.noise_seed[0]).normal(size=(len(batch), 2))


def raising(error):
    raise error


TEXT_ALONE = frozenset({Condition.TEXT})
OTHER_SIDES = [0, 2, 1, 3, 5, 4, 6, 8, 7, 9, 11, 10, 12, 14, 13, 15, 17, 16, 19, 18, 21, 20]

# What is declared, loaded and named
fault("noconditions", conditions=frozenset())
fault("impossiblemaxframes", max_frames=0)
fault("tooshort", max_frames=30)
fault("limited", max_frames=196)
fault("nativerate", native_fps=30.0, max_frames=361)  # the protocol's twelve seconds
fault("cannotload", __init__=lambda self, method: raising(RuntimeError("no room for weights")))
fault("missingweights", weights_for=lambda self, condition: Path("nowhere/glide.npz"))
fault("weightsastext", weights_for=lambda self, condition: "glide.npz")
fault("weightsofonecondition", weights_for=lambda self, condition: {Condition.TEXT: None}[condition])

# The form of the answer
fault("raises", way=doing(lambda self, batch: None if batch.goal_location is None else raising(KeyError("goal"))))
fault("exits", way=doing(lambda self, batch: sys.exit("bye")))
fault("forgetstoreturn", motions=lambda self, joints, n_frames: None)
fault("barearray", motions=lambda self, joints, n_frames: joints)
fault("frameshort", motions=lambda self, joints, n_frames: unchecked(joints[:, :-1], n_frames))
fault("flatjoints", motions=lambda self, joints, n_frames: unchecked(joints.reshape(*joints.shape[:2], 66), n_frames))
fault("framesfirst", motions=lambda self, joints, n_frames: unchecked(joints.transpose(1, 0, 2, 3), n_frames))
fault("allaslongasthelongest", motions=lambda self, joints, n: unchecked(joints, np.full(len(n), n.max())))
fault("wholemillimetres", motions=lambda self, joints, n: unchecked((joints * 1000).astype(np.int64), n))
fault("halfprecision", motions=lambda self, joints, n_frames: Motions(joints.astype(np.float16), n_frames))
fault("squeezes", motions=lambda self, joints, n_frames: unchecked(joints.squeeze(), n_frames))

# What decides but the noise seed
fault("systementropy", sway=swaying(lambda self, batch, seed: [normal(uuid.uuid4().int) for _ in batch.text]))
GENERATOR = np.random.default_rng(0)
fault("owngenerator", sway=swaying(lambda self, batch, seed: GENERATOR.normal(size=(len(batch), 2))))
fault("globalnumpy", sway=swaying(lambda self, batch, seed: np.random.normal(size=(len(batch), 2))))  # noqa: NPY002
fault("runseed", sway=swaying(lambda self, batch, seed: np.random.default_rng(seed).normal(size=(len(batch), 2))))
fault("opaqueids", sway=swaying(lambda self, batch, seed: [normal(int(name[:8], 16)) for name in batch.opaque_id]))
fault("hashoftext", sway=swaying(lambda self, batch, seed: [normal(abs(hash(text))) for text in batch.text]))
fault("firstnoiseseed", sway=swaying(lambda self, batch, seed: of_the_first(batch)))
fault("batchmean", way=lambda self, batch: np.broadcast_to(Glide.way(self, batch).mean(axis=0), (len(batch), 3)))


def seeds_global_numpy(self, batch, seed):
    drawn = []
    for noise_seed in batch.noise_seed:
        np.random.seed(noise_seed % 2**32)  # noqa: NPY002
        drawn.append(np.random.normal(size=2))  # noqa: NPY002
    return drawn


fault("seedsglobalnumpy", sway=swaying(seeds_global_numpy))


def pace_of_the_longest(self, batch):
    frames = int(batch.n_frames.max())
    return np.broadcast_to(np.arange(frames) / max(frames - 1, 1), (len(batch), frames))


fault("paceofthelongest", progress=pace_of_the_longest)


def amplified_rounding(self, batch, start, way, sway):
    """Do what chaos does: the last digits of the sums decide; here of a sum over the batch, as in a matrix product."""
    last_digits = np.sin(1e9 * (start[:, 0] + 1e-9 * np.arange(len(batch))[:, None]))
    return Glide.joints(self, batch, start.copy(), way + 0.05 * last_digits, sway)


fault("amplifiesrounding", joints=amplified_rounding)


def no_long_sequences(self, batch):
    progress = np.zeros((len(batch), 240))
    progress[:, : int(batch.n_frames.max())] = Glide.progress(self, batch)[:, :240]
    return progress[:, : int(batch.n_frames.max())]


fault("nolongsequences", progress=no_long_sequences)


def spoilt_by_other_conditions(self, batch):
    self.spoilt |= batch.condition not in self.conditions
    return Glide.way(self, batch) + 0.1 * self.spoilt


fault("spoiltbyotherconditions", spoilt=False, way=spoilt_by_other_conditions)
fault("needswords", way=doing(lambda self, batch: [text.split()[0] for text in batch.text]))

# The body


def with_nan(joints, batch):
    joints[0, 3] = np.nan
    return joints


def one_joint_far_out(joints, batch):
    joints[:, 1:2, 15] += [150.0, 0.0, 0.0]
    return joints


def from_a_standing_pose(self, batch):
    raised = STANDING.copy()
    raised[[18, 20]] += [[0.05, 0.35, 0.2], [0.1, 0.7, 0.4]]
    raised[[19, 21]] += [[-0.05, 0.35, 0.2], [-0.1, 0.7, 0.4]]
    return np.broadcast_to(raised, (len(batch), 22, 3))


def any_heading(self, batch, start, way, sway):
    # 45 degrees off or more, whatever the noise says: three motions are too few to leave that to chance.
    heading = np.pi + 0.75 * np.pi * np.tanh(20 * sway[:, :1, None])
    return turned(Glide.joints(self, batch, start, way, sway), heading)


def stretched(self, batch, start, way, sway):
    joints = Glide.joints(self, batch, start, way, sway)
    pelvis = joints[:, :, :1] * [1, 0, 1]
    body = turned(joints - pelvis, 0.4 * self.progress(batch)[..., None])
    return pelvis + body * (1 + 0.15 * self.progress(batch)[..., None, None])


fault("notanumber", joints=spoilt(with_nan))
fault("depthup", joints=spoilt(lambda joints, batch: joints[..., [0, 2, 1]] * [1, -1, 1]))
fault("centimetres", joints=spoilt(lambda joints, batch: 100 * joints))
fault("onejointfarout", joints=spoilt(one_joint_far_out))
fault("leftandrightswapped", joints=spoilt(lambda joints, batch: joints[:, :, OTHER_SIDES]))
fault("floats", joints=spoilt(lambda joints, batch: joints + np.array([0.0, 0.3, 0.0])))
fault("elsewhere", conditions=TEXT_ALONE, start=lambda self, batch: Glide.start(self, batch) + np.array([3.0, 0, 2.0]))
fault("startsfromastandingpose", start=from_a_standing_pose)
fault("anyheading", conditions=TEXT_ALONE, joints=any_heading)
fault("stretches", conditions=TEXT_ALONE, joints=stretched)
fault("nothingfilledin", joints=spoilt(lambda joints, batch: np.zeros_like(joints)))

# The process


def leak(self, batch):
    pages = mmap.mmap(-1, len(batch) * 320_000)  # never from what the process has freed before
    pages.write(bytes(len(pages)))
    self.__dict__.setdefault("kept", []).append(pages)


def die(self, batch):
    sys.stderr.write("about to die\n")
    os._exit(7)


def die_on_blank_text_and_hang_on_the_longest(self, batch):
    if not all(batch.text):
        os.kill(os.getpid(), 11)
    if batch.n_frames.max() == 241:
        time.sleep(3600)


fault("leaks", way=doing(leak))
fault("dies", way=doing(die))
fault("diesonblanktextandhangsonthelongest", way=doing(die_on_blank_text_and_hang_on_the_longest))


def load_as(method, *, name=None):
    """What the entry point of this name calls."""

    def load(weights, *, options, device):
        unknown = set(options) - OPTIONS
        if unknown:
            raise ValueError(f"unknown option {unknown.pop()!r}")
        if weights is not None:
            raise ValueError("glide has no weights")
        return FAULTS[method](name or method)

    return load


globals().update({f"load_{name}": load_as(name) for name in FAULTS})


def load_takesanyoption(weights, *, options, device):
    return Glide("takesanyoption")


def load_takesanyweights(weights, *, options, device):
    return load_as("glide")(None, options=options, device=device).__class__("takesanyweights")


def load_misnamed(weights, *, options, device):
    return load_as("glide")(weights, options=options, device=device)
