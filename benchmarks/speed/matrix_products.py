"""The matrix products of a piece of work alone: the time that no way of writing it can go below on this machine.

The products are recorded while the work runs, with sizes and strides, and repeated on random numbers. What the work
takes beyond them is everything else: norms, activations, copies, the schedule, Python.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch.utils._python_dispatch import TorchDispatchMode

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
