"""Training of the trackers: windows of tables of tracks, devices hidden at random, and the task of each network."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from prbench.errors import TableError, UsageError
from prbench.geometry.skeleton import rotation_matrices
from prbench.randomness import named_generator
from prbench_adapters.three_points import features
from prbench_adapters.three_points.diffusion import DiffusionConfiguration, TrackDiffusion, turned
from prbench_adapters.three_points.regressor import Regressor, RegressorConfiguration
from prbench_adapters.training.batches import DrawnDataset
from prbench_adapters.training.store import parts_of
from prbench_adapters.training.task import TrainingModule, converted
from prbench_adapters.training.weights import start_from, weights_header
from prbench_benchmarks.three_points.batch import Condition
from prbench_benchmarks.three_points.table import TracksTable

# Maps each method, which is the kind of its weights, to its configuration and its network.
NETWORKS: dict[str, tuple[type[Any], type[Any]]] = {
    "avatarposer": (RegressorConfiguration, Regressor),
    "bodiffusion": (DiffusionConfiguration, TrackDiffusion),
}
_DEVICES = ("device_position", "device_rotation", "device_valid", "rotation_valid")

# Rows of values, two columns of the rotations of 22 joints in their parents (the root's in the world), and offsets.
TrackItem = tuple[Tensor, Tensor, Tensor]


class TracksDataset(DrawnDataset):
    """All tracks of some tables and a split, held in memory: about 750 bytes a frame.

    An item stands for a second of windows; ``dataset[index, epoch]`` draws one of them by the seed, the epoch and the
    index alone.

    Args:
        tables: Folders of tracks, or opened tables.
        split: ``train``, ``validation``, or ``train+validation``.
        window: Frames of a window.
        fps: Frames per second that the tables must have.
        seed: Seed of the draws.

    Raises:
        UsageError: if a table has another frame rate.
        TableError: if a table cannot be read, or has no window of this split.
    """

    def __init__(self, tables: Sequence[Any], *, split: str, window: int, fps: float, seed: int = 0) -> None:
        self.tables = tuple(each if isinstance(each, TracksTable) else TracksTable.open(each) for each in tables)
        self.split, self.window, self.seed = split, window, seed
        self._tracks: list[TrackItem] = []
        self._places: list[tuple[int, int]] = []
        counts: list[int] = []
        for table in self.tables:
            if table.info.fps != fps:
                raise UsageError(f"{table.folder}: expected {fps:g} frames/s, found {table.info.fps:g}: see model.fps.")
            for part in parts_of(split):
                for track in table.chunks(split=part, columns=(*_DEVICES, "rotations", "offsets"), rows=1):
                    position, rotation, *masks = (track.frames(name) for name in _DEVICES)
                    given = (position.reshape(-1, 3, 3), rotation.reshape(-1, 3, 4), *masks)
                    rows = features.track_values(*given, fps=fps)
                    local = torch.from_numpy(rotation_matrices(track.frames("rotations").reshape(-1, 22, 4)))
                    offsets = torch.from_numpy(track.vectors("offsets").reshape(22, 3).copy())
                    starts = range(0, len(rows) - window + 1, int(fps))
                    self._places += [(len(self._tracks), start) for start in starts]
                    self._tracks.append((rows, features.columns_of(local).float(), offsets))
            counts.append(len(self._places) - sum(counts))
            if not counts[-1]:
                raise TableError(f"{table.folder}: expected tracks of {window} frames in split '{split}', found none.")
        self.counts = tuple(counts)
        self.lengths = np.full(len(self._places), window)

    @staticmethod
    def collate(items: Sequence[TrackItem]) -> features.TrackWindows:
        """Stack windows, each in the frame of its last head."""
        rows, columns, offsets = (torch.stack(parts) for parts in zip(*items, strict=True))
        windows, turn, _ = features.in_head_frame(rows)
        return features.TrackWindows(windows, turned(columns, turn.mT), windows[:, :, 36:39].clone(), offsets)

    def __getitem__(self, index: int | tuple[int, int]) -> TrackItem:
        """Return the item of a place, drawn for epoch 0, or for the epoch of a pair ``(index, epoch)``."""
        place, epoch = index if isinstance(index, tuple) else (index, 0)
        track, earliest = self._places[place]
        rows, columns, offsets = self._tracks[track]
        latest = min(earliest + int(self.tables[0].info.fps), len(rows) - self.window + 1)
        first = int(named_generator("prbench-training-track", self.seed, epoch, place).integers(earliest, latest))
        return rows[first : first + self.window], columns[first : first + self.window], offsets


def hidden(windows: features.Windows, generator: torch.Generator) -> features.Windows:
    """Hide devices as they may be missing in use, so that one network serves every case.

    Of the windows 35 % have no wrists, 25 % lack one for a stretch of time or throughout, 20 % lack the rotations of
    both, and 10 % begin later.

    Args:
        windows: Values, 0 where not measured.
        generator: Generator of the draws, on the CPU.
    """
    count, length = windows.shape[:2]
    both, one, turn, late, side, begin, end = torch.rand(7, count, 1, 1, generator=generator)
    share = (torch.arange(1, length + 1) / length)[:, None]  # of the window, 1 at its last frame
    device = torch.arange(3)
    gone = (share >= 2 * begin - 1) & (share < 2 * begin - 1 + 2 * end) & (device == torch.where(side < 0.5, 1, 2))
    seen = ((both >= 0.35) | (device == 0)) & ~((one < 0.25) & gone) & ((late >= 0.1) | (share >= begin))
    with_rotation = seen & ((turn >= 0.2) | (device == 0))
    # A change is known where its frame and the one before are.
    changes = [mask & torch.cat([mask[:, :1], mask[:, :-1]], dim=1) for mask in (with_rotation, seen)]
    return windows * features.device_mask((with_rotation, changes[0], seen, changes[1])).to(windows)


class TrackTraining(TrainingModule):
    """A network of :data:`NETWORKS` with its losses.

    Args:
        kind: Kind of the weights file.
        network: The network in its state before the first step.
        licences: Licences of the data.
        origin: Lines for the card about what the weights build upon.
    """

    def __init__(self, kind: str, network: Any, licences: str, origin: tuple[str, ...] = ()) -> None:
        super().__init__()
        self.kind, self.network, self.licences, self.origin = kind, network, licences, origin

    def forward(self, batch: features.TrackWindows, step: int) -> dict[str, Tensor]:  # pyright: ignore[reportIncompatibleMethodOverride]  # fed with tracks
        """Return the losses of one batch with devices hidden; in validation those under each condition, by its name."""
        generator = self.generator(step)
        if step >= 0:
            return self.network.losses(replace(batch, features=hidden(batch.features, generator)), generator)
        found = {}
        for condition in Condition:
            seen = torch.tensor([True] + 2 * [condition is Condition.HEAD_WRISTS], device=batch.features.device)
            shown = replace(batch, features=batch.features * features.device_mask([seen] * 4))
            found |= {f"{condition.value}_{name}": loss for name, loss in self.network.losses(shown, generator).items()}
        return found

    def weights(self) -> tuple[dict[str, Tensor], dict[str, str]]:
        """Return the network and the header of its file."""
        tensors = {f"network.{name}": tensor for name, tensor in self.network.state_dict().items()}
        header = weights_header(self.kind, self.network.configuration, "three-points-54")
        return tensors, header | {"licence": self.licences}

    def hidden_matrices(self) -> list[nn.Parameter]:
        """Return the matrices of the network's layers."""
        named = self.network.named_parameters()
        return [each for name, each in named if ".layers." in name and name.endswith("weight") and each.ndim == 2]


@dataclass(frozen=True)
class TrackTask:
    """A training task that is fed tracks (:class:`prbench_adapters.training.task.TrainingTask`)."""

    name: str
    stages: tuple[str, ...] = ("train",)
    configurations: str = "prbench_adapters.three_points"

    def items(self, tables: Sequence[Any], split: str, model: Mapping[str, Any], seed: int) -> TracksDataset:
        """Return windows of some folders or tables, as long as the network's."""
        shape = converted(model, NETWORKS[self.name][0], "model")
        return TracksDataset(tables, split=split, window=shape.window, fps=shape.fps, seed=seed)

    def build(self, model: Mapping[str, Any], *, data: Any, initial: Path | None, stage: str) -> TrackTraining:  # noqa: ARG002
        """Make the network in its state before the first step, or in that of weights to go on from.

        Raises:
            UsageError: if the table does not describe such a network.
            InputFileError: if the initial weights do not fit it.
        """
        sizes, network_of = NETWORKS[self.name]
        network = network_of(converted(model, sizes, "model"))
        origin = start_from(initial, self.name, network.configuration, network)
        licences = "; ".join(sorted({table.info.licence for table in data.tables}))
        return TrackTraining(self.name, network, licences, origin)
