"""Tables 1, 2, S1, S2, S3 and S8 on small tables and made-up runs."""

from __future__ import annotations

import csv
import io
import json

import msgspec
import pytest

from prbench.cli import main
from prbench.entry_points import STUDY_ITEMS, load_built_in
from prbench.errors import UsageError
from prbench.protocol.published import load_published, load_table_one
from prbench.sequences import SequenceTable
from prbench.sequences.dataset_info import FILE_NAME
from prbench.tables import FORMATS, grid
from prbench_benchmarks.prime_and_reach.study.methods import methods_table, poses_table
from prbench_benchmarks.prime_and_reach.study.sizes import table_one, table_s2
from prbench_benchmarks.text_to_motion.metrics import Repeated
from prbench_benchmarks.text_to_motion.report import ResultRow, TextEvaluation, table_s8
from tests.benchmarks.prime_and_reach.study.test_beside import board_of, write_real
from tests.board.runs import metrics, write_run
from tests.fakes import fake_dataset
from tests.tables.test_tables import require_whole_latex


@pytest.fixture(scope="module")
def synthetic(tmp_path_factory) -> SequenceTable:
    return fake_dataset(tmp_path_factory.mktemp("study") / "synthetic", n=24)


@pytest.fixture(scope="module")
def real(tmp_path_factory) -> SequenceTable:
    """A table that says it is of real recordings."""
    folder = tmp_path_factory.mktemp("study") / "real"
    fake_dataset(folder, n=24, dataset="mogaze")
    info = json.loads((folder / FILE_NAME).read_text())
    (folder / FILE_NAME).write_text(json.dumps(info | {"synthetic": False}))
    return SequenceTable.open(folder)


def printed(table, block: int) -> list[list[str]]:
    """Cells of a block as the terminal shows them."""
    return grid(table, table.blocks[block], escape=str, bold=str)


def test_measured_synthetic_and_published_rows_never_share_a_block(synthetic, real):
    table = table_one([synthetic, real])
    titles = [block.title for block in table.blocks]
    assert titles[0] == "Measured on recordings of people"
    assert titles[1].startswith("Measured on synthetic data")
    assert titles[2] == "Published: Prime and Reach, Table 1 (section 3.2)"
    assert [[row.text["dataset"] for row in block.rows] for block in table.blocks] == [
        ["mogaze"],
        ["synthetic-adt"],
        ["mogaze", "adt"],
    ]
    assert {value.origin for value in table.cells if value.dataset == "synthetic-adt"} == {"measured on synthetic data"}


def test_table_1_prints_the_study_s_numbers_as_the_study_does(synthetic):
    published = printed(table_one([synthetic]), -1)[0]
    assert published == ["adt", "", "411", "7.44 ± 2.47", "4.51 ± 2.74", "1.23 ± 1.28", "0.56 ± 0.24"]


def test_table_s2_counts_sequences_and_recordings_of_each_split(synthetic):
    table = table_s2([synthetic])
    splits = synthetic.scalars()["split"].to_pylist()
    name, train, validation, test, total = printed(table, 0)[0]
    assert name == "synthetic-adt"
    assert train == f"{splits.count('train')} (6)"
    assert (validation.split()[0], test.split()[0]) == (str(splits.count("validation")), str(splits.count("test")))
    assert total == "24 (12)"
    assert printed(table, 1) == [["adt", "326", "–", "85", "411"]]


def block(table, beginning):
    """Printed cells of the block whose title begins so."""
    return printed(table, [each.title.startswith(beginning) for each in table.blocks].index(True))


def test_runs_stand_in_the_study_s_places_and_others_beside(tmp_path):
    write_real(tmp_path / "a", "pr")
    write_real(tmp_path / "b", "dno", weights="dno-pretrained")
    write_run(
        tmp_path / "c", "ground-truth", about={"kind": "control"}, datasets=("adt",), sequences=85,
        table={"synthetic": False}, summary={"synthetic": False, "title": "Aria Digital Twin"},
    )  # fmt: skip
    (table,) = methods_table(board_of(tmp_path), "2", with_published=True)
    assert [row[1] for row in block(table, "Measured; condition, method and weights as declared")] == ["DNO †", "P&R"]
    assert [row[0] for row in block(table, "Beside")] == ["control"]
    assert len(block(table, "Published")) == 18
    assert block(table, "Published")[-1][:3] == ["+ Initial State & Object Loc.", "P&R", "52.08"]
    assert len(block(table, "Measured minus published")) == 2
    assert any(value.origin.startswith("measured - published") for value in table.cells)
    assert any("the study names no frame rate" in note.lower() for note in table.notes)


