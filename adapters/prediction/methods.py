"""The methods of motion prediction that are learnt: gazemodiff, gazemotion, humanmac, cvae, dlow and belfusion.

Each is an entry point of its own, with a page in docs/methods/. torch is imported when one is used.
"""

from __future__ import annotations

from functools import partial

from prbench_adapters.diffusion.method import late

_load = late("prediction.adapter:load_predictor")
_task = late("prediction.training:PredictorTask")
_BELFUSION = ("autoencoders", "diffusion")  # stages of its training, one after the other

load_belfusion = partial(_load, "belfusion")
load_cvae = partial(_load, "cvae")
load_dlow = partial(_load, "dlow")
load_gazemodiff = partial(_load, "gazemodiff")
load_gazemotion = partial(_load, "gazemotion")
load_humanmac = partial(_load, "humanmac")
train_belfusion = partial(_task, "belfusion", _BELFUSION)
train_cvae = partial(_task, "cvae")
train_dlow = partial(_task, "dlow")
train_gazemodiff = partial(_task, "gazemodiff")
train_gazemotion = partial(_task, "gazemotion")
train_humanmac = partial(_task, "humanmac")
