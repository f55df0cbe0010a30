"""``prbench study``: the tables and figures of the study on one's own tables and runs."""

from __future__ import annotations

from prbench.cli.commands import Group

_ABLATIONS = ("3", "4", "s4", "s5", "s6", "s7")
_FIGURES = ("1", "2", "4", "5", "s2", "s3")
_EXAMPLE = "prbench study table-2 runs/table-2 --data tables/adt --with-published --out table_2.tex table_2.csv"

study = Group(
    "study",
    sections={
        "tables": {
            name: f"prbench.cli.study_tables:{name.replace('-', '_')}"
            for name in ("table-1", "table-2", "table-s1", "table-s2", "table-s3", "table-s8")
        },
        "ablations: what `prbench ablation` has made": {
            f"table-{number}": f"prbench.cli.study_tables:table_{number}" for number in _ABLATIONS
        },
        "figures": {f"figure-{number}": f"prbench.cli.study_figures:figure_{number}" for number in _FIGURES},
    },
    example=_EXAMPLE,
    help="Make the study's tables and figures from your own tables and runs (docs/study.md).",
)