@pytest.mark.parametrize("suffix", [".md", ".tex", ".csv"])
def test_every_format_says_what_cannot_be_decided_and_what_could_be_found(suffix, tmp_path):
    known = tuple(msgspec.structs.replace(entry, detectable=0.27) for entry in metrics())
    write_run(
        tmp_path / "a", "pr", about={"kind": "built-in"}, record={"condition": "goal-loc"}, summary={"metrics": known}
    )
    other = {"datasets": ("synthetic-gimo",), "summary": {"recordings": 3}}
    write_run(tmp_path / "b", "pr", about={"kind": "built-in"}, record={"condition": "goal-loc"}, **other)
    text = FORMATS[suffix](methods_table(board_of(tmp_path), "2", with_published=False))
    if suffix == ".csv":
        rows = list(csv.DictReader(io.StringIO(text)))
        assert {row["detectable"] for row in rows if row["metric"] == "prime_success"} >= {"27"}
        return
    assert "synthetic-gimo cannot be decided: 3 recordings" in text
    assert "Prime Success 27 points" in text


def test_a_synthetic_table_has_no_difference_and_says_so(tmp_path):
    write_run(tmp_path / "a", "pr", about={"kind": "built-in"}, record={"condition": "goal-loc"})
    (table,) = methods_table(board_of(tmp_path), "2", with_published=True)
    titles = [each.title for each in table.blocks]
    assert not any(title.startswith("Measured minus") for title in titles)
    assert "not comparable with the synthetic ones above" in titles[-1]
    assert "Measured on synthetic data: not comparable" in titles[0] or "Beside" in titles[0]


def test_table_s3_has_its_own_published_rows(tmp_path):
    write_real(tmp_path / "a", weights="pr-goal-loc-adt")
    (table,) = methods_table(board_of(tmp_path), "S3", with_published=True)
    assert [row[1] for row in block(table, "Measured")] == ["P&R"]
    prime = next(
        number.printed
        for number in load_published("S3")
        if (number.dataset, number.method, number.condition, number.metric)
        == ("adt", "pr", "goal-loc", "prime_success")
    )
    assert block(table, "Published")[-1][2] == prime == "43.53"


def test_a_foreign_method_never_takes_a_row_of_the_study(tmp_path):
    write_real(tmp_path / "a", about={"kind": "package", "name": "mine"})
    (table,) = methods_table(board_of(tmp_path), "2", with_published=False)
    assert [each.title[:6] for each in table.blocks] == ["Beside"]


def test_table_s1_tells_training_and_test_poses_apart(tmp_path):
    write_real(tmp_path / "a", weights="pr-goal-loc-egoallo")
    write_real(tmp_path / "b", weights="pr-goal-loc-mocap")
    (table,) = poses_table(board_of(tmp_path), lambda _: ["egoallo"], with_published=True)
    assert table.part == "adt, tested on EgoAllo poses"
    assert [row[1] for row in block(table, "Measured")] == [
        "pr, trained on EgoAllo poses",
        "pr, trained on mocap poses",
    ]
    assert len(block(table, "Published")) == 4
    assert all(value.variant.endswith("tested on EgoAllo poses") for value in table.cells)


def evaluation(**more) -> TextEvaluation:
    interval = Repeated(mean=0.7, half_width=0.01, values=(0.69, 0.71))
    row = ResultRow(
        source="mdm", metrics={"r_precision_top_3": interval, "fid": interval}, motions=64, ranked_pairs=64,
        dropped_pairs=0, duplicate_captions=0.0, repetitions=2,
    )  # fmt: skip
    settings = {"dataset": "nymeria", "split": "test", "rows": (row,), **more}
    return TextEvaluation(
        vectorisation="hashed", evaluator_sha256="ab" * 32, representation="humanml3d-263", corpus_content_digest="0",
        kinds=("motion",), clips=64, left_out=0, distinct_captions=60, seed=0, diversity_pairs=300,
        prbench_version="0", notes=(), **settings,
    )  # fmt: skip


def test_table_s8_is_read_from_evaluations_and_says_that_nothing_was_recomputed(tmp_path):
    path = tmp_path / "e.json"
    path.write_bytes(msgspec.json.encode(evaluation()))
    table = table_s8([path], with_published=True)
    assert printed(table, 0) == [["mdm", "70.00 [69.00, 71.00]", "0.70 [0.69, 0.71]", "–", "–"]]
    assert printed(table, 1)[0] == ["recorded motion", "75.43 ± 0.12", "0", "2.79 ± 0.00", "9.70 ± 0.13"]
    assert any("motions are not at hand" in note for note in table.notes)
    require_whole_latex(FORMATS[".tex"]([table]))


def test_the_command_finds_the_tables_that_stand_with_their_benchmark(tmp_path, capsys):
    path = tmp_path / "e.json"
    path.write_bytes(msgspec.json.encode(evaluation()))
    assert main(["study", "table-s8", str(path)]) == 0
    assert "70.00 [69.00, 71.00]" in capsys.readouterr().out
    with pytest.raises(UsageError, match="nothing named 'table-99'"):
        load_built_in(STUDY_ITEMS, "table-99")


def test_the_number_of_test_sequences_of_the_study_stands_in_the_csv_rows(tmp_path):
    write_real(tmp_path / "a")
    (table,) = methods_table(board_of(tmp_path), "2", with_published=True)
    published = [value for value in table.cells if value.origin.startswith("published")]
    assert {value.sequences for value in published} == {load_table_one()["adt"].test}
