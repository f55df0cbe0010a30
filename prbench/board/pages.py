"""What a board shows, made from its folder alone: rows, pages, and what is to be cited.

Text is the same on every machine. Means of the same scores may differ in their last digits between processors, so
pages print fewer digits. The bytes of Parquet depend on the version of Arrow that wrote them: ``rows.parquet`` is
compared by content, and left as it is where that is the same.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import msgspec
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

import prbench
from prbench.board.collect import COSTS, CollectedRuns, LeaderboardRow, collect_runs
from prbench.board.export import as_board, export, licence_note
from prbench.board.folder import BoardFolder, history_text
from prbench.board.submission import FILE_NAME, RUNS, Submission
from prbench.board.tables import make_leaderboard
from prbench.board.verifying import Verification, VerifiedDataset
from prbench.datasets import SYNTHETIC_PREFIX
from prbench.errors import PrbenchError, RunError
from prbench.files import arrays
from prbench.files.bounded import foreign_input, read_whole
from prbench.files.storage import atomic_path, text_digest, write_text
from prbench.harness.results import CheckedSummary, RunChecker
from prbench.harness.run_folder.folder import RunFolder
from prbench.harness.run_folder.record import TableRecord
from prbench.limits import HARMLESS_SIZE
from prbench.protocol.manifests import dataset_names, load_citations, load_manifest
from prbench.shown import clean, latex, markdown
from prbench.tables import Block, Column, Row, Table, as_markdown

MARKDOWN = "leaderboard.md"
CSV = "leaderboard.csv"
JSON = "leaderboard.json"
ROWS = "rows.parquet"
PAGES = (MARKDOWN, CSV, JSON, ROWS)
_DIGITS = 6  # of numbers in JSON; more may differ between processors
_NUMBERS = frozenset({"value", "low", "high", "detectable"})
_COUNTS = frozenset({"sequences", "recordings", "rank"})


@foreign_input()
def read_verification(path: Path) -> Verification:
    """Read what was verified of a submission.

    Raises:
        RunError: if the file is missing or damaged.
    """
    try:
        return msgspec.json.decode(read_whole(path, largest=HARMLESS_SIZE), type=Verification)
    except (FileNotFoundError, msgspec.DecodeError) as error:
        remedy = "Take the file from the repository again, or add the submission to a new board."
        raise RunError(f"{path}: expected what was verified of the submission, found {error}. {remedy}") from error


def collect_board(board: BoardFolder) -> CollectedRuns:
    """Read the runs of all submissions that stand on a board, with what was verified of them.

    Runs on tables of one identity stand in one table, whosever copy of the data they were made on.

    Raises:
        RunError: if a run is damaged or its summary does not follow from its scores.
        InputFileError: if a file was changed.
    """
    rows: list[LeaderboardRow] = []
    left_out: list[str] = []
    for name in board.standing:
        verification = read_verification(board.verification(name))
        covered = {(each.run, each.dataset): each for each in verification.datasets}
        check = partial(_as_verified, covered)
        collected = collect_runs([board.submission(name) / RUNS], check=check, any_benchmark=True)
        left_out += [f"{name}/{reason}" for reason in collected.left_out]
        for row in collected.rows:
            submitted = replace(
                row,
                run=f"{name}/{row.run}",
                submission=name,
                training=verification.training,
                verified=_verified(covered.get((row.run, row.table.dataset))),
                table=msgspec.structs.replace(row.table, content_digest=""),
            )
            rows.append(submitted)
    return CollectedRuns(tuple(rows), tuple(left_out))


def _as_verified(
    covered: Mapping[tuple[str, str], VerifiedDataset], run: RunFolder, record: TableRecord
) -> CheckedSummary:
    """Check a run without its table, which is not needed where its scores were held against its motions before."""
    checked = RunChecker().check(run, record)
    found = covered.get((run.path.name, record.dataset))
    return checked if found is None else replace(checked, unverified="", declared=found.declared)


def _verified(found: VerifiedDataset | None) -> str:
    """Say how far the scores on the table at hand are from those that were submitted."""
    if found is None or found.same_values:
        return "verified"
    points = 100 * max((each.drift for each in found.metrics if each.unit == "rate"), default=0.0)
    millimetres = 1000 * max((each.drift for each in found.metrics if each.unit == "m"), default=0.0)
    return f"verified on another copy of the data, within {points:.2g} points and {millimetres:.2g} mm"


def page_texts(board: BoardFolder) -> dict[str, str]:
    """Return the text pages of a board by their names.

    Raises:
        RunError, InputFileError: see :func:`collect_board`.
    """
    leaderboard = make_leaderboard(collect_board(board))
    # What stands above the tables of an ordinary export is its title alone.
    _, _, tables = export(leaderboard, "md").partition("\n\n")
    info = board.info
    lines = [f"{len(board.standing)} submissions, {len(board.withdrawn)} withdrawn"]
    lines.append(f"benchmark {info.benchmark}, protocol version {info.protocol_version} ({info.protocol[:12]})")
    lines += [info.url, f"contact: {info.contact}" if info.contact else ""]
    head = [Table(title="Board", notes=tuple(filter(None, lines)))]
    head += [table for table in (_submissions(board), _withdrawn(board)) if table.blocks]
    head.append(Table(title="Data", notes=tuple(data_lines(board))))
    value = msgspec.to_builtins(as_board(leaderboard))
    value |= {"board": msgspec.to_builtins(info), "history": msgspec.to_builtins(board.history)}
    rounded = json.loads(json.dumps(value), parse_float=lambda text: float(f"{float(text):.{_DIGITS}g}"))
    written = json.dumps(rounded, indent=2, sort_keys=True, ensure_ascii=False, allow_nan=False)
    return {
        MARKDOWN: f"# {markdown(info.title)}\n\n{as_markdown(head)}\n{tables}".rstrip("\n") + "\n",
        CSV: export(leaderboard, "csv"),
        JSON: written + "\n",
    }


def _submissions(board: BoardFolder) -> Table:
    """Lay out who submitted what and when, and how it was verified."""
    rows = []
    for name, entry in board.standing.items():
        submission = _stated(board, name)
        verification = read_verification(board.verification(name))
        text = {
            "name": submission.name,
            "id": name,
            "authors": ", ".join(submission.authors),
            "date": entry.date,
            "training": verification.training,
            "verdict": verification.verdict,
            "links": " ".join(filter(None, (submission.url, submission.paper, submission.code))),
        }
        rows.append(Row(text=text))
    titles = {
        "name": "Submission",
        "id": "Id",
        "authors": "Authors",
        "date": "Added",
        "training": "Training data (declared)",
    }
    titles |= {"verdict": "Verified", "links": "Page, paper, code"}
    columns = tuple(Column(key=key, title=title, text=True) for key, title in titles.items())
    blocks = (Block(rows=tuple(rows)),) if rows else ()
    return Table(title="Submissions", columns=columns, blocks=blocks)


def _withdrawn(board: BoardFolder) -> Table:
    rows = [
        Row(text={"id": name, "date": entry.date, "reason": entry.reason}) for name, entry in board.withdrawn.items()
    ]
    titles = {"id": "Id", "date": "Withdrawn", "reason": "Reason"}
    columns = tuple(Column(key=key, title=title, text=True) for key, title in titles.items())
    return Table(title="Withdrawn", columns=columns, blocks=(Block(rows=tuple(rows)),) if rows else ())


def _stated(board: BoardFolder, name: str) -> Submission:
    """Read what a submission says of itself, without looking at its other files again."""
    return msgspec.json.decode(read_whole(board.submission(name) / FILE_NAME, largest=HARMLESS_SIZE), type=Submission)


def data_lines(board: BoardFolder) -> Iterator[str]:
    """Yield a sentence on each dataset: its table, and what its licence keeps from this board."""
    permitted: dict[str, list[str]] = {}
    for name in board.standing:
        for dataset in _stated(board, name).permission:
            permitted.setdefault(dataset, []).append(name)
    for dataset in board.info.datasets:
        yield f"{dataset.title} ({dataset.name}): identity of its table {dataset.identity[:12]}."
        kept = licence_note(dataset.title, dataset.redistribution)
        if kept:
            yield kept
        for name in permitted.get(dataset.name, ()):
            yield f"{name} may hold recorded motion of {dataset.name}, by a permission that its authors state."


def rows_table(csv: str) -> pa.Table:
    """Return the rows of ``leaderboard.csv`` with the types of their columns."""
    names = csv.partition("\n")[0].split(",")
    kinds = {name: pa.string() for name in names} | {"higher_is_better": pa.bool_()}
    kinds |= dict.fromkeys((*_NUMBERS, *(column for _, column in COSTS.values())), pa.float64())
    kinds |= dict.fromkeys(_COUNTS, pa.int64())
    options = pyarrow.csv.ConvertOptions(column_types=kinds)
    return pyarrow.csv.read_csv(io.BytesIO(csv.encode()), convert_options=options)


def has_rows(path: Path, rows: pa.Table) -> bool:
    """Return True if a file holds these very rows, whatever version of Arrow wrote it."""
    try:
        return arrays.read_parquet(path).equals(rows)
    except (OSError, pa.ArrowException, PrbenchError):
        return False


def write_pages(board: BoardFolder) -> None:
    """Write the pages of a board, each whole or not at all; those that are the same stay as they are.

    Raises:
        RunError, InputFileError: see :func:`collect_board`.
        StorageError: if the folder cannot be written.
    """
    texts = page_texts(board)
    for name, text in texts.items():
        write_text(board.path / name, text)
    rows = rows_table(texts[CSV])
    if not has_rows(board.path / ROWS, rows):
        with atomic_path(board.path / ROWS) as temporary:
            pq.write_table(rows, temporary)


def cited_with(datasets: Iterable[str]) -> list[str]:
    """Return BibTeX entries of what every board of some datasets cites: the datasets, the study and prbench."""
    manifests = [name.removeprefix(SYNTHETIC_PREFIX) for name in datasets]
    entries = [load_manifest(name).citation.strip() for name in manifests if name in dataset_names()]
    common = load_citations()
    toolkit = common["toolkit"].replace("VERSION", prbench.__version__)
    return list(dict.fromkeys([*entries, common["study"].strip(), toolkit.strip()]))


class BoardCitation(msgspec.Struct, frozen=True, kw_only=True):
    """How to cite a board and what stands on it.

    Attributes:
        bibtex: BibTeX entries of the board in its present state, the study, prbench and each dataset; declared papers
            of the methods are comments.
        apa: The board in APA style.
        cff: ``CITATION.cff`` for the board's repository.
    """

    bibtex: str
    apa: str
    cff: str


def cite_board(board: BoardFolder) -> BoardCitation:
    """Return what to cite of a board; its state is told by the digest of its history.

    The year is that of the last entry, so the same board is cited alike for ever.
    """
    info = board.info
    year = board.history[-1].date[:4] if board.history else "n.d."
    state = text_digest(history_text(board.history))[:10]
    note = (
        f"{info.benchmark}, protocol version {info.protocol_version}, {len(board.standing)} submissions, state {state}"
    )
    names = info.maintainers or (info.title,)
    fields = {
        "title": f"{{{latex(info.title)}}}",
        "author": " and ".join(f"{{{latex(name)}}}" for name in names),
        "year": year,
    }
    fields |= {"note": latex(note)} | ({"howpublished": rf"\url{{{info.url}}}"} if info.url else {})
    body = "".join(f"  {key:<12} = {{{value}}},\n" for key, value in fields.items())
    entries = [f"@misc{{board-{state},\n{body}}}", *cited_with(dataset.name for dataset in info.datasets)]
    papers = []
    for name in board.standing:
        submission = _stated(board, name)
        authors = clean(", ".join(submission.authors)) or "no authors named"
        declared = submission.paper or submission.url or submission.code or "no paper declared"
        papers.append(f"% {name}: {clean(submission.name)}, {authors}: {declared}")
    cff = {"cff-version": "1.2.0", "message": "Please cite this board, its benchmark, and what its entries declare."}
    cff |= {"title": info.title, "type": "dataset", "version": state} | ({"url": info.url} if info.url else {})
    lines = [f"{key}: {json.dumps(value, ensure_ascii=False)}" for key, value in cff.items()]
    lines += ["authors:", *(f"  - name: {json.dumps(name, ensure_ascii=False)}" for name in names)]
    return BoardCitation(
        bibtex="\n\n".join(filter(None, [*dict.fromkeys(entries), "\n".join(papers)])),
        apa=f"{', '.join(names)} ({year}). {info.title} [{note}]. {info.url}".strip(),
        cff="\n".join(lines) + "\n",
    )
