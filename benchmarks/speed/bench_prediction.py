"""Time K futures of a window by GazeMoDiff, beside its public code where that is given.

Run from the repository's root, on an otherwise idle machine:

    python -m benchmarks.speed.bench_prediction [--reference DIR] [--windows 8] [--samples 50] [--threads 1]

``--reference`` names a checkout of github.com/yhd-ai/Gazemodiff. Theirs and ours then run in turn in this process with
the same random weights, the same noise and the same observed frames, in evaluation mode: theirs as its evaluation does,
one pass over all windows for each sample; ours with every window encoded once and all samples together. The futures of
both are compared before anything is timed. Seconds are per window, the shortest of some repetitions.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import io
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from benchmarks.speed.bench_generation import shortest
from benchmarks.speed.work import Row, print_rows
from prbench_adapters.prediction.coefficient_diffusion import CoefficientDiffusion, padded
from prbench_adapters.prediction.configuration import preset
from tests.adapters.prediction.golden import load_denoiser, load_encoder

JOINTS = 21
"""Those of MoGaze; gaze is one node more."""
TOLERANCE = 1e-3
"""Metres between theirs and ours after 100 steps in float32, whose angles and schedule they round."""


def main() -> None:
    """Compare values, then time encoding and whole predictions."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--reference", type=Path, metavar="DIR")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument(
        "--processor-time", action="store_true", help="of all threads; for one thread on a busy machine"
    )
    parser.add_argument("--windows", type=int, default=8, help="windows at once; its evaluation takes 32")
    parser.add_argument("--samples", type=int, default=50)
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--repeats", type=int, default=1)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    torch.manual_seed(0)
    model = CoefficientDiffusion(preset("gazemodiff-code", n_joints=JOINTS, sampling_steps=options.steps)).eval()
    observed = 0.5 * torch.randn((options.windows, model.configuration.observed, JOINTS + 1, 3)).cumsum(dim=1)
    encoding: dict[str, Callable[[], object]] = {"prbench": lambda: _encoded(model, observed)}
    predicting: dict[str, Callable[[], object]] = {"prbench": lambda: ours(model, observed, options.samples)}
    if options.reference is not None:
        reference = Reference(options.reference, model)
        _require_equal(ours(model, observed[:1], 1), reference.predict(observed[:1], 1))
        encoding["its public code"] = lambda: reference.encoded(observed)
        predicting["its public code"] = lambda: reference.predict(observed, options.samples)
    clock = time.process_time if options.processor_time else time.perf_counter
    print(f"{options.threads} threads, torch {torch.__version__}, {options.windows} windows, {options.steps} steps")
    for title, jobs in (
        ("one encoding of a window", encoding),
        (f"{options.samples} futures of a window", predicting),
    ):
        found = shortest(jobs, options.repeats, clock)
        print_rows(title, [Row(name, seconds / options.windows) for name, seconds in found.items()])


@torch.no_grad()
def ours(model: CoefficientDiffusion, observed: Tensor, samples: int) -> Tensor:
    """Futures (windows, samples, 60, 63) with the noise that the public code draws."""
    shape = (len(observed), model.configuration.coefficients, model.configuration.values)
    generators = [torch.Generator().manual_seed(sample) for sample in range(samples)]

    def draw() -> Tensor:
        return torch.stack([torch.randn(shape, generator=each) for each in generators], dim=1)

    known = model.transform(padded(observed, model.configuration.frames))
    *_, final = model.states(known, model.condition(known), draw)
    return model.transform.inverse(final)[:, :, model.configuration.observed :, :JOINTS].flatten(-2)


@torch.no_grad()
def _encoded(model: CoefficientDiffusion, observed: Tensor) -> Tensor:
    return model.condition(model.transform(padded(observed, model.configuration.frames)))


