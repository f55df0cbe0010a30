"""Text stands for a path wherever a caller from Python gives one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from prbench.checking.doctor.examine_file import DoctorRequest
from prbench.contract import Condition
from prbench.corpora import build_corpus, plan_corpus
from prbench.curation import build_dataset, plan_build
from prbench.curation.differences import compare_builds
from prbench.errors import PrbenchError
from prbench.evaluation.request import RunRequest
from prbench.leaderboard.comparison import compare_runs
from prbench.paths import turn_into_paths
from prbench.readers import READER_MODULES, reader_for
from prbench.release import export_release, import_release
from prbench.runs.folder import RunFolder
from prbench.runs.predictions import Predictions
from prbench.sequences import CorpusInfo, CorpusTable, DatasetInfo, SequenceTable
from prbench.submitted.offline import ExportRequest
from prbench.submitted.score_predictions import ScoreRequest
from prbench.workflows.build_all import build_all, plan_all
from prbench.workflows.explain import explain_event
from prbench.workflows.inspection import inspect_folder
from prbench.workflows.view import ViewRequest

NOWHERE = "nowhere/at all"

CALLS = {
    "build_dataset": lambda out: build_dataset("adt", NOWHERE, out),
    "plan_build": lambda _: plan_build("adt", NOWHERE),
    "build_corpus": lambda out: build_corpus("nymeria", NOWHERE, out),
    "plan_corpus": lambda _: plan_corpus("nymeria", NOWHERE),
    "build_all": lambda out: build_all(NOWHERE, out),
    "plan_all": lambda _: plan_all(NOWHERE),
    "inspect_folder": lambda _: inspect_folder(NOWHERE),
    "import_release": lambda out: import_release(NOWHERE, out),
    "export_release": lambda out: export_release([NOWHERE], out),
    "compare_builds": lambda _: compare_builds(NOWHERE, NOWHERE),
    "compare_runs": lambda _: compare_runs(NOWHERE, NOWHERE),
    "explain_event": lambda _: explain_event(NOWHERE, "pick"),
    "SequenceTable": lambda _: SequenceTable.open(NOWHERE),
    "CorpusTable": lambda _: CorpusTable.open(NOWHERE),
    "DatasetInfo": lambda _: DatasetInfo.read(NOWHERE),
    "CorpusInfo": lambda _: CorpusInfo.read(NOWHERE),
    "RunFolder": lambda _: RunFolder.open(NOWHERE),
    "Predictions": lambda _: Predictions.open(NOWHERE),
    **{f"reader of {name}": lambda _, name=name: reader_for(name).find(NOWHERE) for name in READER_MODULES},
}


@pytest.mark.parametrize("name", CALLS)
def test_a_folder_that_is_missing_is_told_the_same_when_it_is_text(name, tmp_path) -> None:
    with pytest.raises(PrbenchError, match="nowhere"):
        CALLS[name](str(tmp_path / "out"))


@pytest.mark.unchecked_shapes  # fields are annotated as what they hold afterwards
def test_requests_hold_paths_whatever_they_were_given() -> None:
    tables: Any = ("tables/adt", Path("tables/gimo"))
    run: Any = "r"
    file: Any = "p.npz"
    paths = (Path("tables/adt"), Path("tables/gimo"))
    assert RunRequest(method="static", data=tables, out=run).data == paths
    assert ExportRequest(data=tables, condition=Condition.TEXT, out=file).out == Path("p.npz")
    assert ScoreRequest(predictions=file, data=tables).predictions == Path("p.npz")
    assert ViewRequest(out=file, data=tables).data == paths
    assert DoctorRequest(path=file, data=tables).data == paths


def test_what_is_none_stays_none() -> None:
    @dataclass(frozen=True)
    class Request:
        one: Path | str | None = None

        def __post_init__(self) -> None:
            turn_into_paths(self, "one")

    assert Request().one is None
    assert Request("a").one == Path("a")
