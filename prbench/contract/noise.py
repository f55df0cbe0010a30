"""Make a sampler that draws from global generators obey the ``noise_seed`` of its sequences.

Most public samplers call ``torch.randn`` without a generator. What comes out then depends on what was drawn before, so
on the batch, its order and the process. Importing this module imports no torch; entering a block does.
"""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any

import numpy as np


@contextmanager
def sequence_noise(noise_seed: int) -> Iterator[None]:
    """Seed the global generators for one sequence; behind the block they go on as if nothing had been drawn.

    These are torch's, on the CPU and on CUDA devices (where torch is installed), ``numpy.random`` and ``random``.
    A sampler then makes the same motion in any batch, at any place and in any process, if it is called for one
    sequence at a time.

    Args:
        noise_seed: Of the sequence (``batch.noise_seed[row]``), 63 bits. Torch takes the lower 32 of them on the CPU:
            of 10,000 sequences two draw the same noise with a probability of 1 %.
    """
    torch = _torch()
    python_state = random.getstate()
    numpy_state = np.random.get_state()  # noqa: NPY002 - the generator that other people's samplers draw from
    with ExitStack() as stack:
        if torch is not None:
            devices = range(torch.cuda.device_count()) if torch.cuda.is_available() else ()
            # fork_rng puts the states back, so that a method leaves no trace in the generators of others.
            stack.enter_context(torch.random.fork_rng(devices=list(devices)))
            torch.manual_seed(noise_seed)
        random.seed(noise_seed)
        np.random.seed([noise_seed & 0xFFFFFFFF, noise_seed >> 32])  # noqa: NPY002 - likewise; it takes 32 bits a word
        try:
            yield
        finally:
            random.setstate(python_state)
            np.random.set_state(numpy_state)  # noqa: NPY002 - likewise


@contextmanager
def batch_noise(noise_seeds: Sequence[int]) -> Iterator[None]:
    """Let ``torch.randn`` and ``torch.randn_like`` draw each row of a batch from its own sequence.

    For samplers that work on a whole batch. Within the block both functions are replaced by such that draw one row
    after the other, on the CPU, each from a generator of its own ``noise_seed``; so a row gets the same noise in any
    batch, and on any device. The shape of a row must not depend on the batch: a sampler that draws as many frames as
    the longest sequence has gives other noise beside a longer one. Other draws from global generators
    (``torch.rand``, ``normal_``, dropout) follow the first row and differ with the batch: work on single sequences
    then (:func:`sequence_noise`).

    Args:
        noise_seeds: Of the sequences (``batch.noise_seed``).

    Raises:
        ImportError: if there is no torch.
        ValueError: in the block, if something is drawn whose first dimension is not the batch.
    """
    import torch

    generators = [torch.Generator().manual_seed(noise_seed) for noise_seed in noise_seeds]
    randn = torch.randn

    def row_by_row(shape: Sequence[int], dtype: Any, device: Any, settings: dict[str, Any]) -> Any:
        if not len(shape) or shape[0] != len(generators):
            raise ValueError(
                f"expected a draw for the {len(generators)} sequences of the batch, one a row, found one of the shape"
                f" {tuple(shape)}. Call the sampler for one sequence at a time, in sequence_noise(noise_seed)."
            )
        # On the CPU whatever the device is: generators of a GPU draw other numbers from the same seed.
        rows = [randn(tuple(shape[1:]), generator=generator, dtype=dtype) for generator in generators]
        drawn = torch.stack(rows).to(device if device is not None else torch.empty(0).device)
        return drawn.requires_grad_() if settings.get("requires_grad") else drawn

    def randn_of_rows(*size: Any, dtype: Any = None, device: Any = None, **settings: Any) -> Any:
        if settings.get("generator") is not None:
            return randn(*size, dtype=dtype, device=device, **settings)
        shape = settings.pop("size", size)
        nested = len(shape) == 1 and not isinstance(shape[0], int)
        return row_by_row(shape[0] if nested else shape, dtype, device, settings)

    def randn_like_rows(like: Any, *, dtype: Any = None, device: Any = None, **settings: Any) -> Any:
        return row_by_row(like.shape, dtype or like.dtype, device if device is not None else like.device, settings)

    replaced = {"randn": randn_of_rows, "randn_like": randn_like_rows}
    kept = {name: getattr(torch, name) for name in replaced}
    with sequence_noise(noise_seeds[0]):
        try:
            for name, function in replaced.items():
                setattr(torch, name, function)
            yield
        finally:
            for name, function in kept.items():
                setattr(torch, name, function)


def _torch() -> Any:
    """The module, or None where it is not installed."""
    try:
        import torch
    except ImportError:
        return None
    return torch
