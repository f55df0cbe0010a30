"""What writes, small: functions and commands that are killed, held by another process, or given URLs and clusters."""

from __future__ import annotations

import contextlib
import io
import os
import shutil
import socket
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from prbench.cli.builds import NOT_EVERYTHING
from prbench.cli.main import main
from prbench.curation import build_from_sources
from prbench.curation.build import build_shard_from_sources, merge_dataset_shards
from prbench.engine.shards import Shard, require_whole
from prbench.errors import StorageError
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.sharded import merge_run_shards, run_shard
from prbench.readers.egoallo.synthetic import write_smplh_model
from prbench.sequences import SequenceTable
from tests.adapters.training.toy import entry_points_of
from tests.benchmarks.captions.test_files import tokens_file
from tests.benchmarks.motion_prediction.windows import write as write_windows
from tests.curation.sources import some_sources
from tests.fakes import fake_dataset
from tests.readers import gimo_sample

FAKE_EGOALLO = Path(__file__).parents[1] / "curation" / "fake_egoallo.py"
RUN = "run --method ground-truth --limit 2 --batch-size 1 --data {table}"
STATIC = "run --method static --condition none --limit 2 --data {table}"
BUILD = "build-dataset adt --root {adt}"


@dataclass(frozen=True)
class Killed:
    """A function that writes into a folder; called again after a kill, it ends in the bytes of an undisturbed call."""

    name: str
    work: Callable[[Path, Path], object]  # from a folder with ``table`` and an empty one
    every: int  # is killed before every so-manieth file operation
    slow: bool = False  # is tried by the slow tests only
    varies: tuple[str, ...] = ()  # endings of names of files that two undisturbed calls write differently

    def same(self, folder: Path) -> dict[str, bytes]:
        """Return what must not depend on kills: all files and folders below a folder, but for the cache."""
        found = {}
        for path in sorted(folder.rglob("*")):
            name = path.relative_to(folder).as_posix()
            if name.split("/")[0] != "cache" and not name.startswith("result/tensorboard/"):  # a file a session
                compared = path.is_file() and not name.endswith(self.varies or ("\0",))
                found[name] = path.read_bytes() if compared else b""
        return found


@dataclass(frozen=True)
class Writing:
    """One way in which a command writes.

    Attributes:
        name: The command with the option that says where it writes.
        command: Its words. ``{out}`` is the result, ``{event}`` an event of the table, other names are inputs.
        result: Path of the result below the folder of a try.
        held: Path that the command holds while it writes, below the folder of a try; by default the result.
        before: Commands that have succeeded in the same place before.
        varies: See :class:`Killed`.
        half_kept: Folder of a cache whose half-written entries wait until their entry is made next.
        refuses: It never replaces a finished result.
        heavy: It is only tried at night.
    """

    name: str
    command: str
    result: str = "result"
    held: str = ""
    before: tuple[str, ...] = ()
    varies: tuple[str, ...] = ()
    half_kept: str = ""
    refuses: bool = False
    heavy: bool = False

    def words(self, inputs: Any, out: Any, command: str = "") -> list[str]:
        """Return the words of the command; inputs and result may be URLs that are put together as paths are."""
        return _words(command or self.command, inputs, out)

    def work(self, inputs: Path, folder: Path) -> None:
        """Call the command."""
        out = folder / self.result
        for earlier in () if out.exists() else self.before:
            run(folder, *self.words(inputs, out, earlier))
        expected = StorageError.exit_code if self.refuses and out.exists() else 0
        run(folder, *self.words(inputs, out), expected=expected)

    def is_refused(self, inputs: Path, folder: Path, *, owner: int) -> None:
        """Call the command while another process holds what it writes; it ends at once and names that process."""
        said = io.StringIO()
        code = run(folder, *self.words(inputs, folder / self.result), expected=None, said=said)
        several = self.name.startswith("build-dataset all")
        assert code == (NOT_EVERYTHING if several else StorageError.exit_code), said.getvalue()
        assert f"process {owner} on {socket.gethostname()} is writing there" in said.getvalue(), said.getvalue()

    def same(self, folder: Path) -> dict[str, bytes]:
        """See :meth:`Killed.same`."""
        return Killed(self.name, self.work, 1, varies=self.varies).same(folder)


def _words(command: str, inputs: Any, out: Any) -> list[str]:
    class Places(dict):
        def __missing__(self, name: str) -> object:
            if name != "event":
                return inputs / name
            return SequenceTable.open(inputs / "table").events()["event_id"][0].as_py()

    return [word.format_map(Places(out=out, beside=out.parent)) for word in command.split()]


