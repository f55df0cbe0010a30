"""The public code of MDM and DNO, from a checkout of the user's, as it stands there, with random weights.

Packages that it imports and that take no part in what is timed (text encoders, body models, plotting) are replaced by
empty ones where they are missing; text vectors are given to it instead of being computed in every step. Nothing else is
touched.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.abc
import importlib.machinery
import io
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import torch

from benchmarks.speed.generation_cases import (
    DIFFUSION_STEPS,
    GUIDANCE,
    OPTIMISATION_STEPS,
    Problem,
    random_features,
    sentence,
    training_step,
    word_pieces,
)

_OPTIONAL = (
    "clip",
    "spacy",
    "smplx",
    "einops",
    "chumpy",
    "blobfile",
    "trimesh",
    "moviepy",
    "wandb",
    "sklearn",
    "human_body_prior",
)
_OPTIONS = SimpleNamespace(
    noise_schedule="cosine", sigma_small=True, lambda_vel=0.0, lambda_rcxyz=0.0, lambda_fc=0.0, lambda_target_loc=0.0,
    diffusion_steps=DIFFUSION_STEPS,
)  # fmt: skip
_SHAPE = {
    "njoints": 263, "nfeats": 1, "num_actions": 1, "translation": True, "pose_rep": "rot6d", "glob": True,
    "glob_rot": True,
}  # fmt: skip


class Checkout:
    """One of the two repositories."""

    def __init__(self, folder: Path) -> None:
        if not (folder / "model" / "mdm.py").is_file():
            raise SystemExit(f"{folder}: expected a checkout of MDM or DNO (model/mdm.py), found none.")
        self.folder = folder
        self.name = "DNO" if (folder / "dno.py").is_file() else "MDM"

    def sampling(self, problem: Problem) -> tuple[torch.nn.Module, Callable[[], object]]:
        """MDM: 50 guided DDPM steps of the decoder with DistilBERT's word pieces, and the joints."""
        with self._imports():
            network = self._decoder(problem)
            model = importlib.import_module("model.cfg_sampler").ClassifierFreeSampleModel(network)
            diffusion = importlib.import_module("utils.model_util").create_gaussian_diffusion(_OPTIONS)
            recover = importlib.import_module("data_loaders.humanml.scripts.motion_process").recover_from_ric
        mask = torch.ones((problem.batch, 1, 1, problem.frames), dtype=torch.bool, device=problem.device)
        condition = self._condition(problem) | {"mask": mask}

        def sample() -> object:
            motion = diffusion.p_sample_loop(
                model, (problem.batch, 263, 1, problem.frames), clip_denoised=False, model_kwargs={"y": condition}
            )
            return recover(motion.permute(0, 2, 3, 1), 22)

        return network, sample

    def training(self, problem: Problem) -> tuple[torch.nn.Module, Callable[[], object]]:
        """MDM: one training step of the same network."""
        with self._imports():
            network = self._decoder(problem)
        network.train()
        clean = random_features(problem)
        noisy = clean.permute(0, 2, 1)[:, :, None]
        steps = torch.zeros(problem.batch, dtype=torch.long, device=problem.device)
        mask = torch.ones((problem.batch, 1, 1, problem.frames), dtype=torch.bool, device=problem.device)
        condition = self._condition(problem) | {"mask": mask}

        def forward() -> torch.Tensor:
            return network(noisy, steps, condition)[:, :, 0].permute(0, 2, 1)

        return network, training_step(network, forward, clean)

    def _decoder(self, problem: Problem) -> Any:
        """MDM's decoder, which is given DistilBERT's word pieces."""
        vectors = torch.from_numpy(word_pieces().vectors).to(problem.device)
        tokens = vectors[:, None].repeat(1, problem.batch, 1)
        unmasked = torch.zeros((problem.batch, len(tokens)), dtype=torch.bool, device=problem.device)
        network = self._network(problem, arch="trans_dec", text_encoder_type="bert")
        network.encode_text = lambda _: (tokens, unmasked)
        return network

    def optimisation(self, problem: Problem) -> tuple[torch.nn.Module, Callable[[int], object]]:
        """DNO: guided iterations over 10 DDIM steps of the encoder with one sentence vector."""
        with self._imports():
            network = self._network(problem, arch="trans_enc")
            model = importlib.import_module("model.cfg_sampler").ClassifierFreeSampleModel(network).eval()
            create = importlib.import_module("utils.model_util").create_gaussian_diffusion
            diffusion = create(_OPTIONS, timestep_respacing=f"ddim{OPTIMISATION_STEPS}")
            solver = importlib.import_module("dno")
            recover = importlib.import_module("data_loaders.humanml.scripts.motion_process").recover_from_ric
        vector = torch.from_numpy(sentence().vectors).to(problem.device)
        network.encode_text = lambda texts: vector.expand(len(texts), -1)
        condition = self._condition(problem)
        poses = torch.randn((2, problem.batch, 22, 3), generator=torch.Generator().manual_seed(1)).to(problem.device)

        def motion_of(noise: torch.Tensor) -> torch.Tensor:
            state = noise
            for step in reversed(range(diffusion.num_timesteps)):
                steps = torch.tensor([step] * problem.batch, device=problem.device)
                state = diffusion.ddim_sample(model, state, steps, clip_denoised=False, model_kwargs={"y": condition})[
                    "sample"
                ]
            return state

        def criterion(motion: torch.Tensor) -> torch.Tensor:
            joints = recover(motion.permute(0, 2, 3, 1), 22)[:, 0]
            return ((joints[:, 0] - poses[0]).abs() + (joints[:, -1] - poses[1]).abs()).mean(dim=(1, 2)) / 2

        def optimise(iterations: int) -> object:
            noise = torch.randn((problem.batch, 263, 1, problem.frames), device=problem.device)
            search = solver.DNO(motion_of, criterion, noise, solver.DNOOptions(num_opt_steps=400))
            with contextlib.redirect_stderr(io.StringIO()):
                return search(num_steps=iterations)

        return network, optimise

    def _network(self, problem: Problem, **more: object) -> Any:
        torch.manual_seed(0)
        network = importlib.import_module("model.mdm").MDM(
            modeltype="",
            **_SHAPE,
            latent_dim=problem.size.width,
            ff_size=problem.size.feed_forward,
            num_layers=problem.size.layers,
            num_heads=problem.size.heads,
            data_rep="hml_vec",
            dataset="humanml",
            cond_mode="text",
            cond_mask_prob=0.1,
            clip_version="ViT-B/32",
            **more,
        )
        network.eval()  # returns nothing there, as does to()
        network.to(problem.device)
        return network

    @staticmethod
    def _condition(problem: Problem) -> dict[str, object]:
        return {
            "text": [""] * problem.batch,
            "lengths": torch.full((problem.batch,), problem.frames),
            "scale": torch.full((problem.batch,), GUIDANCE, device=problem.device),
        }

    @contextlib.contextmanager
    def _imports(self) -> Iterator[None]:
        """The checkout's modules can be imported inside; afterwards their names are free for another checkout's."""
        finder, before = _Empty(), dict(sys.modules)
        sys.path.insert(0, str(self.folder))
        np.__dict__["float"] = float  # gone since NumPy 1.24
        sys.meta_path.append(finder)
        sys.modules |= {
            "model.rotation2xyz": _module("model.rotation2xyz", Rotation2xyz=_NoBodies),
            "model.BERT.BERT_encoder": _module("model.BERT.BERT_encoder", load_bert=lambda _: torch.nn.Identity()),
        }
        try:
            with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
                warnings.simplefilter("ignore")
                yield
        finally:
            del np.__dict__["float"]
            sys.meta_path.remove(finder)
            sys.path.remove(str(self.folder))
            new = {name: sys.modules[name] for name in sys.modules.keys() - before.keys()}
            for name in [name for name, module in new.items() if _lies_in(module, self.folder)]:
                del sys.modules[name]


