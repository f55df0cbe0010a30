"""Every way in which a command writes, small: for tests of kills and of two processes at once."""

from __future__ import annotations

import contextlib
import io
import os
import shutil
import socket
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

from prbench.cli.builds import NOT_EVERYTHING
from prbench.cli.main import main
from prbench.errors import StorageError
from prbench.readers.egoallo.synthetic import write_smplh_model
from tests.adapters.training.toy import entry_points_of
from tests.benchmarks.motion_prediction.windows import write as write_windows
from tests.fakes import fake_dataset
from tests.readers import gimo_sample

FAKE_EGOALLO = Path(__file__).parent / "curation" / "fake_egoallo.py"
TABLE_OF = "synthetic-adt"


@dataclass(frozen=True)
class Inputs:
    """What the commands read, made once and never written to."""

    folder: Path

    def __getattr__(self, name: str) -> Path:
        return self.folder / name

    @classmethod
    def make(cls, folder: Path, *, heavy: bool = False) -> Inputs:
        """Make all of them below a folder, those of heavy commands only if asked for."""
        made = cls(folder)
        if heavy:
            _make_for_heavy(made)
        fake_dataset(made.table, 6)
        write_windows(made.windows)
        synthesised = ("synthesize", "adt", "--count", 1, "--events", 2, "--out", made.adt)
        run(made.folder, *synthesised)
        gimo_sample.write_root(made.gimo, gimo_sample.readings())
        for name in ("run", "run-of-conditions"):
            run(made.folder, *_RUN, "--data", made.table, "--out", folder / name)
        run(made.folder, *_STATIC, "--data", made.table, "--out", folder / "static")
        run(made.folder, *_STATIC, "--samples", 2, "--data", made.table, "--out", folder / "several")
        for fold in (1, 2):
            chosen = ("--data", made.table, "--split", "participants", "--fold", f"{fold}/2")
            run(made.folder, *_STATIC, *chosen, "--out", folder / f"fold-{fold}")
        for kind, command in _sharded(made).items():
            for number, out in enumerate(_shards(made, kind), start=1):
                run(made.folder, *command, "--shard", f"{number}/2", "--out", out)
        run(made.folder, "export-release", made.table, "--out", made.release)
        run(made.folder, *_CONDITIONS, "--data", made.table, "--out", folder / "conditions.npz")
        _make_bodiless(made)
        return made


def _make_for_heavy(made: Inputs) -> None:
    native = made.folder / "hd-epic"
    run(made.folder, "synthesize", "hd-epic", "--count", 1, "--events", 4, "--out", native)
    run(made.folder, "build-dataset", "hd-epic", "--root", native, "--out", made.hdepic)
    run(made.folder, "build-corpus", "synthetic", "--count", 4, "--out", made.corpus)
    configured = ("--config", "smoke", "--set", "training.steps=2")
    run(made.folder, "train", "--method", "t2m-evaluator", *configured, "--data", made.corpus, "--out", made.evaluator)


def _make_bodiless(made: Inputs) -> None:
    """Four seconds of ADT without a body, and what EgoAllo needs for one."""
    shutil.copytree(made.adt, made.bodiless)
    for metadata in made.bodiless.glob("*/metadata.json"):
        metadata.with_name("video.vrs").write_bytes(b"VRS")
        trajectory = metadata.with_name("aria_trajectory.csv")
        trajectory.write_text("".join(trajectory.read_text().splitlines(keepends=True)[:121]))
    write_smplh_model(made.bodiless / "smplh" / "neutral" / "model.npz")
    arguments = (
        "{python}", str(FAKE_EGOALLO), "--traj-root", "{mps}", "--traj-length", "{frames}", "--guidance-mode",
        "{guidance}", "--recording", "{recording}", "--smplh-npz-path", "{model}",
    )  # fmt: skip
    quoted = ", ".join(f'"{text}"' for text in arguments)
    (made.folder / "egoallo.toml").write_text(
        f'[egoallo]\npython = "{sys.executable}"\nfolder = "."\ncommand = [{quoted}]\ntimeout_minutes = 0.5\n'
    )


