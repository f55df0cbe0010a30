"""``prbench ablation``: train, finish and run the rows of the study's ablations."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from prbench.cli.commands import Answer, Command, Group, command, note
from prbench.cli.options import (
    PATH,
    data_option,
    device_option,
    limit_option,
    out_folder_option,
    run_checker,
    seed_option,
    threads_option,
    workers_option,
)

if TYPE_CHECKING:
    from prbench_benchmarks.prime_and_reach.ablation import AblationReport

_TABLES = ("3", "4", "s4", "s5", "s6", "s7")

ablation = Group(
    "ablation",
    section="board",
    sections={"tables": {f"table-{number}": f"{__name__}:table_{number}" for number in _TABLES}},
    example="prbench ablation table-3 --data tables/hd-epic tables/mogaze --nymeria corpora/nymeria"
    " --device cuda --out ablations",
    help="Train and run the rows of Tables 3, 4 and S4 to S7; the same command goes on where it was interrupted.",
)


class AblationAnswer(msgspec.Struct, frozen=True, kw_only=True):
    """What is there of a table of ablations.

    Attributes:
        folder: Folder of the configuration: its trainings and runs, from which the group ``study`` makes tables.
        runs: Run folders that are finished.
        failed: Maps rows that failed to the reason.
        stamps: Maps the parts of the table to what sets their trainings apart from the study's.
        files: The table as CSV, LaTeX and Markdown.
    """

    folder: Path
    runs: list[Path]
    failed: dict[str, str]
    stamps: dict[str, str]
    files: list[Path]


def _command(number: str) -> Command:
    @command(
        f"table-{number.lower()}",
        example=f"prbench ablation table-{number.lower()} --data tables/hd-epic tables/mogaze"
        " --nymeria corpora/nymeria --device cuda --out ablations",
        resumes=True,
        report=AblationAnswer,
    )
    @data_option(required=True, help="Built dataset folder(s): split 'train' is learnt from, 'test' is run.")
    @click.option("--nymeria", type=PATH, metavar="DIR", help="The built corpus Nymeria, to pre-train on.")
    @click.option("--humanml3d", type=PATH, metavar="DIR", help="The same of HumanML3D (Table 4).")
    @click.option(
        "--config",
        "configuration",
        type=PATH,
        default="paper",
        metavar="NAME|FILE",
        help="Configuration of the trainings: paper (default: days on a GPU), small, smoke (seconds; learns nothing,"
        " and its table is stamped so), or a .toml file.",
    )
    @out_folder_option("Folder of trainings, runs and tables (default ablations); resumes.")
    @limit_option()
    @device_option
    @threads_option
    @seed_option("of the runs")
    @workers_option()
    def run(
        data: tuple[Path, ...],
        nymeria: Path | None,
        humanml3d: Path | None,
        configuration: Path,
        out: Path | None,
        limit: int | None,
        device: str,
        threads: int,
        seed: int,
        workers: int,
    ) -> Answer:
        from prbench.engine import engine_for
        from prbench_benchmarks.prime_and_reach.ablation import AblationRequest, run_ablation

        corpora = {"nymeria": nymeria, "humanml3d": humanml3d}
        request = AblationRequest(
            table=number,
            data=data,
            out=out or Path("ablations"),
            corpora={name: folder for name, folder in corpora.items() if folder is not None},
            configuration=str(configuration),
            device=device,
            threads=threads,
            limit=limit,
            seed=seed,
        )
        engine = engine_for(workers)
        report = run_ablation(request, engine=engine, say=note)
        return _answer(number, data, workers, report)

    run.help = (
        f"Train and run the rows of Table {number}, and print the table.\n\n"
        "A row that fails ends nothing but itself; the same command tries it again and goes on with the others."
    )
    return run


def _answer(number: str, data: tuple[Path, ...], workers: int, report: AblationReport) -> Answer:
    from prbench_benchmarks.prime_and_reach.ablation import ablation_table
    from prbench_benchmarks.prime_and_reach.study.formats import FORMATS, write_tables
    from prbench_benchmarks.prime_and_reach.study_answers import print_study_tables

    files: list[Path] = []
    tables = []
    if report.runs:
        check = run_checker(data, workers).check
        tables = ablation_table(number, report.folder, check, with_published=True)
        files = [report.folder / f"table_{number.lower()}{suffix}" for suffix in FORMATS]
        for path in files:
            write_tables(tables, path)
    stamps = {table.part: table.stamp for table in tables if table.stamp}
    answer = AblationAnswer(
        folder=report.folder, runs=list(report.runs), failed=report.failed, stamps=stamps, files=files
    )

    def show() -> None:
        """Print the tables, the rows that failed, and the written files."""
        print_study_tables(tables)
        for name, reason in report.failed.items():
            print(f"failed: {name}: {reason}")
        for path in files:
            print(f"written: {path}")

    return Answer(answer, show, exit_code=1 if report.failed else 0)


table_3 = _command("3")
table_4 = _command("4")
table_s4 = _command("S4")
table_s5 = _command("S5")
table_s6 = _command("S6")
table_s7 = _command("S7")