class _NoBodies:
    """Instead of the licensed body model, which features of joints do not need."""

    def __init__(self, *_: object, **__: object) -> None:
        self.smpl_model = torch.nn.Identity()


class _EmptyModule(ModuleType):
    """Whatever is asked of it is there, and does nothing."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return type(name, (), {"__init__": lambda *_, **__: None})


class _Empty(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finds an empty module for optional packages; asked last, so only for those that are not installed."""

    def find_spec(
        self,
        fullname: str,
        path: Sequence[str] | None,  # noqa: ARG002
        target: ModuleType | None = None,  # noqa: ARG002
    ) -> importlib.machinery.ModuleSpec | None:
        wanted = fullname.split(".")[0] in _OPTIONAL
        return importlib.machinery.ModuleSpec(fullname, self, is_package=True) if wanted else None

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> ModuleType:
        if spec.name != "clip":
            return _EmptyModule(spec.name)
        unused = _module("clip.model", convert_weights=lambda _: None)
        return _module("clip", load=lambda *_, **__: (torch.nn.Identity(), None), model=unused)

    def exec_module(self, module: ModuleType) -> None:
        """Nothing to run."""


def _module(name: str, **content: object) -> ModuleType:
    module = _EmptyModule(name)
    module.__dict__.update(content)
    return module


def _lies_in(module: ModuleType, folder: Path) -> bool:
    if isinstance(module, _EmptyModule):
        return True
    files = [getattr(module, "__file__", None) or "", *getattr(module, "__path__", [])]
    return any(Path(file).resolve().is_relative_to(folder.resolve()) for file in files if file)
