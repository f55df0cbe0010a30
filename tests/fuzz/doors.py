"""The doors through which foreign files come in: for each, how its files are made and how prbench looks at them."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import io
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq

from prbench.board.submission import Submission, open_submission
from prbench.board.verifying import verify_submission
from prbench.checking.inspection import inspect_folder
from prbench.cli import main
from prbench.curation.corrections import read_corrections
from prbench.curation.job import native_sources
from prbench.curation.options import BuildOptions
from prbench.errors import PrbenchError, UnforeseenInput
from prbench.harness.methods.programs import read_description
from prbench.harness.offline import ConditionsFile, read_conditions_file
from prbench.protocol.own_protocol import read_protocol
from prbench.readers.own.format import SUFFIXES, TABLES
from prbench.synthetic.write_tree import synthesize_tree
from prbench_adapters.corpora.sources import CorpusOptions, corpus_for, find_groups
from prbench_adapters.corpora.synthetic import synthesize_corpus_tree
from prbench_adapters.training.configuration import load_configuration
from prbench_adapters.training.weights import read_weights
from tests.fakes import fake_dataset
from tests.fuzz.judging import Seen
from tests.harness.offline import method
from tests.readers.own.plain import write_short
from tests.release.releases import rows, write_release

UNFORESEEN_WORDS = "expected content that prbench can read, found what ends in"
"""What the message of the boundary around readers says where a command prints it."""


_RESULTS = ("sequences", "events", "scores", "clips")


@dataclass(frozen=True)
class Door:
    """One way in."""

    name: str
    make: Callable[[Path], object]
    """Writes the files that will be damaged into ``input`` of the folder, and what stands beside them."""
    look: Callable[[Path], Seen]
    spared: tuple[str, ...] = ()
    """Names of files that are not damaged: of which nothing can tell that they are missing."""
    optional: tuple[str, ...] = ()
    """Names of files that a recording may lack: nothing has to tell that they are missing."""
    knows_whole: bool = True
    """False where a shorter file is simply another one: files that people write, and lists of texts."""


class CommandFailed(PrbenchError):
    """A command ended with an exit code other than 0."""


def digest_of(value: object) -> str:
    """Return a digest of any tree of data classes, containers, arrays and plain values."""
    digest = hashlib.sha256()
    for part in _parts(value):
        digest.update(part)
    return digest.hexdigest()


def _parts(value: object) -> Iterator[bytes]:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        for field in dataclasses.fields(value):
            if field.name not in ("messages", "shortfalls"):
                yield from _parts(getattr(value, field.name))
    elif isinstance(value, np.ndarray):
        yield f"{value.dtype}{value.shape}".encode()
        yield np.ascontiguousarray(value).tobytes() if value.dtype != object else repr(value.tolist()).encode()
    elif isinstance(value, dict):
        for key, held in value.items():
            yield repr(key).encode()
            yield from _parts(held)
    elif isinstance(value, tuple | list):
        yield f"({len(value)}".encode()
        for held in value:
            yield from _parts(held)
    else:
        yield repr(value).encode()


_PLAIN = tuple(f"{name}{suffix}" for name in TABLES for suffix in SUFFIXES)
"""Tables of plain recordings, which people write: each may be of any length, or not there."""


def _plain(folder: Path) -> None:
    write_short(folder / "input")
    for name in ("gaze", "events"):
        table = folder / "input" / "one" / f"{name}.csv"
        pd.read_csv(table).to_parquet(table.with_suffix(".parquet"))
        table.unlink()


def _dataset(layout: str, *, estimates: bool = False, **options: str) -> Door:
    def make(folder: Path) -> None:
        synthesize_tree(
            layout, folder / "input", recordings=1, seed=3, n_events=1, bystander_objects=1, estimates=estimates
        )

    def look(folder: Path) -> Seen:
        root = folder / "input"
        inspection = inspect_folder(root)
        told = [
            f"{recording.recording_id} {recording.state} {recording.remarks}"
            for dataset in inspection.datasets
            for recording in dataset.recordings
        ]
        told += [broken.message for broken in inspection.broken]
        places = {name: str(value).replace("INPUT", str(root)) for name, value in options.items()}
        sources = native_sources(layout, root, BuildOptions(reader=tuple(places.items())))
        recordings = [source.read() for source in sources]
        told += [message for recording in recordings for message in (*recording.messages, *recording.shortfalls)]
        told += [str(entry) for recording in recordings for entry in recording.unreadable]
        return Seen(digest_of(recordings), tuple(told))

    if layout == "own":
        return Door("own", _plain, look, optional=_PLAIN, knows_whole=False)
    # The authors' priming: a dataset is built without it unless it is asked for.
    return Door("adt-egoallo" if estimates else layout, make, look, optional=("priming_info.json",))


def _corpus(name: str) -> Door:
    def make(folder: Path) -> None:
        synthesize_corpus_tree(name, folder / "input", recordings=1, seed=3)

    def look(folder: Path) -> Seen:
        groups = find_groups(corpus_for(name), folder / "input", CorpusOptions())
        members = [member for _, recordings in groups for member in recordings]
        told = [f"{member.identity.recording_id} {member.skip_reason}" for member in members]
        made = [member.read() for member in members if not member.skip_reason]
        told += [f"{recording.message} {recording.clock_method}" for recording in made]
        values = [(recording.clips, recording.annotations, recording.duration) for recording in made]
        return Seen(digest_of(values), tuple(told))

    # The names of HumanML3D's motions are numbers, so that nothing marks invented ones but the file beside them.
    if name == "humanml3d":
        return Door(name, make, look, spared=("synthetic.json",), knows_whole=False)
    return Door(name, make, look)


def _ran(folder: Path, *words: str, out: str = "") -> Seen:
    """Run a command; its values are the tables that it wrote, or what it printed where it wrote none."""
    printed = io.StringIO()
    said = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(said):
        code = main([word.replace("FOLDER", str(folder)) for word in words])
    left = [path.name for path in folder.rglob("*") if ".partial" in path.name or ".replaced" in path.name]
    if left:
        raise AssertionError(f"left behind: {left}")
    text = printed.getvalue() + said.getvalue()
    if "Traceback" in text:
        raise AssertionError(text[-1500:])
    if UNFORESEEN_WORDS in text:
        raise UnforeseenInput(folder, "", expected="", found=said.getvalue())
    if code != 0:
        raise CommandFailed(said.getvalue() or printed.getvalue()[-1000:])
    if not out:
        return Seen(digest_of(printed.getvalue()), tuple(said.getvalue().splitlines()))
    written = sorted(path for path in (folder / out).rglob("*.parquet") if path.stem in _RESULTS)
    return Seen(digest_of([path.read_bytes() for path in written]), (*text.splitlines(), *_remarks(folder / out)))


def _remarks(table: Path) -> list[str]:
    """What a build says of each recording, which its table keeps (`prbench explain` shows it)."""
    recordings = table / "recordings.parquet"
    return pq.read_table(recordings, columns=["message"])["message"].to_pylist() if recordings.is_file() else []


def _command(name: str, make: Callable[[Path], object], *words: str, out: str = "") -> Door:
    return Door(name, make, lambda folder: _ran(folder, *words, out=out))


def _table(folder: Path, name: str = "input") -> None:
    fake_dataset(folder / name, 12)


def _two_tables(folder: Path) -> None:
    _table(folder)
    _table(folder, "other")


def _run(folder: Path) -> None:
    _table(folder, "table")
    _ran(folder, "run", "--method", "static", "--condition", "none", "--data", "FOLDER/table", "--out", "FOLDER/input")


def _release(folder: Path) -> None:
    write_release(folder / "input" / "adt", rows(6))


def _conditions(suffix: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        _table(folder, "table")
        (folder / "input").mkdir()
        where = f"FOLDER/input/conditions{suffix}"
        _ran(folder, "export-conditions", "--data", "FOLDER/table", "--condition", "goal-loc", "--out", where)

    return make


def _conditions_door(suffix: str) -> Door:
    def look(folder: Path) -> Seen:
        return Seen(digest_of(read_conditions_file(folder / "input" / f"conditions{suffix}")))

    return Door(f"conditions-{suffix[1:]}", _conditions(suffix), look)


def _predictions(write: Callable[[Path, ConditionsFile, list[np.ndarray]], object], name: str) -> Door:
    def make(folder: Path) -> None:
        _table(folder, "table")
        (folder / "input").mkdir()
        where = "FOLDER/conditions.npz"
        _ran(folder, "export-conditions", "--data", "FOLDER/table", "--condition", "goal-loc", "--out", where)
        conditions = read_conditions_file(folder / "conditions.npz")
        write(folder / "input" / name, conditions, method.generated(conditions))

    words = ("score", f"FOLDER/input/{name}", "--data", "FOLDER/table", "--conditions", "FOLDER/conditions.npz")
    return _command(f"score-{write.__name__.split('_')[-1]}", make, *words)


def _motions(folder: Path) -> None:
    _predictions(method.write_padded, "motions.npz").make(folder)


def _write_flat(path: Path, conditions: ConditionsFile, motions: list[np.ndarray]) -> None:
    method.write_parquet(path, conditions, motions, flat=True)


def _weights(folder: Path) -> None:
    shipped = resources.files("prbench_adapters.pr") / "weights" / "pr-small-goal-loc.safetensors"
    (folder / "input").mkdir()
    (folder / "input" / "weights.safetensors").write_bytes(shipped.read_bytes())


def _look_at_weights(folder: Path) -> Seen:
    read = read_weights(folder / "input" / "weights.safetensors")
    tensors = {name: tensor.float().numpy() for name, tensor in read.tensors.items()}
    return Seen(digest_of((tensors, repr(read.metadata))))


def _configuration(folder: Path) -> None:
    (folder / "input").mkdir()
    shipped = resources.files("prbench_adapters.pr") / "pr-smoke.toml"
    (folder / "input" / "mine.toml").write_bytes(shipped.read_bytes())


def _look_at_configuration(folder: Path) -> Seen:
    path = str(folder / "input" / "mine.toml")
    return Seen(digest_of(repr(load_configuration(path, package="prbench_adapters.pr", task="pr", stage="finetune"))))


_DESCRIPTION = """\
[method]
name = "glide"
command = ["python", "glide.py"]

