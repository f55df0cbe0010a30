"""Why a head looks over its goal: could the condition tell, and does training ask? (docs/error-budget.md#the-nod).

``python -m benchmarks.looking RUN --data TABLE…`` takes a run of `pr` on the validation split and prints two tables:

1. **Determinable.** The mean elevation of the recorded head ray from 0.25 to 0.75 s after the prime, predicted from ten
   numbers of the condition by kernel ridge regression fitted on the table's own train split; the share of the variance
   over the run's sequences that it explains, and that the run's motions explain.
2. **Asked for.** By how much the loss of training falls if the run's motions get the recorded neck-head bone in the
   second after the prime, and what the blocks of features have of it. The motions stand for the network's estimates.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from prbench.evaluation.planning import Selection, select
from prbench.evaluation.scoring import COLUMNS, targets_of
from prbench.representation.features import BLOCKS, FRAME_RATE, N_FEATURES
from prbench.representation.tensors import encode
from prbench.runs import RunFolder
from prbench.runs.predictions import Predictions
from prbench.sequences import SequenceTable
from prbench.skeleton import BONES, Joint, head_forward
from prbench.submitted.score_predictions.again import scored_sequences
from prbench.training.weights import read_weights
from prbench_adapters.diffusion.bundled import bundled_weights
from prbench_adapters.diffusion.model import KIND

_RIDGE = 0.3  # of kernels that are 1 for equal conditions; chosen once, by eye
_LENGTH = 3.0  # standard deviations of a condition's numbers
_LOOK = (0.25, 0.75)  # seconds after the prime: when recorded heads look at the goal


def _elevation(vectors: np.ndarray) -> np.ndarray:
    return np.rad2deg(np.arctan2(vectors[..., 1], np.hypot(vectors[..., 0], vectors[..., 2])))


def _look_frames(n_frames: int, prime: float, fps: float) -> slice:
    begin = min(round((prime + _LOOK[0]) * fps), n_frames - 1)
    return slice(begin, max(min(round((prime + _LOOK[1]) * fps), n_frames), begin + 1))


def _condition(joints: np.ndarray, previous: np.ndarray, goal: np.ndarray, tilt: float) -> list[float]:
    """Ten numbers of what a method knows: where the goal is from the first head, and how the body stands and moves."""
    way = goal - joints[0, Joint.HEAD]
    ahead, _ = head_forward(joints[0], tilt)
    speed = (joints[0, Joint.HEAD] - previous[Joint.HEAD]) * 20.0
    over_ground = float(np.hypot(way[0], way[2]))
    bearing = np.arctan2(way[0], way[2])
    return [
        float(_elevation(way)),
        float(np.log(over_ground + 0.2)),
        float(goal[1]),
        float(np.cos(bearing)),
        float(np.sin(abs(bearing))),
        float(np.log(len(joints))),
        float(_elevation(ahead)),
        float(joints[0, Joint.HEAD, 1]),
        float(np.linalg.norm(speed[[0, 2]])),
        float((speed[0] * way[0] + speed[2] * way[2]) / (over_ground + 0.1)),
    ]


def _rows(selection: Selection, predictions: Predictions | None, samples: int) -> tuple[np.ndarray, ...]:
    """Conditions, and the elevation of the head ray: recorded, and of each sample of a run."""
    conditions, recorded, made = [], [], []
    for _, chunk in selection.windows([*COLUMNS, "previous_joints"]):
        targets = targets_of(chunk, chunk.vectors("goal_location"), None)
        motions = [predictions.motions(tuple(chunk.sequence_ids), k) for k in range(samples)] if predictions else []
        for row in range(len(chunk)):
            frames = slice(chunk.offsets[row], chunk.offsets[row + 1])
            own = chunk.joints[frames].astype(np.float64)
            tilt = float(targets.head_tilt_deg[row])
            look = _look_frames(len(own), float(targets.prime_time[row]), float(targets.fps_of_sequence[row]))
            previous = chunk.poses("previous_joints")[row]
            conditions.append(_condition(own, previous, targets.goal_location[row], tilt))
            recorded.append(_elevation(head_forward(own[look], tilt)[0]).mean())
            made.append([_elevation(head_forward(each.values[frames][look], tilt)[0]).mean() for each in motions])
    return np.array(conditions), np.array(recorded), np.array(made)


def _predicted(conditions: np.ndarray, values: np.ndarray, asked: np.ndarray) -> np.ndarray:
    """Kernel ridge regression with a Gaussian kernel over standardised numbers."""
    mean = conditions.mean(axis=0)
    spread = conditions.std(axis=0) + 1e-6
    known = (conditions - mean) / spread
    wanted = (asked - mean) / spread

    def kernel(one: np.ndarray, other: np.ndarray) -> np.ndarray:
        return np.exp(-((one[:, None] - other[None]) ** 2).sum(axis=2) / (2 * _LENGTH**2))

    weights = np.linalg.solve(kernel(known, known) + _RIDGE * np.eye(len(known)), values - values.mean())
    return values.mean() + kernel(wanted, known) @ weights


def _explained(values: np.ndarray, predicted: np.ndarray) -> float:
    return 1 - float(((values - predicted) ** 2).mean() / values.var())


def _print_determinable(run: RunFolder, table: SequenceTable) -> None:
    known, elevation, _ = _rows(select(table, split="train", limit=None), None, 0)
    predictions = Predictions.open(run.dataset(table.info.dataset).predictions)
    asked, recorded, made = _rows(scored_sequences(run, table), predictions, run.record.samples)
    spread = np.sqrt(made.var(axis=1, ddof=1).mean()) if run.record.samples > 1 else np.nan
    print(
        f"{table.info.dataset:<18} {len(known):>6} {len(asked):>6}"
        f" {_explained(recorded, _predicted(known, elevation, asked)):>12.2f}"
        f" {_explained(recorded, made.mean(axis=1)):>7.2f} {recorded.std():>9.1f} {spread:>9.1f}"
    )


@dataclass(frozen=True)
class _Training:
    """What the bundled weights were trained with."""

    mean: torch.Tensor
    std: torch.Tensor
    weights: dict[str, float]
    """Of joints, velocities and bones, beside the features' 1."""

    @classmethod
    def bundled(cls) -> _Training:
        """Read the statistics of the bundled weights, (features,) each, and the weights of their loss by its parts."""
        path = bundled_weights("pr-small-goal-loc")
        model = json.loads(path.with_suffix(".json").read_text())["configuration"]["model"]
        found = read_weights(path, kind=KIND)
        return cls(
            found.require("statistics.mean", (N_FEATURES,)).float(),
            found.require("statistics.std", (N_FEATURES,)).float(),
            {name: model[f"{name}_loss_weight"] for name in ("joint", "velocity", "bone")},
        )

    def parts(self, made: torch.Tensor, recorded: torch.Tensor) -> dict[str, float]:
        """Each part of the loss of one motion (docs/methods/pr.md#training), features by block; they add up to it."""
        frames = torch.tensor([recorded.shape[1]])
        squared = ((encode(made, frames) - encode(recorded, frames)) / self.std).square()
        error = made - recorded
        parents, children = np.transpose(BONES)
        parts = {block: squared[..., at] for block, at in BLOCKS.items()}
        parts["joints"] = self.weights["joint"] * error.square()
        parts["velocities"] = self.weights["velocity"] * error.diff(dim=1).square()
        parts["bones"] = self.weights["bone"] * (error[:, :, children] - error[:, :, parents]).square()
        return {name: float(part.sum()) / (N_FEATURES * recorded.shape[1]) for name, part in parts.items()}


