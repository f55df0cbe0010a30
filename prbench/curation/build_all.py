"""``prbench build-dataset all``: build whatever lies below a folder, each dataset into a table of its own."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from prbench.curation import BuildPlan, BuildReport, Progress, build_dataset, plan_build
from prbench.curation.options import NO_OPTIONS, BuildOptions
from prbench.engine import Engine, InProcess
from prbench.errors import PrbenchError, UsageError
from prbench.readers import reader_for
from prbench.readers.discover import FoundDataset, discover

_IN_PROCESS = InProcess()


@dataclass(frozen=True)
class Outcome:
    """The outcome of one dataset."""

    dataset: str
    root: Path
    report: BuildReport | None
    """The report; None where nothing could be built."""
    message: str
    """The reason why nothing was built; empty where it was."""

    @property
    def complete(self) -> bool:
        """Return True if every recording that was found could be read to its end."""
        if self.report is None:
            return False
        counts = self.report.info.counts
        return counts.recordings_failed == 0 and counts.recordings_cut_short == 0


def build_all(
    root: Path | str,
    out: Path | str,
    *,
    options: BuildOptions = NO_OPTIONS,
    engine: Engine = _IN_PROCESS,
    progress: Callable[[str, Progress], None] | None = None,
) -> tuple[Outcome, ...]:
    """Build every dataset that is recognised below a folder, into ``out/<dataset>``.

    Args:
        root: Folder that holds copies of datasets, or one of them.
        out: Folder of the tables.
        options: As for one dataset; options of readers go to those that know them.
        engine: Where recordings are worked on.
        progress: Called with the dataset's name after each recording.

    Raises:
        InputFileError: if nothing is recognised.
        UsageError: if an option fits no dataset that was found, or one dataset was found twice.
        PrbenchError: the first problem of a dataset, with ``on_error="fail"``.
    """
    root = Path(root)
    out = Path(out)
    discovery = discover(root)
    chosen = _reader_options(discovery.found, options)
    outcomes = [Outcome(broken.dataset, broken.root, None, broken.message) for broken in discovery.broken]
    if outcomes and options.on_error == "fail":
        raise PrbenchError(outcomes[0].message)
    for found in discovery.found:
        # A reader gets only the options that it knows; those of other datasets would be refused.
        own = dataclasses.replace(options, reader=chosen[found.dataset])
        try:
            report = build_dataset(
                found.dataset,
                found.root,
                out / found.name,
                options=own,
                engine=engine,
                progress=None if progress is None else lambda step, name=found.name: progress(name, step),
            )
        except PrbenchError as error:
            if options.on_error == "fail":
                raise
            outcomes.append(Outcome(found.name, found.root, None, str(error)))
        else:
            outcomes.append(Outcome(found.name, found.root, report, ""))
    # By name, so that broken folders, which are known before anything is built, stand among the others.
    return tuple(sorted(outcomes, key=lambda outcome: outcome.dataset))


def plan_all(root: Path | str, options: BuildOptions = NO_OPTIONS) -> tuple[tuple[str, Path, BuildPlan], ...]:
    """The dry run: name, folder and plan of every dataset that :func:`build_all` would build.

    Raises:
        InputFileError: if nothing is recognised.
        UsageError: if an option fits no dataset that was found, or one dataset was found twice.
    """
    found = discover(root).found
    chosen = _reader_options(found, options)
    return tuple(
        (
            each.name,
            each.root,
            plan_build(each.dataset, each.root, dataclasses.replace(options, reader=chosen[each.dataset])),
        )
        for each in found
    )


def _reader_options(
    found: tuple[FoundDataset, ...], options: BuildOptions
) -> Mapping[str, tuple[tuple[str, str], ...]]:
    """The options of each dataset's reader, out of those given for all of them."""
    twice = [name for name, count in Counter(each.name for each in found).items() if count > 1]
    if twice:
        places = " and ".join(str(each.root) for each in found if each.name == twice[0])
        raise UsageError(f"{twice[0]} was found in {places}; build the one you mean with `build-dataset {twice[0]}`.")
    # Rules are named after what a dataset records (grasps, bodies, annotations), so no rule is meant for all of them.
    if options.curation.in_hand is not None:
        raise UsageError("--in-hand names a rule of one dataset; build that dataset by itself.")
    known = {each.dataset: reader_for(each.dataset).options.names() for each in found}
    for name, _ in options.reader:
        if not any(name in names for names in known.values()):
            everything = sorted({name for names in known.values() for name in names})
            raise UsageError(f"no reader of what was found has an option '{name}'; they have: {', '.join(everything)}.")
    return {dataset: tuple(o for o in options.reader if o[0] in names) for dataset, names in known.items()}
