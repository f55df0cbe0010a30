"""A Table 2 of made-up methods: two that work, one that breaks, one without weights, and one that is not installed."""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from prbench.sequences import SequenceTable
from prbench_benchmarks.prime_and_reach.table_two import request as rows
from prbench_benchmarks.prime_and_reach.table_two.request import TableTwo
from tests.fakes import fake_dataset

ADAPTER = """
    from pathlib import Path

    import numpy as np

    from prbench.contract import Condition, Cost, Motions
    from prbench.errors import AdapterError
    from prbench.geometry.skeleton import PARENTS
    from prbench.representation import REST_OFFSETS

    STANDING = np.array(REST_OFFSETS)
    for joint in range(1, 22):
        STANDING[joint] += STANDING[PARENTS[joint]]
    STANDING[:, 1] -= STANDING[:, 1].min()
    LOG = Path({log!r})

    class Made:
        name = {name!r}
        conditions = frozenset({{Condition.TEXT, Condition.GOAL_POSE, Condition.GOAL_LOCATION}})

        def __init__(self, weights, spread):
            self.weights, self.spread = weights, spread
            most = Path(f"{{LOG}}.most-{{weights.stem}}")
            self.max_frames = int(most.read_text()) if most.exists() else None

        def weights_for(self, condition):
            return self.weights

        def generate(self, batch, *, seed):
            with LOG.open("a") as log:
                log.write(f"{name} {{batch.condition.value}} {{len(batch)}}\\n")
            if Path(f"{{LOG}}.stop-{name}").exists():
                raise KeyboardInterrupt
            if {name!r} == "breaker":
                raise ZeroDivisionError("no such luck")
            joints = np.zeros((len(batch), int(batch.n_frames.max()), 22, 3))
            for row, noise_seed in enumerate(batch.noise_seed):
                noise = np.random.default_rng(noise_seed).normal(scale=0.02 * self.spread, size=joints[row].shape)
                begin = STANDING if batch.initial_joints is None else batch.initial_joints[row]
                joints[row] = begin + noise
                if batch.goal_location is not None and {name!r} == "reacher":
                    joints[row, batch.n_frames[row] // 2 :, 21] = batch.goal_location[row]
            return Motions(joints, batch.n_frames, Cost(network_passes=3 * len(batch)))

    def load(weights, *, options, device):
        if weights is not None and weights.name == {name!r} + "-small":
            weights = Path(__file__).parent / weights.name
        if weights is None or not weights.is_file():
            raise AdapterError(f"{name}: found no weights {{weights and weights.name}}. Train some.")
        if set(options) - {{"spread"}}:
            raise ValueError(f"unknown option '{{sorted(options)[0]}}'")
        return Made(weights, float(options.get("spread", 1.0)))
"""

_FINETUNED = {"state": "finetuned", "trained_on": "all", "variant": "fine-tuned"}
TABLE = {
    "table": "2",
    "blocks": [
        {"condition": "none", "title": "No condition"},
        {"condition": "text", "title": "Text"},
        {"condition": "goal-loc", "title": "+ Initial State & Object Loc."},
    ],
    "weights": {
        "mean-training-pose": {"state": "none", "trained_on": "all", "variant": "mean training pose"},
        "breaker-finetuned": _FINETUNED,
        "reacher-pretrained": {"state": "pretrained", "trained_on": "humanml3d", "variant": "zero-shot"},
        "reacher-finetuned": _FINETUNED,
        "absent-finetuned": _FINETUNED,
        "stranger-finetuned": _FINETUNED,
    },
    "rows": [
        dict(zip(("label", "method", "weights", "condition", "bundled"), row))
        for row in (
            ("Static", "static", "mean-training-pose", "none"),
            ("Breaker", "breaker", "breaker-finetuned", "text"),
            ("Stranger", "stranger", "stranger-finetuned", "text"),
            ("Absent", "absent", "absent-finetuned", "goal-loc", "absent-small"),
            ("Reacher †", "reacher", "reacher-pretrained", "goal-loc"),
            ("Reacher", "reacher", "reacher-finetuned", "goal-loc", "reacher-small"),
        )
    ],
}


class MadeUp:
    """The folder of the made-up methods' weights, and the log of what they were asked for."""

    def __init__(self, folder: Path) -> None:
        self.weights, self.log = folder / "weights", folder / "log"
        self.weights.mkdir()
        (self.weights / "breaker-finetuned.safetensors").write_text("b")

    def stop(self, method: str, *, now: bool = True) -> None:
        """Let a method end the whole program, or no more."""
        file = Path(f"{self.log}.stop-{method}")
        file.touch() if now else file.unlink()

    def limit(self, weights: str, frames: int) -> None:
        """Let a method with these weights generate no more frames."""
        Path(f"{self.log}.most-{weights}").write_text(str(frames))

    def calls(self) -> list[str]:
        """Method, condition and number of sequences of every batch since the last time."""
        lines = self.log.read_text().splitlines() if self.log.is_file() else []
        self.log.unlink(missing_ok=True)
        return lines


@pytest.fixture(autouse=True)
def made_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[MadeUp]:
    """The table above in place of the study's, with one control; its methods installed, and a cache of its own."""
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))
    made = MadeUp(tmp_path)
    site = tmp_path / "site"
    for name in ("breaker", "reacher", "absent"):
        info = site / f"made_{name}-1.0.dist-info"
        info.mkdir(parents=True)
        (site / f"made_{name}.py").write_text(textwrap.dedent(ADAPTER.format(name=name, log=str(made.log))))
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: made_{name}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[prbench.adapters]\n{name} = made_{name}:load\n")
        monkeypatch.delitem(sys.modules, f"made_{name}", raising=False)
    (site / "reacher-small").write_text("bundled")
    monkeypatch.syspath_prepend(str(site))
    monkeypatch.setattr(rows, "read_toml", lambda package, name, form: msgspec.convert(TABLE, TableTwo))
    monkeypatch.setattr(rows, "CONTROLS", ("ground-truth",))
    rows.load_table_two.cache_clear()
    yield made
    rows.load_table_two.cache_clear()


@pytest.fixture(scope="session")
def small_tables(tmp_path_factory: pytest.TempPathFactory) -> tuple[SequenceTable, SequenceTable]:
    """Two datasets of 20 sequences, 5 of them in the test split; the study prints the second one first."""
    folder = tmp_path_factory.mktemp("tables")
    return fake_dataset(folder / "adt", 20), fake_dataset(folder / "hd", 20, dataset="synthetic-hd-epic")


@pytest.fixture(scope="session")
def large_table(tmp_path_factory: pytest.TempPathFactory) -> SequenceTable:
    """52 sequences in the test split, of twelve recordings of which three are tested."""
    return fake_dataset(tmp_path_factory.mktemp("tables") / "large", 208, recordings=24)
