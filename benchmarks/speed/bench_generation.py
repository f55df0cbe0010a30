"""Time sampling, noise optimisation and training steps, beside the public code of MDM and DNO where it is given.

Run from the repository's root: ``python -m benchmarks.speed.bench_generation --reference DIR``. Every product of
matrices of our own work is recorded and repeated alone: nothing written in PyTorch is faster than that here.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import importlib.abc
import importlib.machinery
import io
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, Literal

import numpy as np
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from benchmarks.speed.work import Row, print_rows
from prbench.contract import Condition, ConditionBatch
from prbench.text import EncodedText
from prbench_adapters.diffusion.configuration import DenoiserConfiguration
from prbench_adapters.diffusion.denoiser import Denoiser
from prbench_adapters.diffusion.generation import SamplingSettings, generate, start_noise
from prbench_adapters.diffusion.model import MotionModel, TextVectors
from prbench_adapters.diffusion.noise_optimisation.generation import optimise_noise
from prbench_adapters.diffusion.noise_optimisation.optimise import Targets, keyframes
from prbench_adapters.diffusion.noise_optimisation.settings import OptimisationSettings

_PRODUCTS = ("mm", "addmm", "bmm", "baddbmm", "_scaled_dot_product")
"""Beginnings of the names of operations that multiply matrices."""


class _Recorder(TorchDispatchMode):
    """Notes every product that runs inside."""

    def __init__(self) -> None:
        super().__init__()
        self.calls: list[Callable[[], object]] = []
        self._inputs: dict[tuple[object, ...], torch.Tensor] = {}

    def __torch_dispatch__(
        self, func: Any, types: object, args: tuple[Any, ...] = (), kwargs: dict[str, Any] | None = None
    ) -> object:
        kwargs = kwargs or {}
        if func.overloadpacket.__name__.startswith(_PRODUCTS):
            own = [self._like(value) for value in args]
            named = {name: self._like(value) for name, value in kwargs.items()}
            self.calls.append(lambda: func(*own, **named))
        return func(*args, **kwargs)

    def _like(self, value: Any) -> Any:
        """Return random numbers in the place of a tensor; products of equal sizes share theirs."""
        if not isinstance(value, torch.Tensor) or not value.is_floating_point():
            return value
        key = (tuple(value.shape), value.stride(), value.dtype, value.device)
        if key not in self._inputs:
            # An expanded tensor has fewer numbers than places.
            size = 1 + sum((n - 1) * step for n, step in zip(value.shape, value.stride(), strict=True))
            numbers = torch.randn(size, dtype=value.dtype, device=value.device) * 0.01
            self._inputs[key] = numbers.as_strided(value.shape, value.stride())
        return self._inputs[key]


def products_of(work: Callable[[], object]) -> Callable[[], None]:
    """Return a function that repeats the matrix products of some work, in their order.

    Args:
        work: Runs once, to see what it multiplies.
    """
    recorder = _Recorder()
    with recorder:
        work()

    @torch.no_grad()
    def repeat() -> None:
        for call in recorder.calls:
            call()

    return repeat


Precision = Literal["float32", "bfloat16"]

PROMPT = "The person moves across and picks an object."
DIFFUSION_STEPS = 50
OPTIMISATION_STEPS = 10
"""Of the deterministic chain, in one iteration of noise optimisation."""
GUIDANCE = 2.5
WORD_PIECES = 11
"""Of the prompt in DistilBERT's vocabulary, its two special ones included."""


@dataclass(frozen=True)
class Size:
    """A network, the same for everybody."""

    name: str
    width: int
    heads: int
    layers: int
    feed_forward: int


SIZES = {
    size.name: size
    for size in (
        Size("paper", width=512, heads=4, layers=8, feed_forward=1024),
        Size("small", width=128, heads=4, layers=4, feed_forward=448),
    )
}


@dataclass(frozen=True)
class Problem:
    """How many motions of how many frames are made at once, by which network, where."""

    size: Size
    frames: int
    batch: int
    device: str = "cpu"


class FixedText:
    """Stands for a text encoder whose vectors are known: random ones, the same for every text and for everybody."""

    def __init__(self, dimension: int, tokens: int) -> None:
        self.name, self.dimension = "fixed", dimension
        self.vectors = np.random.default_rng(0).normal(size=(tokens, dimension)).astype(np.float32)

    def encode(self, texts: Sequence[str]) -> EncodedText:
        """The one answer, once a text."""
        tokens = np.tile(self.vectors, (len(texts), 1, 1))
        return EncodedText(tokens, np.zeros(tokens.shape[:2], dtype=bool))


def word_pieces() -> FixedText:
    """Stand in for DistilBERT: one vector a word piece."""
    return FixedText(768, WORD_PIECES)


def sentence() -> FixedText:
    """Stand in for CLIP: one vector a text."""
    return FixedText(512, 1)


