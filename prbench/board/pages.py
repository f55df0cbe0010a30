"""What a board shows, made from its folder alone: rows, pages, and what is to be cited.

Text is the same on every machine. Means of the same scores may differ in their last digits between processors, so
pages print fewer digits. No page is Parquet, whose bytes depend on the version of Arrow that wrote them.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import msgspec

import prbench
from prbench.board.collect import CollectedRuns, LeaderboardRow, collect_runs
from prbench.board.export import as_board, export, licence_note
from prbench.board.folder import BoardFolder
from prbench.board.submission import FILE_NAME, RUNS, Submission
from prbench.board.tables import make_leaderboard
from prbench.board.verifying import Verification, VerifiedDataset
from prbench.datasets import imitated
from prbench.files.bounded import foreign_input, read_whole
from prbench.files.storage import text_digest
from prbench.harness.results import CheckedSummary, RunChecker
from prbench.harness.run_folder.folder import RunFolder
from prbench.harness.run_folder.record import TableRecord, read_record
from prbench.limits import HARMLESS_SIZE
from prbench.protocol.manifests import dataset_names, load_citations, load_manifest
from prbench.shown import clean, latex, markdown
from prbench.tables import Block, Column, Row, Table, as_markdown

PAGES = ("leaderboard.md", "leaderboard.csv", "leaderboard.json")
_SUBMISSIONS = {
    "name": "Submission",
    "id": "Id",
    "authors": "Authors",
    "date": "Added",
    "training": "Training data (declared)",
    "state": "State",
    "links": "Page, paper, code",
}


@dataclass(frozen=True)
class Standing:
    """A submission that stands on a board, as it says of itself, and what was verified of it.

    Neither is looked at again: see :func:`prbench.board.upkeep.sound_board`.
    """

    stated: Submission
    verified: Verification

    @classmethod
    @foreign_input()
    def read(cls, board: BoardFolder, name: str) -> Standing:
        """Read both files.

        Raises:
            InputFileError: if the first is missing or damaged.
            RunError: if the second is damaged.
        """
        file = board.submission(name) / FILE_NAME
        path = board.verification(name)
        missing = f"{path}: expected what was verified of the submission, found no such file."
        verified = read_record(path, Verification, missing=missing, remedy="Take it from the repository again.")
        return cls(Submission.decoded(read_whole(file, largest=HARMLESS_SIZE), file), verified)

    @property
    def links(self) -> str:
        """Page, paper and code, as far as they are declared."""
        return " ".join(filter(None, (self.stated.url, self.stated.paper, self.stated.code)))


def collect_board(board: BoardFolder) -> CollectedRuns:
    """Read the runs of all submissions that stand on a board, with what was verified of them.

    Runs on tables of one identity stand in one table, whosever copy of the data they were made on.

    Raises:
        RunError: if a run is damaged or its summary does not follow from its scores.
        InputFileError: if a file is damaged.
    """
    rows: list[LeaderboardRow] = []
    left_out: list[str] = []
    for name in board.standing:
        verified = Standing.read(board, name).verified
        covered = {(each.run, each.dataset): each for each in verified.datasets}

        def check(run: RunFolder, record: TableRecord) -> CheckedSummary:
            # Without its table, which is not needed where the scores were held against the motions before.
            checked = RunChecker().check(run, record)
            found = covered.get((run.path.name, record.dataset))  # noqa: B023 - called within this turn
            return checked if found is None else replace(checked, unverified="", declared=found.declared)

        collected = collect_runs([board.submission(name) / RUNS], check=check, any_benchmark=True)
        left_out += [f"{name}/{reason}" for reason in collected.left_out]
        for row in collected.rows:
            table = msgspec.structs.replace(row.table, content_digest="")
            about = {"run": f"{name}/{row.run}", "submission": name, "training": verified.training, "table": table}
            rows.append(replace(row, **about, verified=_verified(covered.get((row.run, row.table.dataset)))))
    return CollectedRuns(tuple(rows), tuple(left_out))


def _verified(found: VerifiedDataset | None) -> str:
    """Say how far the scores on the table at hand are from those that were submitted."""
    if found is None or found.same_values:
        return "verified"
    points = 100 * max((each.drift for each in found.metrics if each.unit == "rate"), default=0.0)
    millimetres = 1000 * max((each.drift for each in found.metrics if each.unit == "m"), default=0.0)
    return f"verified on another copy of the data, within {points:.2g} points and {millimetres:.2g} mm"


def pages_of(board: BoardFolder) -> dict[str, bytes]:
    """Return the pages of a board by their names.

    Raises:
        RunError, InputFileError: see :func:`collect_board`.
    """
    leaderboard = make_leaderboard(collect_board(board))
    info = board.info
    notes = [f"submissions: {len(board.standing)}, withdrawn: {len(board.withdrawn)}", f"benchmark {info.rules}"]
    notes += [info.url, info.contact and f"contact: {info.contact}", *_data_lines(board)]
    columns = tuple(Column(key=key, title=title, text=True) for key, title in _SUBMISSIONS.items())
    rows = []
    for name, entry in board.standing.items():
        found = Standing.read(board, name)
        about = {"name": entry.name, "id": name, "authors": ", ".join(found.stated.authors), "date": entry.date}
        about |= {"training": found.verified.training, "state": found.verified.verdict, "links": found.links}
        rows.append(Row(text=about))
    for name, (added, gone) in board.withdrawn.items():
        state = f"withdrawn on {gone.date}: {gone.reason}"
        rows.append(Row(text={"name": added.name, "id": name, "date": added.date, "state": state}))
    blocks = (Block(rows=tuple(rows)),)
    head = Table(title="Submissions", columns=columns, blocks=blocks, notes=tuple(filter(None, notes)))
    # What stands above the tables of an ordinary export is its title alone.
    tables = export(leaderboard, "md").partition("\n\n")[2]
    value = msgspec.to_builtins(as_board(leaderboard)) | msgspec.to_builtins({"board": info, "history": board.history})
    rounded = json.loads(json.dumps(value), parse_float=lambda text: float(f"{float(text):.6g}"))
    page = f"# {markdown(info.title)}\n\n{as_markdown([head])}\n{tables}"
    written = json.dumps(rounded, indent=2, sort_keys=True, ensure_ascii=False) + "\n"
    texts = (page.rstrip("\n") + "\n", export(leaderboard, "csv"), written)
    return {name: text.encode() for name, text in zip(PAGES, texts)}


def _data_lines(board: BoardFolder) -> Iterator[str]:
    """Yield a sentence on the table of each dataset, and what its licence keeps from this board."""
    permissions = {name: Standing.read(board, name).stated.permission for name in board.standing}
    for each in board.info.datasets:
        yield f"{each.title} ({each.dataset}): identity of its table {each.identity[:12]}"
        yield licence_note(each.title, each.redistribution)
        for name in (name for name, datasets in permissions.items() if each.dataset in datasets):
            yield f"{name} may hold recorded motion of {each.dataset}, by a permission that its authors state."


def cited_with(datasets: Iterable[str]) -> list[str]:
    """Return BibTeX entries of what every board of some datasets cites: the datasets, the study and prbench."""
    sources = map(imitated, datasets)
    entries = [load_manifest(name).citation for name in sources if name in dataset_names()]
    common = load_citations()
    entries += [common["study"], common["toolkit"].replace("VERSION", prbench.__version__)]
    return list(dict.fromkeys(entry.strip() for entry in entries))


class BoardCitation(msgspec.Struct, frozen=True, kw_only=True):
    """How to cite a board and what stands on it.

    Attributes:
        bibtex: Entries of the board in its present state, each dataset, the study and prbench; papers that methods
            declare are comments.
        apa: The board in APA style.
        cff: ``CITATION.cff`` for the board's repository.
    """

    bibtex: str
    apa: str
    cff: str


def cite_board(board: BoardFolder) -> BoardCitation:
    """Return what to cite of a board; the digest of its history tells the state, its last entry the year."""
    info = board.info
    year = board.history[-1].date[:4] if board.history else "n.d."
    state = text_digest(board.text)[:10]
    note = f"{info.rules}, submissions: {len(board.standing)}, state {state}"
    names = info.maintainers or (info.title,)
    authors = " and ".join(f"{{{latex(name)}}}" for name in names)
    about = {"title": f"{{{latex(info.title)}}}", "author": authors, "year": year, "note": latex(note)}
    about |= {"url": clean(info.url)} if info.url else {}
    body = "".join(f"  {key:<6} = {{{value}}},\n" for key, value in about.items())
    entries = [f"@misc{{board-{state},\n{body}}}", *cited_with(each.dataset for each in info.datasets)]
    for name in board.standing:
        found = Standing.read(board, name)
        by = clean(", ".join(found.stated.authors)) or "no authors named"
        entries.append(f"% {name}: {clean(found.stated.name)}, {by}: {found.links or 'no paper declared'}")
    fields = {"cff-version": "1.2.0", "message": "Cite this board, its benchmark and what its entries declare."}
    fields |= {"title": info.title, "type": "dataset", "version": state, "authors": [{"name": name} for name in names]}
    fields |= {"url": info.url} if info.url else {}
    return BoardCitation(
        bibtex="\n\n".join(entries),
        apa=f"{', '.join(names)} ({year}). {info.title} [{note}]. {info.url}".strip(),
        cff="".join(f"{key}: {json.dumps(value, ensure_ascii=False)}\n" for key, value in fields.items()),
    )
