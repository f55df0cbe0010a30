"""The public MDM (github.com/GuyTevet/motion-diffusion-model) as a method of prbench, run from its user's checkout.

Denoiser, diffusion and options are the checkout's; nothing of them is copied here.
"""

from __future__ import annotations

import json
import os
import sys
import types
from argparse import ArgumentParser, Namespace
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

from prbench.contract import Condition, ConditionBatch, Motions, batch_noise
from prbench.representation.converters import (
    feature_rows,
    motions_from_features,
    on_floor,
    padded,
    read_feature_statistics,
)

# The longest motion of HumanML3D. Models without mask_frames give still motions where fewer frames are asked for, and
# noise of one length does not depend on the rows beside it: all are drawn at this length, and cut.
FRAMES = 196
OPTIONS = ("checkout", "statistics", "guidance", "check")


class PublicMdm:
    """Text to 263 features a frame, on the model's own skeleton; it takes no first pose and no goal."""

    name = "public-mdm"
    conditions = frozenset({Condition.TEXT})
    max_frames = FRAMES

    def __init__(self, weights: Path | None, *, options: Mapping[str, str], device: str) -> None:
        if unknown := sorted(set(options) - set(OPTIONS)):
            raise ValueError(f"unknown option '{unknown[0]}'; known options: {', '.join(OPTIONS)}.")
        checkout = options.get("checkout") or os.environ.get("PUBLIC_MDM")
        if checkout is None or not Path(checkout, "utils", "model_util.py").is_file():
            problem = f"expected a checkout of motion-diffusion-model, found {checkout or 'none'}"
            raise ValueError(f"{problem}. Give --option checkout=DIR, or set PUBLIC_MDM to it.")
        if weights is None or not weights.is_file() or not weights.with_name("args.json").is_file():
            raise ValueError(f"expected --weights FILE, a model*.pt with its args.json beside it, found {weights}.")
        if options.get("check", "yes") not in ("yes", "no"):
            raise ValueError(f"option 'check': expected yes or no, found '{options['check']}'.")
        self.checkout = Path(checkout).resolve()
        self.weights, self.device = weights, device
        folder = Path(options.get("statistics") or self.checkout / "dataset" / "HumanML3D")
        self.statistics = read_feature_statistics(folder / "Mean.npy", folder / "Std.npy")
        try:
            self.guidance = float(options.get("guidance", "2.5"))
        except ValueError:
            raise ValueError(f"option 'guidance': expected a number, found '{options['guidance']}'.") from None
        self.check = options.get("check", "yes") == "yes"

    @cached_property
    def model(self) -> tuple[Any, Any]:
        """Denoiser and diffusion of the checkout, with the weights; loaded with the first batch."""
        import torch

        public = imported(self.checkout)
        args = arguments(public.parser, self.weights.with_name("args.json"))
        if args.dataset != "humanml" or args.unconstrained or args.context_len:
            raise ValueError(f"{self.weights}: expected a text-to-motion model of HumanML3D without prefix.")
        model, diffusion = public.models.create_model_and_diffusion(args, types.SimpleNamespace(dataset=None))
        state = torch.load(self.weights, map_location="cpu", weights_only=True)  # never unpickles
        average = state.get("model_avg") if args.use_ema else None
        public.models.load_model_wo_clip(model, average or state.get("model", state))
        if self.guidance != 1 and args.cond_mask_prob > 0:
            model = public.guided(model)
        # Not chained: the public train() and to() return None.
        model.to(self.device)
        model.eval()
        return model, diffusion

    def generate(self, batch: ConditionBatch, *, seed: int) -> Motions:
        import torch

        model, diffusion = self.model
        lengths = torch.as_tensor(batch.n_frames, device=self.device)
        valid = torch.arange(FRAMES, device=self.device) < lengths[:, None]
        given = {"text": list(batch.text), "lengths": lengths, "mask": valid[:, None, None]}
        given["scale"] = torch.full((len(batch),), self.guidance, device=self.device)
        shape = (len(batch), 263, 1, FRAMES)
        # The sampler draws from torch's global generator, by randn and randn_like alone and a row a sequence.
        with batch_noise(batch.noise_seed), torch.no_grad():
            output = diffusion.p_sample_loop(model, shape, clip_denoised=False, model_kwargs={"y": given})
        features = self.statistics.restore(feature_rows(output.cpu().numpy()))
        motions = motions_from_features(
            features, batch.n_frames, source=self.name, sequences=batch.opaque_id, check=self.check
        )
        return Motions(padded([on_floor(motion) for motion in motions]), batch.n_frames)


def imported(checkout: Path) -> Namespace:
    """The modules of the checkout; its packages are called `model`, `utils`, `diffusion` and `data_loaders`."""
    import torch

    # Rotation2xyz opens the licensed body model, a pickle, for other features than these: a stand-in without a body.
    body = types.ModuleType("model.rotation2xyz")
    body.Rotation2xyz = lambda **settings: types.SimpleNamespace(smpl_model=torch.nn.Module())
    sys.modules.setdefault("model.rotation2xyz", body)
    sys.path.insert(0, str(checkout))
    try:
        from utils import model_util, parser_util, sampler_util
    except ModuleNotFoundError as error:
        raise ValueError(f"{checkout}: {error}. Install what its README asks for into this environment.") from error
    finally:
        sys.path.remove(str(checkout))
    if not Path(model_util.__file__).is_relative_to(checkout):
        raise ValueError(f"expected the package `utils` of {checkout}, found {model_util.__file__}. Remove it.")
    return Namespace(models=model_util, parser=parser_util, guided=sampler_util.ClassifierFreeSampleModel)


def arguments(parser_util: Any, path: Path) -> Namespace:
    """The options that a model was trained with; older checkpoints lack some, which get the checkout's defaults."""
    parser = ArgumentParser()
    for name in ("data", "model", "diffusion"):
        getattr(parser_util, f"add_{name}_options")(parser)
    args = parser.parse_args([])
    found = json.loads(path.read_text(encoding="utf-8"))
    found.setdefault("unconstrained", found.get("cond_mode") == "no_cond")
    for name in vars(args):
        setattr(args, name, found.get(name, getattr(args, name)))
    return args


load = PublicMdm