def our_model(
    problem: Problem, architecture: Literal["decoder", "encoder"], text: FixedText, *, frames_per_token: int = 1
) -> MotionModel:
    """A frozen model with random weights."""
    torch.manual_seed(0)
    configuration = DenoiserConfiguration(
        architecture=architecture,
        width=problem.size.width,
        heads=problem.size.heads,
        layers=problem.size.layers,
        feed_forward=problem.size.feed_forward,
        frames_per_token=frames_per_token,
        text_dimension=text.dimension,
        diffusion_steps=DIFFUSION_STEPS,
        max_frames=problem.frames,
    )
    denoiser = Denoiser(configuration).to(problem.device)
    return MotionModel(denoiser, mean=torch.zeros(263), std=torch.ones(263), scaling=None, texts=TextVectors(text))


def n_parameters(model: torch.nn.Module) -> int:
    """Count the parameters of a network."""
    return sum(parameter.numel() for parameter in model.parameters())


def our_sampling(
    problem: Problem, *, precision: Precision = "float32", frames_per_token: int = 1
) -> Callable[[], object]:
    """Text to joints: 50 guided DDPM steps of the decoder with DistilBERT's word pieces, as ``--method mdm`` does."""
    model = our_model(problem, "decoder", word_pieces(), frames_per_token=frames_per_token)
    batch, settings = _conditions(problem), SamplingSettings(guidance=GUIDANCE, precision=precision)
    return lambda: generate(model, batch, settings)


def our_optimisation(problem: Problem, *, precision: Precision = "float32") -> Callable[[int], object]:
    """So many guided iterations of DNO on the encoder with one sentence vector: forward, backward, Adam."""
    model = our_model(problem, "encoder", sentence())
    batch = _conditions(problem)
    targets, n_frames = _targets(problem), torch.as_tensor(batch.n_frames)
    condition = model.encode(batch)

    def optimise(iterations: int) -> object:
        settings = OptimisationSettings(
            ddim_steps=OPTIMISATION_STEPS,
            iterations=iterations,
            guidance=GUIDANCE,
            batch_size=problem.batch,
            precision=precision,
        )
        noise = start_noise(batch.noise_seed, batch.n_frames, problem.device)
        return optimise_noise(
            model, condition, targets, n_frames, noise, settings, seeds=batch.noise_seed, objective=keyframes
        )

    return optimise


def our_training(problem: Problem) -> Callable[[], object]:
    """One training step of the decoder with DistilBERT's word pieces: forward, squared error, backward, AdamW."""
    model = our_model(problem, "decoder", word_pieces())
    batch = _conditions(problem)
    condition = model.encode(batch)
    denoiser = model.denoiser.train().requires_grad_(True)
    clean = random_features(problem)
    steps = torch.zeros(problem.batch, dtype=torch.long, device=problem.device)
    n_frames = torch.as_tensor(batch.n_frames)
    return training_step(denoiser, lambda: denoiser(clean, steps, condition, n_frames), clean)


def random_features(problem: Problem) -> torch.Tensor:
    """The same motions for everybody, (batch, frames, 263)."""
    generator = torch.Generator().manual_seed(2)
    return torch.randn((problem.batch, problem.frames, 263), generator=generator).to(problem.device)


def training_step(
    network: torch.nn.Module, forward: Callable[[], torch.Tensor], clean: torch.Tensor
) -> Callable[[], object]:
    """Forward, mean squared error, backward and AdamW."""
    optimiser = torch.optim.AdamW(network.parameters(), lr=1e-4)

    def step() -> object:
        optimiser.zero_grad(set_to_none=True)
        loss = (forward() - clean).square().mean()
        loss.backward()
        optimiser.step()
        return loss

    return step


def _conditions(problem: Problem) -> ConditionBatch:
    return ConditionBatch(
        condition=Condition.TEXT,
        n_frames=np.full(problem.batch, problem.frames),
        fps=20.0,
        opaque_id=tuple(map(str, range(problem.batch))),
        noise_seed=tuple(range(problem.batch)),
        text=(PROMPT,) * problem.batch,
    )


def _targets(problem: Problem) -> Targets:
    poses = torch.randn((2, problem.batch, 22, 3), generator=torch.Generator().manual_seed(1)).to(problem.device)
    return Targets(initial_joints=poses[0], previous_joints=poses[0], goal_joints=poses[1])


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


Work = Callable[[], object]
Clock = Callable[[], float]


