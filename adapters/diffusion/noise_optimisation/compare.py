"""Run the fast mode against the paper's on fixed held-out sequences and publish losses, curves and a verdict.

``python -m prbench_adapters.diffusion.noise_optimisation.compare --data DIR --out DIR [--sequences 16]``. A mode whose
files are already in the output folder, made with the same settings, weights and sequences, is not run again, so the two
modes can be run in separate processes. Published are ``<mode>.csv`` (a row a sequence), ``<mode>_curve.csv`` and
``curves.png`` (passes against loss) and ``verdict.json``.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from prbench.contract import Condition, ConditionBatch
from prbench.errors import PrbenchError, UsageError
from prbench.evaluation.conditions import ConditionSource, run_salt
from prbench.evaluation.planning import Selection, select, supported
from prbench.manifests import load_protocol
from prbench.metrics import UNKNOWN_HAND, MotionBatch, ScoringTargets, score
from prbench.sequences import SequenceTable
from prbench.storage import read_json, write_json
from prbench_adapters.diffusion.bundled import resolve
from prbench_adapters.diffusion.model import MotionModel
from prbench_adapters.diffusion.noise_optimisation.comparison import (
    CURVE_COLUMNS,
    SEQUENCE_COLUMNS,
    ModeResult,
    curve,
    draw_curves,
    read_curve,
    verdict,
    write_csv,
)
from prbench_adapters.diffusion.noise_optimisation.generation import optimise_batch
from prbench_adapters.diffusion.noise_optimisation.objective import keyframes, prime_and_reach
from prbench_adapters.diffusion.noise_optimisation.optimise import OptimisedMotions
from prbench_adapters.diffusion.noise_optimisation.settings import (
    OptimisationSettings,
    fast,
    optimisation_settings,
    paper,
)

_MODES = {"fast": fast, "paper": paper}
_SIDES = {"left": 0, "right": 1}
_DEFAULT_WEIGHTS = {"goal-loc": "pr-small-goal-loc", "goal-pose": "pr-small-goal-pose"}


@dataclass(frozen=True)
class _Trial:
    """Sequences and model that both modes are run on."""

    model: MotionModel
    selection: Selection
    batch: ConditionBatch
    method: str


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the modes that are asked for; with both at hand, print and write the verdict."""
    given = _parser().parse_args(arguments)
    torch.set_num_threads(given.threads)
    try:
        trial = _trial(given)
        for mode in given.modes.split(","):
            _run(mode, trial, _settings(mode, given, trial.model), given.out)
        if all((given.out / f"{mode}.json").is_file() for mode in _MODES):
            _conclude(trial, given.out)
    except PrbenchError as error:
        print(f"compare: {error}", file=sys.stderr)  # noqa: T201 - a command
        return error.exit_code
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m prbench_adapters.diffusion.noise_optimisation.compare")
    parser.add_argument("--data", type=Path, required=True, help="folder of a sequence table")
    parser.add_argument("--out", type=Path, required=True, help="folder for the results")
    parser.add_argument("--split", default="test")
    parser.add_argument("--sequences", type=int, default=16, help="how many, by the smallest hash of their id")
    parser.add_argument("--condition", choices=list(_DEFAULT_WEIGHTS), default="goal-loc")
    parser.add_argument("--method", choices=["pr", "dno"], default="pr", help="whose objective and conditions")
    parser.add_argument("--weights", type=Path, help="file, folder or bundled name")
    parser.add_argument("--modes", default="fast,paper", help="which to run now")
    for mode in _MODES:
        parser.add_argument(f"--{mode}-option", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    parser.add_argument("--seed", type=int, default=0)
    return parser


def _trial(given: argparse.Namespace) -> _Trial:
    default = "mdm-small" if given.method == "dno" else _DEFAULT_WEIGHTS[given.condition]
    model = MotionModel.load(resolve(given.weights, default), given.device)
    configuration = model.configuration
    table = SequenceTable.open(given.data).with_sequences()
    # By the hash of the ids, so that both modes, in processes of their own, take the same sequences.
    everything = select(table, split=given.split, limit=given.sequences)
    selection = supported(everything, max_frames=configuration.max_frames, native_fps=None)
    if selection.fps != configuration.fps:
        raise UsageError(f"the table has {selection.fps:g} fps, the model {configuration.fps:g}")
    source = ConditionSource.read(selection)
    salt = run_salt(given.seed, table.identity)
    condition = Condition(given.condition)
    batch = source.batch(np.arange(len(selection)), condition, seed=given.seed, salt=salt, sample=0)
    return _Trial(model, selection, batch, given.method)


def _settings(mode: str, given: argparse.Namespace, model: MotionModel) -> OptimisationSettings:
    if mode not in _MODES:
        raise UsageError(f"unknown mode '{mode}'; there are {', '.join(_MODES)}.")
    steps = model.configuration.diffusion_steps
    pairs = [option.partition("=") for option in getattr(given, f"{mode}_option")]
    try:
        options = {key: value for key, _, value in pairs}
        return optimisation_settings(options, _MODES[mode](steps), diffusion_steps=steps)
    except ValueError as error:
        raise UsageError(f"--{mode}-option: {error}") from error


def _run(mode: str, trial: _Trial, settings: OptimisationSettings, out: Path) -> None:
    out.mkdir(parents=True, exist_ok=True)
    made_of = {
        "settings": settings.record(),
        "weights": trial.model.digest,
        "sequences": trial.selection.digest,
        "condition": trial.batch.condition.value,
        "noise_seed": list(trial.batch.noise_seed),
        "method": trial.method,
    }
    record = out / f"{mode}.json"
    # Hours of optimisation are not repeated for the same settings, weights and sequences.
    if record.is_file() and _made_of(record) == made_of:
        return
    started = time.perf_counter()
    objective = keyframes if trial.method == "dno" else prime_and_reach
    texts = ("",) * len(trial.batch) if trial.method == "dno" else None
    found = optimise_batch(trial.model, trial.batch, settings, objective=objective, texts=texts)
    seconds = time.perf_counter() - started
    write_csv(out / f"{mode}.csv", SEQUENCE_COLUMNS, _result(trial, found).rows())
    write_csv(out / f"{mode}_curve.csv", CURVE_COLUMNS, curve(found))
    # Written last: a record without its tables would count as a finished mode.
    write_json(record, {"made_of": made_of, "seconds": seconds, "torch_threads": torch.get_num_threads()})
    print(f"{mode}: {len(trial.batch)} sequences in {seconds:.0f} s")  # noqa: T201 - a command


def _made_of(record: Path) -> object:
    content = read_json(record)
    return content.get("made_of") if isinstance(content, dict) else None


def _result(trial: _Trial, found: OptimisedMotions) -> ModeResult:
    """Losses with the two success rates of the protocol."""
    joints = found.joints.cpu().numpy()
    predicted = MotionBatch.from_padded(joints, trial.selection.n_frames)
    recorded, targets = _recorded(trial.selection)
    scores = score(predicted, recorded, targets, load_protocol().metrics, metrics=["prime_success", "reach_success"])
    return ModeResult(
        trial.selection.sequence_ids,
        *(getattr(found, name).double().cpu().numpy() for name in ("initial", "goal", "jerk")),
        prime_success=scores["prime_success"].value,
        reach_success=scores["reach_success"].value,
        network_passes=found.network_passes.double().numpy(),
    )


def _recorded(selection: Selection) -> tuple[MotionBatch, ScoringTargets]:
    """The recorded motions and what they are scored by; few sequences, so all at once."""
    columns = ["goal_location", "prime_time", "start_time", "hand", "head_tilt_deg", "joints"]
    chunks = [chunk for _, chunk in selection.windows(columns)]
    motions = [
        chunk.joints[chunk.offsets[row] : chunk.offsets[row + 1]] for chunk in chunks for row in range(len(chunk))
    ]
    hands = [_SIDES.get(side, UNKNOWN_HAND) for chunk in chunks for side in chunk.strings("hand")]
    return MotionBatch.from_motions(motions), ScoringTargets(
        goal_location=np.concatenate([chunk.vectors("goal_location") for chunk in chunks]).astype(np.float64),
        prime_time=np.concatenate([chunk.numbers("prime_time") - chunk.numbers("start_time") for chunk in chunks]),
        hand=np.array(hands),
        head_tilt_deg=np.concatenate([chunk.numbers("head_tilt_deg") for chunk in chunks]),
        fps=selection.fps,
    )


def _conclude(trial: _Trial, out: Path) -> None:
    results = {mode: ModeResult.read(out / f"{mode}.csv") for mode in _MODES}
    found = verdict(results["fast"], results["paper"], trial.selection.recording_ids)
    write_json(out / "verdict.json", found)
    draw_curves(out / "curves.png", {mode: read_curve(out / f"{mode}_curve.csv") for mode in _MODES})
    for key, value in found.items():
        print(f"{key}: {value}")  # noqa: T201 - a command


if __name__ == "__main__":
    sys.exit(main())
