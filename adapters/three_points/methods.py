"""The learnt trackers of the benchmark three-points, and of poses in recordings; torch is imported when one is used."""

from __future__ import annotations

from functools import partial

from prbench_adapters.diffusion.method import late

load_avatarposer = partial(late("three_points.tracker:load_tracker"), "avatarposer")
pose_avatarposer = partial(late("three_points.tracker:load_tracker"), "avatarposer", options={}, device="cpu")
train_avatarposer = partial(late("three_points.training:TrackTask"), "avatarposer")