[environment]
virtual-environment = "venv"
variables = { OMP_NUM_THREADS = "1" }

[limits]
start_s = 60
batch_s = 600.0
"""


def _description(folder: Path) -> None:
    (folder / "input").mkdir()
    (folder / "input" / "method.toml").write_text(_DESCRIPTION, encoding="utf-8")


def _look_at_description(folder: Path) -> Seen:
    return Seen(digest_of(repr(read_description(folder / "input" / "method.toml"))))


def _text(name: str, content: str) -> Callable[[Path], None]:
    """Write a file, and a table beside it."""

    def make(folder: Path) -> None:
        _table(folder, "table")
        (folder / "input").mkdir()
        (folder / "input" / name).write_text(content, encoding="utf-8")

    return make


_PROTOCOL = (resources.files("prbench_benchmarks.prime_and_reach") / "protocol.toml").read_text(encoding="utf-8")
_EXPERIMENT = """\
data = ["FOLDER/table"]
seeds = [0]
samples = 1

[[methods]]
name = "static"
conditions = ["none"]
"""
_CORRECTIONS = """\
event_id,change,value,reason,author
synthetic-adt/one/cup/pick/1,drop,,the video shows no hand,me
synthetic-adt/one/cup/pick/2,move,-0.40,late by half a second,me
synthetic-adt/two/jug/put/3,goal,0.52 0.91 -1.30,the tracker was lost,me
synthetic-adt/two/jug/put/4,rename,bowl,"it is one, clearly",me
"""


def _submission(folder: Path) -> None:
    _run(folder)
    (folder / "input").rename(folder / "run")
    _ran(folder, "leaderboard", "submit", "FOLDER/run", "--out", "FOLDER/input/mine.prbench.zip", "--name", "Mine")


def _unpacked(folder: Path) -> None:
    _submission(folder)
    (folder / "input").rename(folder / "packed")
    open_submission(folder / "packed" / "mine.prbench.zip", folder / "input")


def _verify_again(folder: Path) -> Seen:
    """Damage that the list of files does not tell, because whoever made it has listed it."""
    submission = Submission.decoded((folder / "input" / "submission.json").read_bytes(), folder)
    return Seen(digest_of(repr(verify_submission(submission, folder / "input", [folder / "table"]).datasets)))


def _windows(folder: Path) -> None:
    _table(folder, "table")
    _ran(folder, "build-windows", "--data", "FOLDER/table", "--out", "FOLDER/input")


def _built(layout: str) -> Door:
    door = _dataset(layout)
    words = ("build-dataset", layout, "--root", "FOLDER/input", "--out", "FOLDER/table")
    command = _command(f"build-{layout}", door.make, *words, out="table")
    return dataclasses.replace(command, optional=door.optional, knows_whole=door.knows_whole)


LAYOUTS = ("adt", "gimo", "hd-epic", "hot3d", "mogaze")

READERS = (
    *(_dataset(layout) for layout in (*LAYOUTS, "own")),
    _dataset("adt", estimates=True, poses="egoallo", smplh_model="INPUT/smplh/neutral/model.npz"),
    _corpus("nymeria"),
    _corpus("humanml3d"),
    _conditions_door(".npz"),
    Door("weights", _weights, _look_at_weights),
    Door("configuration", _configuration, _look_at_configuration, knows_whole=False),
    Door(
        "corrections", _text("mine.csv", _CORRECTIONS), knows_whole=False,
        look=lambda folder: Seen(digest_of(repr(read_corrections(folder / "input" / "mine.csv")))),
    ),
    Door(
        "protocol", _text("mine.toml", f'name = "mine"\n{_PROTOCOL}'), knows_whole=False,
        look=lambda folder: Seen(digest_of(repr(read_protocol(folder / "input" / "mine.toml")))),
    ),
    Door("method-description", _description, _look_at_description, knows_whole=False),
    Door("submission", _unpacked, _verify_again, spared=("submission.json", "cost.json"), optional=("agreement.json",)),
)  # fmt: skip
"""Functions that read."""

COMMANDS = (
    *(_built(layout) for layout in (*LAYOUTS, "own")),
    dataclasses.replace(
        _command("build-corpus", _corpus("humanml3d").make, "build-corpus", "humanml3d", "--root", "FOLDER/input",
                 "--out", "FOLDER/corpus", out="corpus"),
        spared=("synthetic.json",), knows_whole=False,
    ),
    _command("diff", _two_tables, "diff", "FOLDER/input", "FOLDER/other"),
    _command("inspect", _table, "inspect", "FOLDER/input"),
    _command("run", _table, "run", "--method", "static", "--condition", "none", "--data", "FOLDER/input", "--out",
             "FOLDER/run", out="run"),
    _command("board", _run, "leaderboard", "export", "FOLDER/input", "--format", "md"),
    _command("import-release", _release, "import-release", "FOLDER/input", "--out", "FOLDER/tables", out="tables"),
    _command("board-data", _run, "leaderboard", "export", "FOLDER/input", "--data", "FOLDER/table", "--format", "md"),
    _command("verify", _submission, "leaderboard", "verify", "FOLDER/input/mine.prbench.zip", "--data", "FOLDER/table"),
    _command("score-run", _run, "score", "FOLDER/input", "--data", "FOLDER/table"),
    _command("doctor", _motions, "doctor", "FOLDER/input/motions.npz", "--data", "FOLDER/table"),
    _command("windows", _windows, "run", "--benchmark", "motion-prediction", "--method", "zero-velocity",
             "--condition", "pose", "--data", "FOLDER/input", "--out", "FOLDER/run", out="run"),
    dataclasses.replace(
        _command("experiment", _text("mine.toml", _EXPERIMENT), "run", "--config", "FOLDER/input/mine.toml", "--data",
                 "FOLDER/table", "--out", "FOLDER/run", out="run"),
        knows_whole=False,
    ),
    _predictions(_write_flat, "motions.parquet"),
    _predictions(method.write_padded, "motions.npz"),
    _predictions(method.write_ragged, "motions.npz"),
)  # fmt: skip
"""Commands that read, or read and write."""
