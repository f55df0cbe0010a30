"""Figures 4 and S3 and those of motions: their numbers against the runs' own scores, and files that can be read."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from xml.etree import ElementTree

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from prbench.cli.main import main
from prbench.engine import InProcess
from prbench.errors import PrbenchError, RunError, UsageError
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.run_folder.scores import read_scores
from prbench.metrics import MotionBatch, ScoringTargets, score
from prbench.protocol.manifests import load_protocol
from prbench.sequences import SequenceTable
from prbench.tables import Block, Cell, Row, Table
from prbench_benchmarks.prime_and_reach.study.charts import (
    GROUPINGS,
    breakdown_table,
    draw_breakdown,
    genuine_runs,
    sweep,
    sweep_table,
)
from tests.fakes import fake_dataset
from tests.tables.test_tables import require_whole_latex

PNG = b"\x89PNG"


@pytest.fixture(scope="module")
def table(tmp_path_factory) -> SequenceTable:
    return fake_dataset(tmp_path_factory.mktemp("figures") / "table", n=48)


@pytest.fixture(scope="module")
def runs(table, tmp_path_factory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("runs")
    for name in ("ground-truth", "scripted"):
        run_method(RunRequest(method=name, data=(table.folder,), out=folder / name))
    return {path.name: path for path in folder.iterdir()}


@pytest.fixture(scope="module")
def opened(runs, table):
    return genuine_runs(list(runs.values()), [table.folder], InProcess())


@pytest.mark.parametrize("by", GROUPINGS)
def test_groups_are_parts_of_the_run(by, opened):
    """The groups' sums are those of all scores."""
    table = breakdown_table(opened, by)
    for run, block in zip(opened, table.blocks, strict=True):
        stored = read_scores(run.run.dataset(run.record.dataset).scores)
        for metric, scale in (("prime_success", 100), ("mpjpe", 1)):
            values = stored.filter(pc.field("metric") == metric)["value"].to_numpy()
            own = [cell for row in block.rows for cell in row.cells if cell.metric == metric]
            assert sum(each.sequences for each in own) == len(values)
            assert sum(each.value * each.sequences for each in own) == pytest.approx(scale * values.sum())


def test_pick_and_put_are_the_table_s_own_words(opened, table):
    rows = breakdown_table(opened, "action").blocks[0].rows
    actions = table.scalars(split="test")["action"].to_pylist()
    assert [(row.text["group"], int(row.text["counts"].split()[0])) for row in rows] == [
        (action, actions.count(action)) for action in sorted(set(actions))
    ]


def test_an_unknown_grouping_is_refused(opened):
    with pytest.raises(UsageError, match="--by: unknown 'colour'"):
        breakdown_table(opened, "colour")


def test_a_sweep_is_what_scoring_under_other_limits_gives(opened, table):
    run = opened[0]
    found = sweep(run, engine=InProcess())
    assert (found.windows, len(found.distances)) == ((0.0, 0.25, 0.5, 0.75, 1.0, 1.25), 41)
    metric = "prime_success"
    motions, targets = _motions(run, table)
    for i, j in ((1, 4), (4, 10), (5, 30)):
        limits = msgspec.structs.replace(
            load_protocol().metrics, prime_window=found.windows[i], prime_distance=found.distances[j]
        )
        expected = score(motions, motions, targets, limits, metrics=[metric])[metric].value.mean()
        assert found.rates[i, j] == pytest.approx(expected)
    assert (np.diff(found.rates, axis=1) >= 0).all()
    assert (np.diff(found.rates[1:], axis=0) >= 0).all()


def _motions(run, table) -> tuple[MotionBatch, ScoringTargets]:
    """The recorded motion of the test split, which the run of the ground truth is made of."""
    parts = []
    for chunk in table.chunks(split="test"):
        targets = ScoringTargets(
            chunk.vectors("goal_location").astype(float),
            chunk.numbers("prime_time") - chunk.numbers("start_time"),
            np.full(len(chunk), -1),
            chunk.numbers("head_tilt_deg"),
            20.0,
        )
        parts.append((MotionBatch(chunk.joints, chunk.offsets), targets))
    ((motions, targets),) = parts
    assert run.run.record.method.name == "ground-truth"
    return motions, targets


def test_a_sweep_has_a_row_a_window_and_every_point_in_its_numbers(opened):
    made = sweep_table([sweep(opened[0], engine=InProcess())])
    assert [row.text["window"] for row in made.blocks[0].rows] == ["0 s", "0.25 s", "0.5 s", "0.75 s", "1 s", "1.25 s"]
    assert len(made.cells) == 6 * 41
    assert {value.origin for value in made.cells} == {"measured on synthetic data"}


def _copied(folder: Path, to: Path) -> Path:
    shutil.copytree(folder, to)
    return to


def test_a_run_with_edited_scores_is_not_drawn(runs, table, tmp_path):
    folder = _copied(runs["scripted"], tmp_path / "forged")
    scores = pq.read_table(folder / "synthetic-adt/scores.parquet")
    rows = scores.to_pylist()
    for row in rows:
        row["value"] = 1.0 if row["metric"] == "prime_success" else row["value"]
    pq.write_table(pa.Table.from_pylist(rows, schema=scores.schema), folder / "synthetic-adt/scores.parquet")
    with pytest.raises(PrbenchError):
        genuine_runs([folder], [table.folder], InProcess())