def run(folder: Path, *words: object, expected: int | None = 0, said: io.StringIO | None = None) -> int:
    """Call a command with a cache below a folder; what it prints is shown if it does not end as expected."""
    os.environ["PRBENCH_CACHE"] = str(folder / "cache")
    os.environ["FAKE_CALLS"] = os.devnull
    said = said or io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said), pytest.MonkeyPatch.context() as patch:
        if "toy" in words:
            patch.setattr("prbench.harness.methods.installed.entry_points_of", entry_points_of)
        code = main([str(word) for word in words])
    assert expected is None or code == expected, f"{words}: exit code {code}\n{said.getvalue()}"
    return code


def make_inputs(folder: Path, *, heavy: bool = False) -> Path:
    """Make what the commands read below a folder, for heavy commands only if asked for; returns the folder."""

    def call(command: str, out: str = "") -> None:
        run(folder, *_words(command, folder, folder / out))

    if heavy:
        call("synthesize hd-epic --count 1 --events 4 --out {hd-epic}")
        call("build-dataset hd-epic --root {hd-epic} --out {hdepic}")
        call("build-corpus synthetic --count 4 --out {corpus}")
        call("synthesize nymeria --count 2 --out {nymeria}")
        call("train --method t2m-evaluator --config smoke --set training.steps=2 --data {corpus} --out {evaluator}")
        call("train --method motion-tokens --config smoke --set training.steps=2 --data {corpus} --out {tokeniser}")
        tokens_file(folder / "tokens.parquet")
        call("train --method tm2t --config smoke --set training.steps=2 --data {tokens}.parquet --out {captioner}")
    fake_dataset(folder / "table", 6)
    write_windows(folder / "windows")
    call("synthesize adt --count 1 --events 2 --out {adt}")
    if heavy:
        call(f"{BUILD} --out {{built}}")
    gimo_sample.write_root(folder / "gimo", gimo_sample.readings())
    call(f"{RUN} --out {{run}}")
    call(f"{STATIC} --out {{static}}")
    call(f"{STATIC} --samples 2 --out {{several}}")
    call(SUBMIT, "submission")
    for number in (1, 2):
        call(f"{STATIC} --fold {number}/2 --out {{out}}", f"fold-{number}")
        call(f"{BUILD} --shard {number}/2 --out {{out}}", f"table-shard-{number}")
        call(f"{RUN} --shard {number}/2 --out {{out}}", f"run-shard-{number}")
    call("export-release {table} --out {release}")
    # Four seconds of ADT without a body, and what EgoAllo needs for one.
    bodiless = folder / "bodiless"
    shutil.copytree(folder / "adt", bodiless)
    for metadata in bodiless.glob("*/metadata.json"):
        metadata.with_name("video.vrs").write_bytes(b"VRS")
        trajectory = metadata.with_name("aria_trajectory.csv")
        trajectory.write_text("".join(trajectory.read_text().splitlines(keepends=True)[:121]))
    write_smplh_model(bodiless / "smplh" / "neutral" / "model.npz")
    arguments = (
        "{python}", str(FAKE_EGOALLO), "--traj-root", "{mps}", "--traj-length", "{frames}", "--guidance-mode",
        "{guidance}", "--recording", "{recording}", "--smplh-npz-path", "{model}",
    )  # fmt: skip
    quoted = ", ".join(f'"{text}"' for text in arguments)
    (folder / "settings").mkdir()
    (folder / "settings" / "gaze.csv").write_text("time,dx,dy,dz,ox,oy,oz\n0,0,0,1,0,0,0\n1,0,0,1,0,0,0\n")
    (folder / "settings" / "boxes.csv").write_text("time,action,object,x,y,z\n1,pick,cup,0,0,1\n")
    (folder / "settings" / "egoallo.toml").write_text(
        f'[egoallo]\npython = "{sys.executable}"\nfolder = "."\ncommand = [{quoted}]\ntimeout_minutes = 0.5\n'
    )
    return folder


