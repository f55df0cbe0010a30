"""The learnt trackers of the benchmark three-points: entry points that import torch when one is used."""

from __future__ import annotations

from functools import partial

from prbench_adapters.diffusion.method import late

load_avatarposer = partial(late("three_points.tracker:load_tracker"), "avatarposer")
train_avatarposer = partial(late("three_points.training:TrackTask"), "avatarposer")
