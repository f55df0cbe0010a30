"""Records of tensors that change together: batches, conditions, frames."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Self

import torch


@dataclass(frozen=True)
class TensorRecord:
    """A record whose tensors, those that are there, change together."""

    def tensors(self) -> dict[str, torch.Tensor]:
        """Return the tensors by the names of their fields."""
        return {name: value for name, value in vars(self).items() if isinstance(value, torch.Tensor)}

    def each(self, change: Callable[[torch.Tensor], torch.Tensor]) -> Self:
        """Return the record with each tensor changed."""
        return replace(self, **{name: change(tensor) for name, tensor in self.tensors().items()})

    def rows(self, index: slice | Sequence[int] | torch.Tensor) -> Self:
        """Return some of the rows, in the order of ``index``."""
        return self.each(lambda tensor: tensor[index])

    def to(self, device: torch.device | str, *, non_blocking: bool = False) -> Self:
        """Return the record on a device."""
        return self.each(lambda tensor: tensor.to(device, non_blocking=non_blocking))

    def pin_memory(self) -> Self:
        """Return the record in page-locked memory, from where a copy to a GPU overlaps with its work."""
        return self.each(lambda tensor: tensor.pin_memory())