@dataclass(frozen=True)
class Writing:
    """One way in which a command writes."""

    name: str
    """The command with what says where it writes."""
    arguments: Callable[[Inputs, Path], Sequence[object]]
    """From the inputs and the path of the result to the command's arguments."""
    result: str = "result"
    """Path of the result below the folder of a try."""
    held: str = ""
    """Path that the command holds while it writes, below the folder of a try; by default that of the result."""
    before: Callable[[Inputs, Path], Sequence[object]] | None = None
    """A command that has succeeded in the same place before."""
    varies: tuple[str, ...] = ()
    """Endings of names of files that two undisturbed calls write differently: they hold times."""
    half_kept: str = ""
    """Folder of a cache whose half-written entries wait until their entry is made next."""
    exit_code: int = 0
    refuses: bool = False
    """It never replaces a finished result."""

    @property
    def heavy(self) -> bool:
        """Whether it is only tried at night."""
        return self.name in _HEAVY

    def work(self, inputs: Inputs, folder: Path) -> None:
        """Call the command."""
        if self.before is not None and not (folder / self.result).exists():
            run(folder, *self.before(inputs, folder / self.result))
        finished = self.refuses and (folder / self.result).exists()
        code = run(folder, *self.arguments(inputs, folder / self.result), expected=None)
        assert code == (StorageError.exit_code if finished else self.exit_code), f"{self.name}: exit code {code}"

    def is_refused(self, inputs: Inputs, folder: Path, *, owner: int) -> None:
        """Call the command while another process holds what it writes; it ends at once and names that process."""
        said = io.StringIO()
        code = run(folder, *self.arguments(inputs, folder / self.result), expected=None, said=said)
        assert code == (NOT_EVERYTHING if self.name.startswith("build-dataset all") else StorageError.exit_code), (
            said.getvalue()
        )
        assert f"process {owner} on {socket.gethostname()} is writing there" in said.getvalue(), said.getvalue()

    def same(self, folder: Path) -> dict[str, bytes]:
        """What must not depend on kills: all files and folders below a folder, but for the cache."""
        found = {}
        for path in sorted(folder.rglob("*")):
            name = path.relative_to(folder).as_posix()
            if name.split("/")[0] != "cache" and not name.startswith("result/tensorboard/"):  # a file a session
                compared = path.is_file() and not name.endswith(self.varies or ("\0",))
                found[name] = path.read_bytes() if compared else b""
        return found


def run(folder: Path, *arguments: object, expected: int | None = 0, said: io.StringIO | None = None) -> int:
    """Call a command with a cache below a folder; what it prints is shown if it does not end as expected."""
    os.environ["PRBENCH_CACHE"] = str(folder / "cache")
    os.environ["FAKE_CALLS"] = os.devnull
    said = said or io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said), pytest.MonkeyPatch.context() as patch:
        if "toy" in arguments:
            patch.setattr("prbench.harness.methods.installed.entry_points_of", entry_points_of)
        code = main([str(argument) for argument in arguments])
    if code not in (0, 3, 8) or (expected is not None and code != expected):
        sys.stderr.write(said.getvalue())
    assert expected is None or code == expected, arguments
    return code


_RUN = ("run", "--method", "ground-truth", "--limit", 2, "--batch-size", 1)
_STATIC = ("run", "--method", "static", "--condition", "none", "--limit", 2)
_CONDITIONS = ("export-conditions", "--condition", "goal-loc", "--limit", 2)
_TRAIN = ("train", "--method", "toy", "--set", "training.steps=2", "--set", "training.save_every=1")


def _sharded(given: Inputs) -> dict[str, tuple[object, ...]]:
    """Commands that are tried in two shards."""
    return {"table": ("build-dataset", "adt", "--root", given.adt), "run": (*_RUN, "--data", given.table)}


def _shards(given: Inputs, kind: str) -> list[Path]:
    return [given.folder / f"{kind}-shard-{number}" for number in (1, 2)]


