"""Build a corpus: read recordings group by group, keep each group as a part, and merge the parts into one table.

A build that is killed goes on where it stopped; what comes out has the same bytes for any number of workers, whether it
was interrupted or not. A dry run says what a build would read, and about how long and how much that takes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from prbench.corpora.job import CorpusJob, describe
from prbench.corpora.sources import CorpusOptions, corpus_for, find_groups
from prbench.engine import Engine, InProcess
from prbench.locks import sole_writer
from prbench.manifests import digest_of, load_protocol
from prbench.sequences import parts
from prbench.sequences.corpus import CORPUS_TABLES, CorpusRecord
from prbench.sequences.corpus_table import write_corpus
from prbench.sequences.dataset_info import CORPUS_FILE, CorpusInfo
from prbench.storage import require_replaceable, text_digest

_IN_PROCESS = InProcess()
_DEFAULTS = CorpusOptions()

Progress = Callable[[int, int, str], None]
"""Called with finished recordings, all of them, and what was finished last."""


@dataclass(frozen=True)
class CorpusReport:
    """The result of a build."""

    folder: Path
    info: CorpusInfo
    records: tuple[CorpusRecord, ...]
    reused: int
    """Recordings taken over from an interrupted build."""


def build_corpus(
    name: str,
    root: Path | str | None,
    out: Path | str,
    *,
    options: CorpusOptions = _DEFAULTS,
    engine: Engine = _IN_PROCESS,
    progress: Progress | None = None,
) -> CorpusReport:
    """Build a corpus.

    Args:
        name: ``nymeria``, ``humanml3d`` or ``synthetic``.
        root: The dataset's folder; None for ``synthetic``.
        out: Folder of the new corpus; an earlier corpus there is replaced when everything is ready, and
            only by one that holds its recordings.
        options: What to read, and how to cut it.
        engine: Where recordings are worked on.
        progress: Called after each group of recordings, in order.

    Raises:
        UsageError: for an unknown corpus or option.
        InputFileError: if there is nothing to read.
        StorageError: if ``out`` cannot be written or holds something else.
        RecordingsWouldBeLost: if the corpus that stands there holds more, and the options do not say to replace it;
            finished parts are kept.
    """
    root = None if root is None else Path(root)
    out = Path(out)
    out = out.expanduser().absolute()
    require_replaceable(out, CORPUS_FILE, kind="corpus")
    corpus = corpus_for(name)
    described = corpus.described(options)
    groups = find_groups(corpus, root, options)
    job = CorpusJob(
        _settings(described, "" if corpus.manifest is None else digest_of(corpus.manifest)),
        options.on_error == "fail",
        parts.work_folder(out),
    )
    finished = []
    done = 0
    total = sum(len(group.recordings) for group in groups)
    with sole_writer(out), parts.working_in_parts(out):
        for part in engine.map(job, groups, if_full=job.if_full):
            finished.append(part)
            done += len(part.receipt.records)
            if progress is not None:
                progress(done, total, part.receipt.name)
        dataset = groups[0].recordings[0].identity.dataset
        info = describe(dataset, corpus.manifest, described, options, [part.receipt for part in finished])
        folders = [part.folder for part in finished]
        tables = {table: parts.read_batches(folders, table) for table in CORPUS_TABLES}
        # Last of all: until here an earlier corpus stands as it was.
        info = write_corpus(out, info, tables, replace=options.replace)
    records = tuple(record for part in finished for record in part.receipt.records)
    return CorpusReport(out, info, records, sum(len(part.receipt.records) for part in finished if part.reused))


def _settings(described: dict[str, str], manifest_digest: str) -> str:
    chosen = [text for item in sorted(described.items()) for text in item]
    return text_digest(manifest_digest, load_protocol().digest, *chosen)


@dataclass(frozen=True)
class CorpusPlan:
    """The input of a build, found out without reading any recording."""

    recordings: tuple[str, ...]
    skipped: tuple[str, ...]
    """Known-bad ones among them."""
    input_bytes: int
    estimated_seconds: float
    """Seconds with one worker, on a machine like the one it was measured on."""
    estimated_disk_bytes: int


def plan_corpus(name: str, root: Path | str | None, options: CorpusOptions = _DEFAULTS) -> CorpusPlan:
    """The dry run: what :func:`build_corpus` would read. Writes nothing.

    Raises:
        UsageError: for an unknown corpus or option.
        InputFileError: if there is nothing to read.
    """
    root = None if root is None else Path(root)
    corpus = corpus_for(name)
    # Options that the build would refuse are refused here, too.
    corpus.described(options)
    recordings = [each for group in find_groups(corpus, root, options) for each in group.recordings]
    costs = [each.cost for each in recordings if each.skip_reason is None]
    return CorpusPlan(
        recordings=tuple(each.identity.recording_id for each in recordings),
        skipped=tuple(each.identity.recording_id for each in recordings if each.skip_reason is not None),
        input_bytes=sum(cost.input_bytes for cost in costs),
        estimated_seconds=sum(cost.seconds for cost in costs),
        estimated_disk_bytes=round(sum(cost.disk_bytes for cost in costs)),
    )
