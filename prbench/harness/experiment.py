"""An experiment: methods, conditions, tables and seeds in one file, or what an earlier run's ``run.json`` says.

The file is TOML. Its keys are the options of ``prbench run``; each method may have several conditions, and each seed is
a run of its own. ``docs/experiments.md`` shows one.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import msgspec

from prbench.errors import InputFileError, RunError, UsageError, did_you_mean
from prbench.files.bounded import foreign_input, read_whole
from prbench.harness.first_run import table_finder
from prbench.harness.preparation import DEFAULT_PARENT
from prbench.harness.request import RunRequest
from prbench.harness.run_folder import RunFolder, read_scores
from prbench.harness.run_folder.record import FILE, FILE_NAME, PROGRAM, UNKNOWN
from prbench.limits import HARMLESS_SIZE
from prbench.object_stores.store import is_url
from prbench.protocol.manifests import PROTOCOL_NAME, benchmarks, find_benchmark
from prbench.protocol.own_protocol import FILE_NAME as PROTOCOL_FILE
from prbench.sequences import DatasetInfo
from prbench.sequences.folds import parse_fold

# Split of an experiment that is a fold of participants.
PARTICIPANTS = "participants"


class ExperimentMethod(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True):
    """One method of an experiment, and what it is run with.

    Attributes:
        name: An installed method, a control, ``cmd:`` and a command, or the path of a program's TOML file.
        conditions: Each is a run of its own; empty for the only condition that the method takes.
        weights: Name of bundled weights, or a path.
        control: ``shuffled-goal`` or nothing.
    """

    name: str
    conditions: tuple[str, ...] = ()
    weights: str | None = None
    options: dict[str, str | int | float | bool] = {}
    control: str | None = None

    @property
    def option_texts(self) -> dict[str, str]:
        """The options as the command line writes them: ``true``, not ``True``."""
        return {
            key: str(value).lower() if isinstance(value, bool) else str(value) for key, value in self.options.items()
        }


class Experiment(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True):
    """Everything that decides the results of some runs; the defaults are those of ``prbench run``.

    Attributes:
        benchmark: What is asked of the methods.
        data: Folders of tables, which every run is made on; empty for the embedded synthetic datasets.
        split: ``participants`` goes with ``fold``.
        fold: Such as ``2/6``: the participants of this fold are tested on.
        limit: Sequences of each dataset.
        sequences: Single sequences: ids, or parts that fit one id only.
        seeds: Each is a run of its own.
        samples: Motions kept of each sequence; absent for the benchmark's usual number.
        batch_size: Sequences a batch; absent for the benchmark's usual number.
        threads: Threads of each worker.
        timeout: Seconds for each batch of a program or an isolated method.
        protocol: File of the user's own protocol; absent for prbench's.
        out: The run folder; of several runs the folder that gets one run folder for each.
    """

    methods: tuple[ExperimentMethod, ...]
    benchmark: str = PROTOCOL_NAME
    data: tuple[str, ...] = ()
    split: str = "test"
    fold: str | None = None
    limit: int | None = None
    sequences: tuple[str, ...] = ()
    seeds: tuple[int, ...] = (0,)
    samples: int | None = None
    batch_size: int | None = None
    device: str = "cpu"
    threads: int = 1
    isolate: bool = False
    timeout: float | None = None
    protocol: str | None = None
    out: str | None = None

    def as_toml(self) -> str:
        """Return the experiment as a file that :func:`read_experiment` reads back."""
        return msgspec.toml.encode(self).decode("utf-8")

    def requests(self) -> Iterator[RunRequest]:
        """Yield the runs: method by method, condition by condition, seed by seed.

        Raises:
            UsageError: if a run's parts do not fit together, or two runs are the same.
        """
        if (self.split == PARTICIPANTS) != (self.fold is not None):
            raise UsageError("--split participants and --fold K/N belong together.")
        if self.fold is not None:
            parse_fold(self.fold)
        runs = [
            (method, condition, seed)
            for method in self.methods
            for condition in method.conditions or (None,)
            for seed in self.seeds
        ]
        taken: set[str] = set()
        for method, condition, seed in runs:
            request = self._request(method, condition, seed)
            if len(runs) > 1:
                parts = [request.method_label, request.control, request.condition]
                if len(self.seeds) > 1:
                    parts.append(f"seed{request.seed}")
                name = "-".join(str(part) for part in parts if part).replace(" ", "_")
                if name in taken:
                    raise UsageError(
                        f"two runs of the experiment are called '{name}': run methods that differ only in weights or"
                        " options from files of their own."
                    )
                taken.add(name)
                request = replace(request, out=Path(self.out or DEFAULT_PARENT) / name)
            yield request

    def _request(self, method: ExperimentMethod, condition: str | None, seed: int) -> RunRequest:
        about = find_benchmark(self.benchmark)
        return RunRequest(
            method=method.name,
            benchmark=self.benchmark,
            data=tuple(Path(folder) for folder in self.data),
            condition=condition,
            weights=Path(method.weights) if method.weights else None,
            options=method.option_texts,
            split="test" if self.fold is not None else self.split,
            fold=self.fold,
            limit=self.limit,
            sequences=self.sequences,
            seed=seed,
            samples=self.samples or about.samples,
            batch_size=self.batch_size or about.batch_size,
            device=self.device,
            threads=self.threads,
            control=method.control,
            isolate=self.isolate,
            timeout=self.timeout,
            protocol=Path(self.protocol) if self.protocol else None,
            out=Path(self.out) if self.out else None,
        )


@foreign_input()
def read_experiment(path: Path) -> Experiment:
    """Read an experiment's TOML file.

    Raises:
        InputFileError: if it cannot be read, or a key is unknown or of another type (naming the key).
    """
    try:
        experiment = msgspec.convert(tomllib.loads(read_whole(path, largest=HARMLESS_SIZE).decode("utf-8")), Experiment)
    except OSError as error:
        raise InputFileError(path, "", expected="an experiment's TOML file", found=error.strerror or "none") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, msgspec.ValidationError) as error:
        raise InputFileError(
            path,
            "",
            expected="the keys of an experiment",
            found=str(error),
            remedy="`prbench run --method static --show-config` prints an example.",
        ) from error
    known = find_benchmark(experiment.benchmark).conditions if experiment.benchmark in benchmarks() else ()
    named = [condition for method in experiment.methods for condition in method.conditions]
    strange = next((condition for condition in named if condition not in known), "")
    urls = [key for key, place in (("data", experiment.data), ("out", (experiment.out,))) if any(map(is_url, place))]
    key = "".join(urls[:1])
    wrong: list[tuple[bool, str, str, str, str]] = [
        (not experiment.methods, "methods", "one entry or more", "none", ""),
        (not experiment.seeds, "seeds", "one entry or more", "none", ""),
        (bool(urls), key, "paths on this machine", "a URL", f"Give it by --{key} in place of this."),
        (not known, "benchmark", " or ".join(benchmarks()), experiment.benchmark, ""),
        (bool(strange), "conditions", f"some of {', '.join(known)}", strange, did_you_mean(strange, known).strip()),
    ]
    for is_wrong, where, expected, found, remedy in wrong:
        if is_wrong:
            raise InputFileError(path, where, expected=expected, found=found, remedy=remedy)
    return experiment


def earlier_run(path: Path) -> RunFolder | None:
    """Open the run that a run folder or its ``run.json`` belongs to; return None for an experiment's file."""
    folder = path if path.is_dir() else path.parent
    return RunFolder.open(folder, any_benchmark=True) if path.is_dir() or path.name == FILE_NAME else None


