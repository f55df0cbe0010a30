"""From a release as the authors' page describes it to a row of a board, and the scores are those of before."""

from __future__ import annotations

import dataclasses
import json
import re
import shlex
from pathlib import Path

import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest

from prbench.cli import main
from prbench.contract import Condition
from prbench.geometry.skeleton import Joint
from prbench.harness.conditions import ConditionSource
from prbench.harness.planning import select
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.synthetic_table import build_synthetic_table, recordings_of_people
from prbench.metrics import METRICS, SCENE_METRICS
from prbench.release.exporting import export_release
from prbench.release.importing import import_release
from prbench.sequences import DatasetInfo, Sequence, SequenceTable
from prbench.sequences.sequence import event_batch, recording_batch, sequence_batch, sequences_in
from prbench.sequences.write import write_dataset
from tests.release.tables import looking_table
from tests.shared import made_once

PAGE = (Path(__file__).parents[2] / "docs" / "release.md").read_text(encoding="utf-8")
FOLDERS = {"hd-epic": "HD-EPIC", "mogaze": "MoGaze", "hot3d": "HOT3D", "adt": "ADT", "gimo": "GIMO"}


def test_the_commands_of_the_page_lead_from_the_release_to_a_row_of_a_board(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    embedded = tuple(
        looking_table(tmp_path / "tables" / name, 12, dataset=f"synthetic-{name}").folder for name in FOLDERS
    )
    monkeypatch.setattr("prbench.cli.options.embedded_tables", lambda _: embedded)
    printed = {}
    blocks = re.findall(r"^```bash\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
    # The page begins with what owners of the release do; here its last command makes one.
    for line in "".join([blocks[-1], *blocks[:-1]]).splitlines():
        words = shlex.split(
            line.replace("/data/PR", "PR").replace("released/adt", "released/synthetic-adt"), comments=True
        )
        assert main(words[1:]) == 0, line
        printed[words[1]] = capsys.readouterr().out
    for folder in FOLDERS.values():
        entries = json.loads(Path("PR", folder, "target_information.json").read_text("utf-8"))
        assert set(entries["0000000000"]) == {"goal_location", "text_prompt", "subset", "primed_frame"}
        assert {entry["subset"] for entry in entries.values()} == {"train", "test"}
        files = {path.name for path in Path("PR", folder).iterdir()}
        assert files == {"motions", "gazes", "target_information.json", "prbench_export.json"}
    for published in ("18134", "3.64 ± 0.94", "2.37 ± 1.57", "12642", "Published: Prime and Reach, Table 1"):
        assert published in printed["import-release"]
    assert main(["study", "table-1", *(f"tables/released/synthetic-{name}" for name in sorted(FOLDERS))]) == 0
    assert capsys.readouterr().out.strip() in printed["import-release"], "the same table as that of the study command"
    assert "never compare them with published ones" in printed["run"]
    assert "synthetic-hot3d" in Path("board.md").read_text("utf-8")
    assert main(["score", "runs/static", "--data", "tables/released"]) == 0


def as_released(row: Sequence) -> Sequence:
    """Everything of a sequence that the authors' layout can say; the rest as an import makes it up."""
    joints = row.joints.astype(np.float64)
    return dataclasses.replace(
        row,
        split="train" if row.split == "validation" else row.split,
        hand=None,
        start_time=0.0,
        prime_time=row.prime_frame / row.fps,
        event_time=(row.n_frames - 1) / row.fps,
        gaze_origin=row.joints[:, Joint.HEAD],
        previous_joints=(2 * joints[0] - joints[1]).astype(np.float32),
    )


def reduced(table: SequenceTable, folder: Path) -> SequenceTable:
    """Write the table with nothing but what a release can say of its sequences."""
    info = msgspec.structs.replace(DatasetInfo.read(table.folder), file_digests={})
    rows = [as_released(row) for chunk in table.chunks() for row in sequences_in(chunk.batch)]
    write_dataset(
        folder, info, sequences=[sequence_batch(rows)], events=[event_batch([])], recordings=[recording_batch([])]
    )
    return SequenceTable.open(folder)


def scores(table: SequenceTable, method: str, condition: Condition, out: Path) -> dict[tuple[int, str], float]:
    """Values by number of the sequence and metric."""
    run_method(RunRequest(method=method, condition=condition, data=(table.folder,), out=out))
    numbers = {name: number for number, name in enumerate(table.scalars()["sequence_id"].to_pylist())}
    rows = pq.read_table(next(out.rglob("scores.parquet"))).to_pylist()
    return {(numbers[row["sequence_id"]], row["metric"]): row["value"] for row in rows}


@pytest.fixture(scope="module", params=["hot3d", pytest.param("adt", marks=pytest.mark.slow)])
def both(request, tmp_path_factory) -> tuple[SequenceTable, SequenceTable, SequenceTable]:
    """A curated table, what a release can say of it, and what came back from one."""
    name = request.param
    recordings = recordings_of_people(name, 3, {"train": 1, "test": 1})

    def build(out: Path) -> None:
        build_synthetic_table(name, recordings, 3, out / "table", n_events=8)

    folder = made_once(f"scored-{name}", build)
    table = SequenceTable.open(folder / "table")
    work = tmp_path_factory.mktemp("scores")
    export_release([table.folder], work / "release", as_published=True)
    import_release(work / "release", work / "back")
    return table, reduced(table, work / "reduced"), SequenceTable.open(work / "back" / table.info.dataset)


@pytest.mark.parametrize("condition", list(Condition))
def test_scores_after_an_import_differ_by_nothing_but_what_the_release_cannot_say(both, condition, tmp_path) -> None:
    _, said, back = both
    for method in ("ground-truth", "scripted", *(["static"] if condition == Condition.NONE else [])):
        before, after = (
            scores(table, method, condition, tmp_path / f"{method}-{k}") for k, table in enumerate((said, back))
        )
        assert after == before
        expected = {metric.id for metric in METRICS} - SCENE_METRICS
        assert {metric for _, metric in after} >= expected - (set() if method == "ground-truth" else {
            metric.id for metric in METRICS if "gaze" in metric.id
        })  # fmt: skip


@pytest.mark.parametrize("condition", list(Condition))
def test_a_method_is_given_the_same(both, condition) -> None:
    _, said, back = both
    batches = []
    for table in (said, back):
        selection = select(table, split="test", limit=None)
        source = ConditionSource.read(selection)
        batches.append(source.batch(np.arange(len(selection)), condition, seed=0, salt=b"salt", sample=0))
    before, after = batches
    for each in dataclasses.fields(before):
        if each.name not in ("opaque_id", "noise_seed"):  # both follow from ids, which a release has not
            np.testing.assert_array_equal(getattr(after, each.name), getattr(before, each.name), err_msg=each.name)


def test_what_the_release_cannot_say_moves_only_the_scores_that_the_page_names(both, tmp_path) -> None:
    table, _, back = both
    before, after = (
        scores(each, "ground-truth", Condition.NONE, tmp_path / str(k)) for k, each in enumerate((table, back))
    )
    changed = {metric for key, value in after.items() for metric in [key[1]] if value != before[key]}
    named = [metric.id for metric in METRICS if f"`{metric.id}`" in PAGE]
    assert changed <= {name for name in named if name not in SCENE_METRICS}
    assert {metric for _, metric in set(before) - set(after)} <= SCENE_METRICS
