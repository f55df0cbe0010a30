"""Scores with numbers in place of texts: the same rows in less memory."""

from __future__ import annotations

import pyarrow as pa
import pytest

from prbench.errors import RunError
from prbench.harness.run_folder.scores import SCORES, CodedScores, read_scores, write_scores


def scores(sequences: int = 3, samples: int = 2) -> pa.Table:
    rows = [
        {
            "sequence_id": f"d/r{number:06d}/o/pick/1/fake",
            "dataset": "d",
            "sample": sample,
            "metric": metric,
            "value": number + sample / 10,
            "flag": "one;two" if number == 1 else None,
        }
        for number in range(sequences)
        for sample in range(samples)
        for metric in ("mpjpe", "reach_success")
    ]
    return pa.Table.from_pylist(rows, schema=SCORES)


def test_rows_come_back_as_they_were_however_they_are_cut():
    table = scores()
    assert CodedScores.of([table]).long_form().equals(table)
    assert CodedScores.of([table.slice(0, 5), table.slice(5)]).long_form().equals(table)
    assert CodedScores.of([]).long_form().equals(SCORES.empty_table())


def test_rows_of_a_metric_and_of_some_sequences():
    coded = CodedScores.of([scores()])
    assert coded.value[coded.rows_of("mpjpe")].tolist() == [0.0, 0.1, 1.0, 1.1, 2.0, 2.1]
    assert not coded.rows_of("foot_skating").size
    kept = coded.only([name for name in coded.sequence_ids if "r000001" not in name])
    assert len(kept.sequence_ids) == 2
    expected = [row for row in scores().to_pylist() if "r000001" not in row["sequence_id"]]
    assert kept.long_form().to_pylist() == expected


def test_a_file_is_read_as_it_was_written_and_codes_leave_no_trace(tmp_path):
    table = scores(2000)
    write_scores(tmp_path / "whole.parquet", [table])
    CodedScores.of([table]).write(tmp_path / "coded.parquet")
    assert (tmp_path / "coded.parquet").read_bytes() == (tmp_path / "whole.parquet").read_bytes()
    assert CodedScores.read(tmp_path / "whole.parquet").long_form().equals(read_scores(tmp_path / "whole.parquet"))


@pytest.mark.parametrize("read", [CodedScores.read, read_scores])
def test_two_values_of_one_motion_are_refused(tmp_path, read):
    table = scores()
    write_scores(tmp_path / "scores.parquet", [table, table.slice(3, 1)])
    with pytest.raises(RunError, match="d/r000000/o/pick/1/fake, sample 1, reach_success"):
        read(tmp_path / "scores.parquet")


def test_rows_in_any_order_repeat_nothing_and_a_repeated_one_is_found(tmp_path):
    table = scores()
    backwards = table.take(list(range(table.num_rows))[::-1])
    write_scores(tmp_path / "backwards.parquet", [backwards])
    assert CodedScores.read(tmp_path / "backwards.parquet").long_form().equals(backwards)
    write_scores(tmp_path / "twice.parquet", [backwards, table.slice(7, 1)])
    with pytest.raises(RunError, match=r"r000001.*sample 1, reach_success"):
        CodedScores.read(tmp_path / "twice.parquet")
