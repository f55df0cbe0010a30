"""Does the reconstruction error of motion tokens tell cheats from people? The numbers of ``docs/motion-tokens.md``.

Run from the repository's root: ``python -m tests.benchmarks.motion_tokens.plausibility WEIGHTS --data TABLE...
--held-out TABLE...``. The limits of the errors are percentiles over the split ``validation`` of the tables that were
learnt from; people and controls are those of the split ``test`` of ``--data``. Takes a minute of one core and prints
Markdown.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from prbench.board.cheat_search import judged_tables
from prbench.geometry.skeleton import Joint
from prbench.harness.conditions import ConditionSource
from prbench.harness.controls import CONTROLS, GROUND_TRUTH, control_motions
from prbench.harness.planning import open_tables, select
from prbench.metrics import MotionBatch, score
from prbench.protocol.manifests import load_protocol
from prbench.representation import decode, encode
from prbench_benchmarks.motion_tokens.network import Tokeniser
from prbench_benchmarks.motion_tokens.study import reconstruct
from prbench_benchmarks.motion_tokens.training import load_tokeniser

MEASURES = ("features", "joints")


def errors(tokeniser: Tokeniser, joints: np.ndarray) -> tuple[float, float]:
    """Mean squared error of the standardised features, and mean error of the joints seen from the pelvis (mm)."""
    features = encode(joints, next_joints=2 * joints[-1] - joints[-2], source="a motion", upright=False)
    made, _ = reconstruct(tokeniser, features)
    features = features[: len(made)]
    apart = (made - features) / tokeniser.std.numpy()
    first, second = (each - each[:, [Joint.PELVIS]] for each in (decode(made), decode(features)))
    return float(np.square(apart).mean()), 1000 * float(np.linalg.norm(first - second, axis=-1).mean())


def controls(folder: Path, split: str, limit: int, names: list[str]) -> Iterator[tuple[str, list[np.ndarray]]]:
    """Yield the motions of each control on the chosen sequences of a table."""
    for table in open_tables([folder]):
        selection = select(table, split=split, limit=limit)
        source = ConditionSource.read(selection)
        for name in names:
            (motions,) = control_motions(name, selection, source, [np.arange(len(selection))])
            yield name, [joints[:n] for joints, n in zip(motions.joints, motions.n_frames)]


def main() -> None:
    """Print the share of each control's motions that each limit refuses, beside that of Plausible."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("weights", type=Path)
    parser.add_argument("--data", type=Path, nargs="+", required=True)
    parser.add_argument("--held-out", type=Path, nargs="+", required=True)
    parser.add_argument("--limit", type=int, default=48)
    parser.add_argument("--percentile", type=float, nargs="+", default=[95, 99])
    given = parser.parse_args()
    tokeniser, _ = load_tokeniser(given.weights)
    held_out = []
    for folder in given.held_out:
        ((_, motions),) = controls(folder, "validation", given.limit, [GROUND_TRUTH])
        held_out += [errors(tokeniser, joints) for joints in motions]
    limits = {f"{p:g} %": np.percentile(held_out, p, axis=0) for p in given.percentile}
    names = [each.name for each in CONTROLS if each.use == "--method"]
    found = defaultdict(list)
    refused = defaultdict(list)
    for folder in given.data:
        (judged,) = judged_tables([folder], split="test", limit=given.limit)
        for name, motions in controls(folder, "test", given.limit, names):
            found[name] += [errors(tokeniser, joints) for joints in motions]
            made = MotionBatch(np.concatenate(motions), judged.recorded.offsets)
            values = score(made, judged.recorded, judged.targets, load_protocol().metrics, metrics=["plausible"])
            refused[name] += list(1 - values["plausible"].value)
    people = np.array(found[GROUND_TRUTH])
    words = [f"{measure}, {p}" for p in limits for measure in MEASURES]
    words += [f"{word} of the plausible" for word in words if word.startswith(MEASURES[0])]
    header = ["control", "motions", "Plausible", *words, *(f"AUC {measure}" for measure in MEASURES)]
    print("| " + " | ".join(header) + " |", "|---" * len(header) + "|", sep="\n")  # noqa: T201
    for name in names:
        own = np.array(found[name])
        plausible = own[np.array(refused[name]) == 0, 0]
        shares = [100 * np.mean(refused[name]), *(100 * (own > limit).mean(axis=0) for limit in limits.values())]
        shares += [100 * np.mean(plausible > limit[0]) if len(plausible) else np.nan for limit in limits.values()]
        # Probability that a motion of the control has a larger error than one of people.
        larger = [np.mean(own[:, [k]] > people[None, :, k]) for k in range(len(MEASURES))]
        cells = [f"{value:.0f}" for value in np.hstack(shares)] + [f"{value:.2f}" for value in larger]
        print("| " + " | ".join([name, str(len(own)), *cells]) + " |", flush=True)  # noqa: T201
    print({p: limit.round(3).tolist() for p, limit in limits.items()})  # noqa: T201


if __name__ == "__main__":
    main()