def _print_asked_for(run: RunFolder, tables: list[SequenceTable]) -> None:
    training = _Training.bundled()
    total: Counter[str] = Counter()
    mended = 0.0
    for table in tables:
        predictions = Predictions.open(run.dataset(table.info.dataset).predictions)
        for _, chunk in scored_sequences(run, table).windows(COLUMNS):
            targets = targets_of(chunk, chunk.vectors("goal_location"), None)
            motions = predictions.motions(tuple(chunk.sequence_ids), 0)
            for row in range(len(chunk)):
                frames = slice(chunk.offsets[row], chunk.offsets[row + 1])
                recorded = torch.from_numpy(chunk.joints[frames].astype(np.float32))[None]
                made = torch.from_numpy(motions.values[frames].astype(np.float32))[None]
                total.update(training.parts(made, recorded))
                mended += sum(
                    training.parts(_with_nod(made, recorded, float(targets.prime_time[row])), recorded).values()
                )
    whole = sum(total.values())
    for name, value in total.most_common():
        print(f"{name:<22} {100 * value / whole:5.1f} %")
    print(f"falls by {100 * (1 - mended / whole):.2f} % with the recorded neck-head bone in the second after the prime")


def _with_nod(made: torch.Tensor, recorded: torch.Tensor, prime: float) -> torch.Tensor:
    """The motion with the recorded bone from neck to head in the second after the prime."""
    begin = round(prime * FRAME_RATE)
    second = slice(begin, begin + round(FRAME_RATE))
    mended = made.clone()
    bone = recorded[:, second, Joint.HEAD] - recorded[:, second, Joint.NECK]
    mended[:, second, Joint.HEAD] = made[:, second, Joint.NECK] + bone
    return mended


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, metavar="RUN")
    parser.add_argument("--data", type=Path, nargs="+", required=True, metavar="TABLE")
    given = parser.parse_args()
    run = RunFolder.open(given.run)
    tables = [SequenceTable.open(folder) for folder in given.data]
    print("share of the variance of people's ray elevation that is explained, and standard deviations, degrees")
    print(f"{'table':<18} {'fitted':>6} {'asked':>6} {'by condition':>12} {'by run':>7} {'people':>9} {'samples':>9}")
    for table in tables:
        _print_determinable(run, table)
    print("\nparts of the loss of training, with the run's first samples as estimates")
    _print_asked_for(run, tables)


if __name__ == "__main__":
    main()