def test_a_run_without_motions_is_not_drawn(runs, table, tmp_path):
    folder = _copied(runs["scripted"], tmp_path / "bare")
    for part in (folder / "synthetic-adt/predictions").glob("*.parquet"):
        part.unlink()
    with pytest.raises(RunError, match="holds no motions"):
        genuine_runs([folder], [table.folder], InProcess())


def read_picture(path: Path) -> None:
    if path.suffix == ".png":
        assert path.read_bytes().startswith(PNG)
    else:
        assert ElementTree.parse(path).getroot().tag.endswith("svg")
    assert path.stat().st_size > 5000


@pytest.mark.parametrize("suffix", [".png", ".svg"])
def test_every_figure_is_made_by_its_command(suffix, runs, table, tmp_path, capsys):
    data = str(table.folder)
    folders = [str(path) for path in runs.values()]
    commands = {
        "figure-s2": [data],
        "figure-1": [data, "--limit", "2"],
        "figure-2": [data],
        "figure-4": [*folders, "--data", data, "--by", "action"],
        "figure-5": [folders[0], folders[1], "--data", data, "--limit", "1"],
        "figure-s3": [folders[0], "--data", data],
    }
    for name, words in commands.items():
        out = tmp_path / f"{name}{suffix}"
        assert main(["study", name, *words, "--out", str(out)]) == 0, name
        read_picture(out)
        assert f"written: {out}" in capsys.readouterr().out


def test_a_figure_of_another_kind_is_refused_first(runs, table, tmp_path, capsys):
    words = ["study", "figure-4", str(runs["scripted"]), "--data", str(table.folder), "--out", str(tmp_path / "f.gif")]
    assert main(words) == UsageError.exit_code
    assert "written as .png, .svg or .pdf" in capsys.readouterr().err


def test_numbers_of_a_figure_are_written_beside_it(runs, table, tmp_path):
    numbers = tmp_path / "f.csv"
    words = [str(runs["scripted"]), "--data", str(table.folder), "--out", str(tmp_path / "f.png")]
    assert main(["study", "figure-4", *words, "--by", "hand", "--numbers", str(numbers)]) == 0
    assert "hand: left" in numbers.read_text()


def test_names_are_drawn_letter_by_letter(tmp_path):
    cell = Cell(metric="prime_success", value=1.0, low=0.5, high=1.5)
    row = Row(text={"group": "<b>&", "counts": "3 (2) $"}, cells=(cell,))
    table = Table(title="$y", blocks=(Block(title="$\\frac$ \x1b[31m", rows=(row,)),))
    draw_breakdown(table, tmp_path / "f.svg")
    text = (tmp_path / "f.svg").read_text()
    assert "\x1b" not in text
    ElementTree.fromstring(text)


def test_tables_are_made_by_their_commands(runs, table, tmp_path, capsys):
    data = str(table.folder)
    folder = str(runs["scripted"].parent)
    for words in (
        ["table-1", data],
        ["table-s2", data],
        ["table-2", folder, "--data", data, "--with-published"],
        ["table-s3", folder, "--data", data],
        ["table-s1", folder, "--data", data],
    ):
        files = [tmp_path / f"{words[0]}{suffix}" for suffix in (".csv", ".tex", ".md")]
        assert main(["study", *words, "--json", "--out", *map(str, files)]) == 0
        report = json.loads(capsys.readouterr().out)["report"]
        assert report["tables"][0]["blocks"][0]["rows"][0]["cells"]
        assert all(path.stat().st_size for path in files)
        require_whole_latex(files[1].read_text())


def test_a_synthetic_run_that_claims_real_recordings_is_refused(runs, table, tmp_path, capsys):
    """The record of a run says which dataset it is of, and a forger may write what he likes there."""
    folder = _copied(runs["scripted"], tmp_path / "forged")
    (folder / "synthetic-adt").rename(folder / "adt")
    for name in ("run.json", "adt/summary.json"):
        text = (folder / name).read_text()
        text = text.replace('"synthetic-adt"', '"adt"').replace('"synthetic": true', '"synthetic": false')
        (folder / name).write_text(text.replace(" (synthetic)", ""))
    scores = pq.read_table(folder / "adt/scores.parquet")
    rows = [row | {"dataset": "adt"} for row in scores.to_pylist()]
    pq.write_table(pa.Table.from_pylist(rows, schema=scores.schema), folder / "adt/scores.parquet")
    words = ["study", "table-2", str(folder), "--data", str(table.folder), "--with-published"]
    assert main(words) != 0
    assert main(["leaderboard", "export", str(folder), "--data", str(table.folder)]) != 0
    assert "the run is of adt, not of synthetic-adt" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["table-1", "t", "--by", "hand"], "study table-1 takes no --by; its options: --out."),
        (["figure-4", "r"], "study figure-4: --out FILE is needed"),
        (["table-2"], "study table-2: name RUN..., which it is made from."),
        (["table-1", "--train"], "has nothing to train; --train goes with: table-3, table-4, table-s4"),
        (["table-3", "--train"], "expected --data DIR..."),
        (["table-3", "--train", "--with-published"], "study table-3 --train takes no --with-published"),
        (["table-3", "a", "b"], "name one DIR"),
        (["table-9"], "'table-9' is not one of"),
    ],
)
def test_what_an_item_does_not_take_is_refused(words, message, capsys):
    assert main(["study", *words]) == UsageError.exit_code
    assert message in capsys.readouterr().err