SUBMIT = "leaderboard submit {static} --data {table} --name S --out {out}"
INIT = "leaderboard init {beside} --data {table}"
ADD = "leaderboard add {beside} {submission} --data {table} --date 2026-01-02"
_RECORDING = "Apartment_release_synthetic_seed0_seq000_M1292"
_EVALUATE = (
    "evaluate-text --evaluator {evaluator}/weights.safetensors --corpus {corpus} --repetitions 1 --diversity-pairs 2"
    " --split train --out {out}"
)
_TRAIN = "train --method toy --set training.steps=2 --set training.save_every=1 --data {table} --out {out}"
_VARYING_TABLE = ("cost.json", "plan.json", "table_2.json", "table_2.md")
WRITING = (
    Writing("build-dataset --out", f"{BUILD} --out {{out}}"),
    Writing(
        "build-dataset --out, over an older table",
        f"{BUILD} --out {{out}}",
        before=(f"{BUILD} --out {{out}} --in-hand wrist",),
    ),
    Writing(
        "build-dataset all --out",
        "build-dataset all --root {adt} --out {out}",
        held="result/ADT",
        heavy=True,
    ),
    Writing("build-dataset --out, a shard", f"{BUILD} --shard 1/2 --out {{out}}"),
    Writing(
        "build-dataset --propose-events",
        "build-dataset gimo --root {gimo} --propose-events {out}",
        "c.csv",
        refuses=True,
    ),
    Writing("build-windows --out", "build-windows adt --root {adt} --out {out}"),
    Writing("build-windows --data", "build-windows --data {table} --out {out}"),
    Writing("build-tracks --out", "build-tracks nymeria --root {nymeria} --devices synthetic --out {out}", heavy=True),
    Writing(
        "build-tokens --out", "build-tokens --weights {tokeniser} --data {corpus} --out {out}", "t.parquet", heavy=True
    ),
    Writing("build-corpus --out", "build-corpus synthetic --count 1 --out {out}"),
    Writing("synthesize --out", "synthesize adt --count 1 --events 2 --out {out}", heavy=True),
    Writing("synthesize --table", "synthesize adt --table --count 1 --events 2 --out {out}"),
    Writing("synthesize nymeria --out", "synthesize nymeria --count 1 --out {out}", heavy=True),
    Writing("merge --out", "merge {table-shard-1} {table-shard-2} --out {out}"),
    Writing("merge --out, of a run", "merge {run-shard-1} {run-shard-2} --out {out}", varies=("cost.json",)),
    Writing("merge --out FOLDS", "merge {fold-1} {fold-2} --out {out}"),
    Writing("run --out", f"{RUN} --out {{out}}", varies=("cost.json",)),
    Writing("run --folds", f"{RUN} --folds participant --out {{out}}", varies=("cost.json",)),
    Writing("run --out, a shard", f"{RUN} --shard 1/2 --out {{out}}", varies=("batch-00000.json",)),
    Writing(
        "run --view",
        f"{RUN} --out {{beside}}/run --view {{out}}",
        "v.png",
        held="run",
        varies=("cost.json",),
        heavy=True,
    ),
    Writing(
        "run --method all --out",
        "run --method all --condition none --data {table} --limit 2 --workers 1 --out {out}",
        varies=_VARYING_TABLE,
        heavy=True,
    ),
    Writing("score --out", "score {run} --data {table} --out {out}"),
    Writing("audit --out", "audit --data {table} --limit 2 --out {out}", varies=("cost.json",), heavy=True),
    Writing(
        "export-conditions --out",
        "export-conditions --condition goal-loc --limit 2 --data {table} --out {out}",
        "c.npz",
    ),
    Writing("import-release --out", "import-release {release} --dataset synthetic-adt --out {out}"),
    Writing("export-release --out", "export-release {table} --out {out}", held="result/ADT"),
    Writing("analyse --out", "analyse agreement {run} --out {out}", "a.json"),
    Writing("analyse --out, diversity", "analyse diversity {several} --data {table} --out {out}", "d.json"),
    Writing("analyse --fan", "analyse diversity {several} --data {table} --fan {out}", "fan.png"),
    Writing("study --out", "study table-1 {table} --out {out}", "t.csv"),
    Writing("study --out, a figure", "study figure-s2 {table} --out {out}", "f.svg", heavy=True),
    Writing("study prediction --out", "study prediction {windows} --limit 4 --out {out}", "t.md", heavy=True),
    Writing("leaderboard export --out", "leaderboard export {run} --out {out}", "l.md"),
    Writing("leaderboard compare --out", "leaderboard compare {run} {run} --out {out}", "c.json"),
    Writing("leaderboard submit --out", SUBMIT, "s.zip"),
    Writing("leaderboard verify --out", "leaderboard verify {submission} --data {table} --out {out}", "v.json"),
    Writing("leaderboard site --out", "leaderboard site {run} --data {table} --out {out}"),
    Writing("leaderboard init --out", INIT, "board/board.toml", held="board"),
    Writing("leaderboard add --out", ADD, "board/history.jsonl", held="board", before=(INIT,), refuses=True),
    Writing(
        "leaderboard withdraw --out",
        "leaderboard withdraw {beside} S --reason R --date 2026-01-03",
        "board/history.jsonl",
        held="board",
        before=(INIT, ADD),
    ),
    *(
        Writing(
            f"leaderboard {name} --out",
            f"leaderboard {name} {{beside}}/board --out {{out}}",
            "r.json",
            before=(INIT.replace("{beside}", "{beside}/board"),),
        )
        for name in ("history", "build", "check", "cite")
    ),
    *(
        Writing(f"view --out {kind}", "view {run} --data {table} --limit 1 --out {out}", f"v.{kind}", heavy=True)
        for kind in ("png", "html", "mp4")
    ),
    Writing("export-motion --out", "export-motion {run} --data {table} --format bvh --out {out}"),
    Writing("review --out", "review {built} --root {adt} --out {out}", "r.html", heavy=True),
    Writing("explain --draw", "explain --data {table} {event} --draw {out}", "e.png", heavy=True),
    Writing("explain --out", "explain --data {table} {event} --out {out}", "e.json"),
    Writing("plain-recording --out", "plain-recording csv --gaze {settings}/gaze.csv --out {out}"),
    Writing("prime --out", "prime --gaze {settings}/gaze.csv --objects {settings}/boxes.csv --out {out}", "p.json"),
    Writing("inspect --out TABLE", "inspect {table} --out {out}", "s.json"),
    Writing("inspect --out", "inspect {adt} --out {out}", "i.json"),
    Writing("diff --out", "diff {table} {table} --out {out}", "d.json"),
    Writing(
        "poses --poses-root",
        "poses egoallo --root {bodiless} --config {settings}/egoallo.toml --poses-root {out}",
        held=f"result/{_RECORDING}/egoallo_outputs",
        varies=(".log",),
        half_kept="cache/egoallo",
    ),
    Writing("poses --out", "poses egoallo --root {bodiless} --dry-run --out {out}", "p.json"),
    Writing("datasets list --out", "datasets --out {out}", "d.json"),
    Writing("datasets new --out", "datasets new glide-eyes --out {out}", refuses=True),
    Writing(
        "datasets check --out",
        "datasets check adt --root {adt} --out {out}",
        "d.json",
        varies=("d.json",),
        heavy=True,
    ),
    Writing("adapters new --out", "adapters new glide --out {out}", refuses=True),
    Writing("adapters list --converters", "adapters list --converters {out}", "prbench_converters.py"),
    Writing("adapters check --out", "adapters check static --out {out}", "a.json", varies=("a.json",), heavy=True),
    Writing("adapters list --out", "adapters list static --out {out}", "m.json"),
    Writing("doctor --out", "doctor {run}/synthetic-adt/predictions --data {table} --out {out}", "d.json"),
    Writing("validate --out", "validate hd-epic --data {hdepic} --out {out}", "v.json", heavy=True),
    Writing("evaluate-text --out", _EVALUATE, "t.json", heavy=True),
    Writing(
        "caption --out", "caption --weights {captioner} --tokens {tokens}.parquet --out {out}", "c.jsonl", heavy=True
    ),
    Writing("train --out", _TRAIN),
)