class Reference:
    """The public code with random weights, of which ours takes a copy.

    Args:
        folder: The checkout.
        model: Ours; gets the weights of theirs.
    """

    def __init__(self, folder: Path, model: CoefficientDiffusion) -> None:
        if not (folder / "models" / "transformer_crossatt.py").is_file():
            raise SystemExit(f"{folder}: expected a checkout with models/transformer_crossatt.py, found none.")
        shape = model.configuration
        with _imports(folder):
            transformer = importlib.import_module("models.transformer_crossatt").MotionTransformer
            graph = importlib.import_module("models.graph_attention_network_spatialtemporal").graph_convolution_network
            diffusion = importlib.import_module("models.diffusion").Diffusion
            matrices = importlib.import_module("utils.util").get_dct_matrix(shape.frames)
        self.dct, self.inverse = (matrix.float() for matrix in matrices)
        self.denoiser = transformer(
            input_feats=shape.values,
            num_frames=shape.coefficients,
            num_layers=shape.layers,
            num_heads=shape.heads,
            latent_dim=shape.width,
            dropout=shape.dropout,
        ).eval()
        self.encoder = graph(
            in_features=3,
            latent_features=shape.encoder_width,
            node_n=shape.nodes,
            seq_len=shape.coefficients,
            p_dropout=shape.fusion_dropout,
            residual_gcns_num=shape.fusion_blocks,
        ).eval()
        self.diffusion = diffusion(
            noise_steps=shape.diffusion_steps,
            motion_size=(shape.coefficients, shape.values),
            device="cpu",
            padding="LastFrame",
            ddim_timesteps=shape.sampling_steps,
            scheduler="Cosine",
            mod_test=1.0,
            dct=self.dct,
            idct=self.inverse,
            n_pre=shape.coefficients,
        )
        self.shape = shape
        # Give layers that begin with zeros small weights, so that what is compared is no constant.
        generator = torch.Generator().manual_seed(1)
        for parameter in self.denoiser.parameters():
            if not bool(parameter.any()):
                parameter.data = 0.02 * torch.randn(parameter.shape, generator=generator)
        load_denoiser(model.denoiser, _arrays(self.denoiser))
        load_encoder(model.encoder, _arrays(self.encoder))

    @torch.no_grad()
    def encoded(self, observed: Tensor) -> Tensor:
        """The condition, by its own evaluation's reshapes."""
        shape = self.shape
        known = self._known(observed)
        return self.encoder(known.reshape(len(known), 3, shape.nodes, shape.coefficients)).reshape(known.shape)

    @torch.no_grad()
    def predict(self, observed: Tensor, samples: int) -> Tensor:
        """Futures (windows, samples, 60, 63), as its evaluation makes them: a pass over all windows for each sample."""
        shape = self.shape
        mask = torch.zeros((len(observed), shape.frames, shape.values))
        mask[:, : shape.observed] = 1
        passes = []
        for sample in range(samples):
            torch.manual_seed(sample)
            known = self._known(observed)
            # Its evaluation encodes in every pass anew.
            condition = self.encoded(observed)
            mode = {"mask": mask, "sample_num": len(observed), "mode": "metrics"}
            final = self.diffusion.sample_ddim(self.denoiser, known, condition, mode)
            motion = self.inverse[:, : shape.coefficients] @ final
            passes.append(motion[:, shape.observed :, : 3 * JOINTS])
        return torch.stack(passes, dim=1)

    def _known(self, observed: Tensor) -> Tensor:
        last = observed[:, -1:].expand(-1, self.shape.predicted, -1, -1)
        return self.dct[: self.shape.coefficients] @ torch.cat([observed, last], dim=1).flatten(2)


def _arrays(network: torch.nn.Module) -> dict[str, np.ndarray]:
    return {f"w/{name}": tensor.numpy() for name, tensor in network.state_dict().items()}


def _require_equal(found: Tensor, expected: Tensor) -> None:
    apart = float((found - expected).abs().max())
    largest = float(expected.abs().max())
    print(f"largest difference of theirs and ours: {apart:.1e} m, of values up to {largest:.1f} m")
    if not apart <= TOLERANCE * max(largest, 1.0):
        raise SystemExit(f"values differ by {apart:g} m; what is timed would not be the same work.")


@contextlib.contextmanager
def _imports(folder: Path) -> Iterator[None]:
    """The checkout's modules can be imported inside; afterwards their names are free again."""
    before: dict[str, Any] = dict(sys.modules)
    sys.path.insert(0, str(folder))
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            yield
    finally:
        sys.path.remove(str(folder))
        for name in sys.modules.keys() - before.keys():
            if name.split(".")[0] in ("models", "utils"):
                del sys.modules[name]


if __name__ == "__main__":
    main()
