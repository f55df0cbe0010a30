"""The learnt trackers of the benchmark three-points, and of poses in recordings; torch is imported when one is used."""

from __future__ import annotations

from functools import partial

from prbench_adapters.diffusion.method import late

load_avatarposer = partial(late("three_points.tracker:load_tracker"), "avatarposer")
load_bodiffusion = partial(late("three_points.tracker:load_tracker"), "bodiffusion")
pose_avatarposer = partial(late("three_points.tracker:load_tracker"), "avatarposer", options={}, device="cpu")
pose_bodiffusion = partial(late("three_points.tracker:load_tracker"), "bodiffusion", options={}, device="cpu")
train_avatarposer = partial(late("three_points.training:TrackTask"), "avatarposer")
train_bodiffusion = partial(late("three_points.training:TrackTask"), "bodiffusion")