def _shards_of_a_table(_: Path, folder: Path) -> None:
    for number in (1, 2):
        build_shard_from_sources(some_sources(3), folder / f"shard-{number}", Shard(number, 2))
    merge_dataset_shards(require_whole([folder / "shard-1", folder / "shard-2"]), folder / "adt", replace=False)


def _request(inputs: Path, out: Path) -> RunRequest:
    return RunRequest(method="scripted", condition="goal-loc", data=(inputs / "table",), limit=4, batch_size=2, out=out)


def _shards_of_a_run(inputs: Path, folder: Path) -> None:
    for number in (1, 2):
        run_shard(_request(inputs, folder / f"shard-{number}"), Shard(number, 2))
    merge_run_shards(require_whole([folder / "shard-1", folder / "shard-2"]), folder / "run")


_MEASURED = ("cost.json", "batch-00000.json", "batch-00001.json")
KILLED = (
    Killed("a table", lambda _, folder: build_from_sources(some_sources(2), folder / "adt"), every=3),
    Killed("shards of a table and their merge", _shards_of_a_table, every=5, slow=True),
    Killed("a run", lambda given, folder: run_method(_request(given, folder / "run")), every=3, varies=_MEASURED),
    Killed("shards of a run and their merge", _shards_of_a_run, every=5, slow=True, varies=_MEASURED),
)