_RECORDING = "Apartment_release_synthetic_seed0_seq000_M1292"
_HEAVY = {
    "build-dataset all --out",
    "synthesize --out",
    "run --view",
    "audit --out",
    "run --method all --out",
    "study prediction --out",
    "view --out png",
    "view --out html",
    "view --out mp4",
    "stats --draw",
    "study --out, a figure",
    "explain --draw",
    "synthesize nymeria --out",
    "adapters check --out",
    "validate --out",
    "evaluate-text --out",
}
WRITING = (
    Writing("build-dataset --out", lambda given, out: ("build-dataset", "adt", "--root", given.adt, "--out", out)),
    Writing(
        "build-dataset --out, over an older table",
        lambda given, out: ("build-dataset", "adt", "--root", given.adt, "--out", out),
        before=lambda given, out: (
            "build-dataset",
            "adt",
            "--root",
            given.adt,
            "--out",
            out,
            "--in-hand",
            "wrist",
        ),
    ),
    Writing(
        "build-dataset all --out",
        lambda given, out: ("build-dataset", "all", "--root", given.adt, "--out", out),
        held="result/synthetic-adt",
    ),
    Writing("build-windows --out", lambda given, out: ("build-windows", "adt", "--root", given.adt, "--out", out)),
    Writing("build-windows --data", lambda given, out: ("build-windows", "--data", given.table, "--out", out)),
    Writing(
        "study prediction --out",
        lambda given, out: ("study", "prediction", given.windows, "--limit", 4, "--out", out),
        "t.md",
    ),
    Writing("build-corpus --out", lambda _, out: ("build-corpus", "synthetic", "--count", 1, "--out", out)),
    Writing(
        "synthesize --out",
        lambda _, out: ("synthesize", "adt", "--count", 1, "--events", 2, "--out", out),
    ),
    Writing(
        "synthesize --table",
        lambda _, out: ("synthesize", "adt", "--table", "--count", 1, "--events", 2, "--out", out),
    ),
    Writing("synthesize nymeria --out", lambda _, out: ("synthesize", "nymeria", "--count", 1, "--out", out)),
    Writing(
        "build-dataset --out, a shard",
        lambda given, out: (*_sharded(given)["table"], "--shard", "1/2", "--out", out),
    ),
    Writing(
        "run --out, a shard",
        lambda given, out: (*_sharded(given)["run"], "--shard", "1/2", "--out", out),
        varies=("batch-00000.json",),
    ),
    Writing("merge --out", lambda given, out: ("merge", *_shards(given, "table"), "--out", out)),
    Writing(
        "merge --out, of a run",
        lambda given, out: ("merge", *_shards(given, "run"), "--out", out),
        varies=("cost.json",),
    ),
    Writing("run --out", lambda given, out: (*_RUN, "--data", given.table, "--out", out), varies=("cost.json",)),
    Writing(
        "run --view",
        lambda given, out: (*_RUN, "--data", given.table, "--out", out.parent / "run", "--view", out),
        "v.png",
        held="run",
        varies=("cost.json",),
    ),
    Writing(
        "run --method all --out",
        lambda given, out: (
            "run",
            "--method",
            "all",
            "--condition",
            "none",
            "--data",
            given.table,
            "--limit",
            2,
            "--workers",
            1,
            "--out",
            out,
        ),
        varies=("cost.json", "plan.json", "table_2.json", "table_2.md"),
    ),
    Writing("score --out", lambda given, out: ("score", given.run, "--data", given.table, "--out", out)),
    Writing("export-conditions --out", lambda given, out: (*_CONDITIONS, "--data", given.table, "--out", out), "c.npz"),
    Writing(
        "import-release --out",
        lambda given, out: ("import-release", given.release, "--dataset", TABLE_OF, "--out", out),
    ),
    Writing(
        "export-release --out",
        lambda given, out: ("export-release", given.table, "--out", out),
        held="result/synthetic-adt",
    ),
    Writing(
        "audit --out",
        lambda given, out: ("audit", "--data", given.table, "--limit", 2, "--out", out),
        varies=("cost.json",),
    ),
    Writing(
        "analyse --out, diversity",
        lambda given, out: ("analyse", "diversity", given.several, "--data", given.table, "--out", out),
        "d.json",
    ),
    Writing(
        "analyse --fan",
        lambda given, out: ("analyse", "diversity", given.several, "--data", given.table, "--fan", out),
        "fan.png",
    ),
    Writing(
        "analyse --out, errors",
        lambda given, out: ("analyse", "errors", given.static, "--data", given.table, "--out", out),
    ),
    Writing("analyse --out", lambda given, out: ("analyse", "agreement", given.run, "--out", out), "a.json"),
    Writing("study --out", lambda given, out: ("study", "table-1", given.table, "--out", out), "t.csv"),
    Writing("study --out, a figure", lambda given, out: ("study", "figure-s2", given.table, "--out", out), "f.svg"),
    Writing(
        "split-dataset --out",
        lambda given, out: ("split-dataset", given.table, "--fold", "1/2", "--out", out),
    ),
    Writing(
        "merge --out FOLDS",
        lambda given, out: ("merge", given.folder / "fold-1", given.folder / "fold-2", "--out", out),
    ),
    Writing("leaderboard export --out", lambda given, out: ("leaderboard", "export", given.run, "--out", out), "l.md"),
    Writing(
        "leaderboard compare --out",
        lambda given, out: ("leaderboard", "compare", given.run, given.run, "--out", out),
        "c.json",
    ),
    Writing(
        "view --out png",
        lambda given, out: ("view", given.run, "--data", given.table, "--limit", 1, "--out", out),
        "v.png",
    ),
    Writing(
        "view --out html",
        lambda given, out: ("view", given.run, "--data", given.table, "--limit", 1, "--out", out),
        "v.html",
    ),
    Writing(
        "view --out mp4",
        lambda given, out: ("view", given.run, "--data", given.table, "--limit", 1, "--out", out),
        "v.mp4",
    ),
    Writing(
        "explain --draw",
        lambda given, out: ("explain", "--data", given.table, first_event(given.table), "--draw", out),
        "e.png",
    ),
    Writing("inspect --out TABLE", lambda given, out: ("inspect", given.table, "--out", out), "s.json"),
    Writing(
        "explain --out",
        lambda given, out: ("explain", "--data", given.table, first_event(given.table), "--out", out),
        "e.json",
    ),
    Writing("diff --out", lambda given, out: ("diff", given.table, given.table, "--out", out), "d.json"),
    Writing(
        "build-dataset --propose-events",
        lambda given, out: ("build-dataset", "gimo", "--root", given.gimo, "--propose-events", out),
        "c.csv",
        refuses=True,
    ),
    Writing(
        "poses --poses-root",
        lambda given, out: (
            "poses",
            "egoallo",
            "--root",
            given.bodiless,
            "--config",
            given.folder / "egoallo.toml",
            "--poses-root",
            out,
        ),
        held=f"result/{_RECORDING}/egoallo_outputs",
        varies=(".log",),
        half_kept="cache/egoallo",
    ),
    Writing(
        "poses --out",
        lambda given, out: ("poses", "egoallo", "--root", given.bodiless, "--dry-run", "--out", out),
        "p.json",
    ),
    Writing("datasets --out", lambda _, out: ("datasets", "--out", out), "d.json"),
    Writing("inspect --out", lambda given, out: ("inspect", given.adt, "--out", out), "i.json"),
    Writing("adapters new --out", lambda _, out: ("adapters", "new", "glide", "--out", out), refuses=True),
    Writing(
        "adapters list --converters", lambda _, out: ("adapters", "list", "--converters", out), "prbench_converters.py"
    ),
    Writing(
        "adapters check --out",
        lambda _, out: ("adapters", "check", "static", "--out", out),
        "a.json",
        varies=("a.json",),
    ),
    Writing("adapters list --out", lambda _, out: ("adapters", "list", "static", "--out", out), "m.json"),
    Writing(
        "doctor --out",
        lambda given, out: ("doctor", given.run / "synthetic-adt/predictions", "--data", given.table, "--out", out),
        "d.json",
    ),
    Writing(
        "validate --out",
        lambda given, out: ("validate", "hd-epic", "--data", given.hdepic, "--out", out),
        "v.json",
    ),
    Writing(
        "evaluate-text --out",
        lambda given, out: (
            "evaluate-text",
            "--evaluator",
            given.evaluator / "weights.safetensors",
            "--corpus",
            given.corpus,
            "--repetitions",
            1,
            "--diversity-pairs",
            2,
            "--split",
            "train",
            "--out",
            out,
        ),
        "t.json",
    ),
    Writing(
        "train --out",
        lambda given, out: (*_TRAIN, "--data", given.table, "--out", out),
    ),
)


def first_event(table: Path) -> str:
    """Of a table."""
    from prbench.sequences import SequenceTable

    return SequenceTable.open(table).events()["event_id"][0].as_py()