def main() -> None:
    """One table a size and job."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--reference", type=Path, action="append", default=[], metavar="DIR")
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    parser.add_argument(
        "--processor-time", action="store_true", help="of all threads; for one thread on a busy machine"
    )
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--sizes", nargs="+", choices=SIZES, default=list(SIZES))
    parser.add_argument("--jobs", nargs="+", default=["sampling", "optimisation", "training"])
    parser.add_argument("--frames", type=int, default=150)
    parser.add_argument("--batch", type=int, nargs="+", default=[1, 8], help="sequences at once")
    parser.add_argument("--iterations", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    clock: Clock = time.process_time if options.processor_time else time.perf_counter
    checkouts = {checkout.name: checkout for checkout in map(Checkout, options.reference)}
    print(f"{options.threads} threads, {options.device}, torch {torch.__version__}, guidance {GUIDANCE}")
    for size in options.sizes:
        for batch in options.batch:
            problem = Problem(SIZES[size], options.frames, batch, options.device)
            if "sampling" in options.jobs:
                time_sampling(problem, checkouts.get("MDM"), options.repeats, clock)
            if "optimisation" in options.jobs:
                time_optimisation(problem, checkouts.get("DNO"), options.repeats, options.iterations, clock)
            if "training" in options.jobs:
                time_training(problem, checkouts.get("MDM"), options.repeats, clock)


def time_sampling(problem: Problem, reference: Checkout | None, repeats: int, clock: Clock) -> None:
    """50 guided DDPM steps of the decoder with DistilBERT's word pieces, text vectors to joints."""
    ours = n_parameters(our_model(problem, "decoder", word_pieces()).denoiser)
    jobs: dict[str, Work] = {
        "prbench, float32": our_sampling(problem),
        "prbench, bfloat16": our_sampling(problem, precision="bfloat16"),
        "prbench, float32, two frames a token (another network)": our_sampling(problem, frames_per_token=2),
    }
    jobs["its matrix products alone, float32"] = products_of(jobs["prbench, float32"])
    if reference is not None:
        theirs, sample = reference.sampling(problem)
        _require_equal_size(ours, theirs)
        jobs["MDM's public code"] = sample
    title = f"one sequence of {problem.frames} frames by {DIFFUSION_STEPS} guided steps"
    rows = [Row(name, seconds / problem.batch) for name, seconds in shortest(jobs, repeats, clock).items()]
    _print(title, problem, ours, rows)


def time_optimisation(
    problem: Problem, reference: Checkout | None, repeats: int, iterations: int, clock: Clock
) -> None:
    """One guided iteration of noise optimisation over 10 steps of the encoder with one sentence vector."""
    ours = n_parameters(our_model(problem, "encoder", sentence()).denoiser)
    searches = {
        "prbench, float32": our_optimisation(problem),
        "prbench, bfloat16": our_optimisation(problem, precision="bfloat16"),
    }
    if reference is not None:
        theirs, searches["DNO's public code"] = reference.optimisation(problem)
        _require_equal_size(ours, theirs)
    first: dict[str, Work] = {name: lambda search=search: search(1) for name, search in searches.items()}
    more: dict[str, Work] = {
        f"{name}, more": lambda search=search: search(1 + iterations) for name, search in searches.items()
    }
    alone = "its matrix products alone, float32"
    first[alone] = products_of(first["prbench, float32"])
    more[f"{alone}, more"] = products_of(more["prbench, float32, more"])
    seconds = shortest(first | more, repeats, clock)
    rows = [Row(name, (seconds[f"{name}, more"] - seconds[name]) / (iterations * problem.batch)) for name in first]
    title = f"one guided iteration over {OPTIMISATION_STEPS} steps, {problem.frames} frames"
    _print(title, problem, ours, rows)


def time_training(problem: Problem, reference: Checkout | None, repeats: int, clock: Clock) -> None:
    """One training step of the decoder with DistilBERT's word pieces."""
    ours = n_parameters(our_model(problem, "decoder", word_pieces()).denoiser)
    jobs: dict[str, Work] = {"prbench, float32": our_training(problem)}
    jobs["its matrix products alone, float32"] = products_of(jobs["prbench, float32"])
    if reference is not None:
        theirs, jobs["MDM's public code"] = reference.training(problem)
        _require_equal_size(ours, theirs)
    rows = [Row(name, seconds / problem.batch) for name, seconds in shortest(jobs, repeats, clock).items()]
    _print(f"one training step, {problem.frames} frames", problem, ours, rows)


def shortest(jobs: dict[str, Work], repeats: int, clock: Clock) -> dict[str, float]:
    """The shortest time of each job; they take turns, so that a busy moment meets all of them alike."""
    best = dict.fromkeys(jobs, float("inf"))
    for turn in range(repeats + 1):  # the first turn warms up
        for name, work in jobs.items():
            seconds = _seconds(work, clock)
            best[name] = min(best[name], seconds) if turn else best[name]
    return best


def _seconds(work: Work, clock: Clock) -> float:
    start = clock()
    work()
    if torch.cuda.is_available():
        torch.cuda.synchronize()
    return clock() - start


def _require_equal_size(ours: int, theirs: torch.nn.Module) -> None:
    if ours != n_parameters(theirs):
        raise SystemExit(f"networks of different size: ours {ours:,} parameters, theirs {n_parameters(theirs):,}.")


def _print(title: str, problem: Problem, parameters: int, rows: Sequence[Row]) -> None:
    together = f"{problem.batch} at once" if problem.batch > 1 else "one at a time"
    print_rows(f"{title}, {parameters / 1e6:.1f} M parameters, {together}", rows)


if __name__ == "__main__":
    main()
