"""``prbench study``: the tables and figures of the study on one's own tables and runs."""

from __future__ import annotations

from prbench.cli.commands import Group

_PACKAGE = "prbench_benchmarks.prime_and_reach"
_ABLATIONS = ("3", "4", "s4", "s5", "s6", "s7")
_FIGURES = ("1", "2", "4", "5", "s2", "s3")
_EXAMPLE = "prbench study table-2 runs/table-2 --data tables/adt --with-published --out table_2.tex table_2.csv"

study = Group(
    "study",
    section="board",
    sections={
        "tables": {
            name: f"{_PACKAGE}.table_commands:{name.replace('-', '_')}"
            for name in ("table-1", "table-2", "table-s1", "table-s2", "table-s3", "table-s8")
        },
        "ablations: what `prbench ablation` has made": {
            f"table-{number}": f"{_PACKAGE}.table_commands:table_{number}" for number in _ABLATIONS
        },
        "figures": {f"figure-{number}": f"{_PACKAGE}.figure_commands:figure_{number}" for number in _FIGURES},
    },
    example=_EXAMPLE,
    help="Make the study's tables and figures from your own tables and runs (docs/study.md).",
)