def experiment_of_run(run: RunFolder, *, data: tuple[Path, ...], weights: Path | None) -> Experiment:
    """Return the experiment that repeats an earlier run.

    Args:
        run: The earlier run.
        data: Tables of the run, of a fold the whole ones; embedded ones need not be named. Run folders hold no paths.
        weights: The run's weights, where it was given other ones than the method's own.

    Raises:
        RunError: if a run folder does not record how to start the method, or one of its tables is neither named nor
            embedded.
    """
    record = run.record
    if record.method.kind in (FILE, PROGRAM, UNKNOWN):
        raise RunError(
            f"{run.path}: {record.method.name} is {record.method.origin}, and a run folder does not record how to"
            " start it. Repeat the command with --method."
        )
    find = table_finder(data)
    whole = {DatasetInfo.read(folder).content_digest: folder for folder in data if record.tables[0].fold}
    folders = []
    for table in record.tables:
        found = find(table) if table.fold is None else None
        folder = found.folder if found is not None else whole.get(table.whole_table or "")
        if folder is None:
            raise RunError(
                f"{run.path}: the run was made on a table of {table.dataset} with content digest"
                f" {table.content_digest[:12]}…, which is neither named with --data nor embedded. Name its folder."
            )
        folders.append(str(folder))
    method = ExperimentMethod(
        name=record.method.name,
        conditions=(record.condition,),
        weights=None if weights is None else str(weights),
        options=dict(record.method.options),
        control=record.control,
    )
    own_protocol = run.path / PROTOCOL_FILE
    return Experiment(
        methods=(method,),
        benchmark=record.benchmark,
        data=tuple(folders),
        split=PARTICIPANTS if record.tables[0].fold else record.split,
        fold=record.tables[0].fold,
        limit=record.limit,
        sequences=record.sequences,
        seeds=(record.seed,),
        samples=record.samples,
        batch_size=record.tables[0].batch_plan.batch_size,
        device=record.device,
        threads=record.threads,
        isolate=record.method.isolation is not None,
        protocol=str(own_protocol) if own_protocol.is_file() else None,
    )


def same_scores(first: RunFolder, second: RunFolder) -> bool:
    """Return True where two runs on the same tables have equal scores, to the last digit."""
    names = [table.dataset for table in first.record.tables]
    return all(
        read_scores(first.dataset(name).scores).equals(read_scores(second.dataset(name).scores)) for name in names
    )
