"""Files of captions and of tokens: what is read, and what is said of damaged ones."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from prbench.errors import InputFileError
from prbench_benchmarks.captions.files import CaptionRow, TokensFile, read_captions, write_captions

ROW = {"motion_id": "a", "candidate": "C sits.", "references": ["C sits down.", "C takes a seat."]}


def captions_file(tmp_path, *rows):
    path = tmp_path / "method.jsonl"
    path.write_text("".join(row if isinstance(row, str) else json.dumps(row) + "\n" for row in rows), encoding="utf-8")
    return path


def tokens_file(path, *, codes="8", metadata=None, **changed):
    columns = {
        "motion_id": ["a", "b", "c"],
        "tokens": [[0, 7], [1], [2, 3, 4]],
        "text": [["C sits."], ["?", ""], ["C"]],
    }
    table = pa.table({name: values for name, values in (columns | changed).items() if values is not None})
    about = {"codes": codes, "dataset": "synthetic-x", "synthetic": "true"} if metadata is None else metadata
    pq.write_table(table.replace_schema_metadata(about), path)
    return path


def test_captions_are_read_as_they_were_written(tmp_path):
    rows = tuple(
        CaptionRow(motion_id=name, candidate="C sits.", references=("Ü sits.", "C\u2028sits"), cut=name == "a")
        for name in "ab"
    )
    write_captions(tmp_path / "x.jsonl", rows)
    assert read_captions(tmp_path / "x.jsonl") == rows


def test_an_empty_candidate_a_blank_line_and_further_fields_are_read(tmp_path):
    path = captions_file(tmp_path, ROW | {"candidate": "", "extra": 1}, "\n", ROW | {"motion_id": "b"})
    assert [row.candidate for row in read_captions(path)] == ["", "C sits."]


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([ROW, "{nonsense\n"], "line 2: expected an object with motion_id, candidate and references"),
        ([{"motion_id": "a", "candidate": "x"}], "line 1: expected .* missing required field `references`"),
        ([ROW | {"references": "C sits."}], "line 1: expected .* Expected `array`, got `str`"),
        ([ROW, ROW | {"motion_id": "b", "references": []}], "line 2, references: expected one text with letters"),
        ([ROW | {"references": ["C sits.", " ... "]}], "line 1, references: expected one text with letters"),
        ([ROW, ROW], "motion_id: expected every motion once, found 'a' again"),
        (["\n"], "expected at least one caption, found none"),
    ],
)
def test_a_damaged_file_of_captions_is_named_with_its_line(rows, message, tmp_path):
    with pytest.raises(InputFileError, match=message):
        read_captions(captions_file(tmp_path, *rows))


def test_tokens_of_motions_with_texts(tmp_path):
    read = TokensFile.read(tokens_file(tmp_path / "x.parquet", split=["train", "train", "test"]))
    assert (read.codes, read.left_out) == (8, 1)
    assert [(row.motion_id, row.tokens.tolist(), row.text, row.split) for row in read.rows] == [
        ("a", [0, 7], ("C sits.",), "train"),
        ("c", [2, 3, 4], ("C",), "test"),
    ]
    assert (read.info.dataset, read.info.synthetic, read.info.licence) == ("synthetic-x", True, "unknown")


def test_without_a_column_split_all_is_train(tmp_path):
    assert {row.split for row in TokensFile.read(tokens_file(tmp_path / "x.parquet")).rows} == {"train"}


def test_rows_in_several_chunks_keep_their_tokens(tmp_path):
    path = tokens_file(tmp_path / "x.parquet")
    table = pq.read_table(path)
    with pq.ParquetWriter(path, table.schema) as writer:
        for row in range(3):
            writer.write_table(table.slice(row, 1))
    assert [row.tokens.tolist() for row in TokensFile.read(path).rows] == [[0, 7], [2, 3, 4]]


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"text": None}, "expected a Parquet file with motion_id .*text"),
        ({"tokens": ["x", "y", "z"]}, "expected a Parquet file with motion_id"),
        ({"tokens": [[0.5], [1.0], [2.0]]}, "expected a Parquet file with motion_id"),
        ({"metadata": {}}, "metadata key 'codes': expected how many different tokens there are, 1 or more, found none"),
        ({"codes": "-3"}, "metadata key 'codes'"),
        ({"codes": "7"}, r"row 1, column 'tokens': expected one token or more, from 0 to 6, found \[0, 7\]"),
        ({"tokens": [[0], [-1], [2]]}, "row 2, column 'tokens'"),
        ({"tokens": [[0], [1], []]}, "row 3, column 'tokens'"),
        ({"tokens": [[0], None, [2]]}, "row 2, column 'tokens'"),
        ({"tokens": [[0], [1], [None]]}, r"row 3, column 'tokens': .* found \[-1\]"),
        ({"motion_id": ["a", "b", "a"]}, "column 'motion_id': expected every motion once, found 'a' again"),
        ({"motion_id": ["a", None, "c"]}, "column 'motion_id': expected a name in every row"),
        ({"split": ["train", "val", "test"]}, "column 'split': expected train, validation or test, found val"),
        ({"text": [[], ["..."], None]}, "column 'text': expected a text with letters, found none in 3 rows"),
    ],
)
def test_a_damaged_file_of_tokens_is_named_with_its_row(changed, message, tmp_path):
    with pytest.raises(InputFileError, match=message):
        TokensFile.read(tokens_file(tmp_path / "x.parquet", **changed))


@pytest.mark.parametrize("read", [read_captions, TokensFile.read])
def test_what_is_no_such_file_is_one_message(read, tmp_path):
    (tmp_path / "x.parquet").write_bytes(np.arange(9).tobytes())
    for path in (tmp_path / "x.parquet", tmp_path, tmp_path / "none"):
        with pytest.raises(InputFileError):
            read(path)
