"""Files are refused by their size, and whatever goes wrong while one is read becomes one message that names it."""

from __future__ import annotations

import inspect
import os
import pickle
import zipfile
from enum import StrEnum
from pathlib import Path
from typing import Any, Literal

import msgspec
import pytest

from prbench import limits
from prbench.datasets import readable_datasets
from prbench.errors import InputFileError, PrbenchError, TableError, UnforeseenInput
from prbench.files.arrays import Archive, open_parquet
from prbench.files.bounded import (
    allowed_values,
    foreign_input,
    open_regular,
    read_text,
    read_whole,
    require_unpackable,
    structured,
    whole_lines,
)
from prbench.files.storage import file_digest
from prbench.limits import HARMLESS_SIZE, HIGHEST_COMPRESSION, LONGEST_LINE, LONGEST_MESSAGE
from prbench.readers import files, reader_for
from prbench.readers.files import archive_members, decode_json, read_all, read_columns, require_whole_last_line
from prbench.readers.found import InputFile
from tests.bombs import MEGABYTE, declaring, encrypted, zipped


def require_whole_last_line_of(path):
    require_whole_last_line(path, ["x"], ["x"])


def test_a_file_larger_than_any_of_its_kind_is_refused_unread(tmp_path):
    path = tmp_path / "endless.json"
    with open(path, "wb") as file:
        file.truncate(2**42)  # takes no space
    for read in (read_whole, read_text, read_all, file_digest, open_regular, archive_members):
        with pytest.raises(InputFileError, match=r"endless\.json: expected at most .* bytes, found 4,398,046,511,104"):
            read(path)
    with pytest.raises(InputFileError, match=r"endless\.json: expected at most"):
        decode_json(path, Any)


@pytest.mark.skipif(not Path("/proc/self/stat").is_file(), reason="there are no such files here")
@pytest.mark.parametrize("target", ["/dev/zero", "/dev/tty", "/proc/self/stat", "/proc/kmsg"])
@pytest.mark.parametrize("read", [read_whole, read_text, open_regular, file_digest, Archive.load, open_parquet])
def test_a_link_to_what_may_never_end_is_refused(target, read, tmp_path):
    path = tmp_path / "metadata.json"
    path.symlink_to(target)
    with pytest.raises(InputFileError, match=r"expected a file, found a (pipe or a device|file of the operating)"):
        Archive(path).load(["x"]) if read == Archive.load else read(path)


def test_links_to_files_are_read_and_empty_files_too(tmp_path):
    (tmp_path / "own").write_bytes(b"own")
    (tmp_path / "link").symlink_to(tmp_path / "own")
    (tmp_path / "nothing").write_bytes(b"")
    assert [read_whole(tmp_path / name) for name in ("link", "nothing")] == [b"own", b""]


class Exchanged(type(Path())):
    """The path of what was a file when it was looked at."""

    def stat(self, **_):
        return Path(__file__).stat()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes with names here")
def test_a_pipe_put_there_after_the_look_is_not_waited_for_either(tmp_path):
    os.mkfifo(tmp_path / "metadata.json")
    with pytest.raises(InputFileError, match="found a pipe"):
        read_whole(Exchanged(tmp_path / "metadata.json"))


@pytest.mark.parametrize("look", [read_whole, open_regular, file_digest, require_whole_last_line_of])
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes with names here")
def test_what_is_read_in_pieces_is_no_pipe_either(look, tmp_path):
    os.mkfifo(tmp_path / "0000000000.npy")
    with pytest.raises(PrbenchError, match="found a pipe"):
        look(tmp_path / "0000000000.npy")


def test_a_line_longer_than_any_is_named(tmp_path):
    path = tmp_path / "lines.jsonl"
    path.write_bytes(b"{}\n" + b"x" * (LONGEST_LINE + 1))
    with open(path, "rb") as file, pytest.raises(InputFileError, match="line 2: expected lines of at most"):
        list(whole_lines(file, path))


@pytest.mark.parametrize(
    ("packed", "unpacked", "refused"),
    [
        (1, HARMLESS_SIZE, False),
        (1, HARMLESS_SIZE + 1, True),
        (MEGABYTE, HIGHEST_COMPRESSION * MEGABYTE, False),
        (MEGABYTE, HIGHEST_COMPRESSION * MEGABYTE + 1, True),
        (2**40, limits.LARGEST_UNPACKED + 1, True),
    ],
)
def test_an_archive_may_declare_so_much_and_no_more(packed, unpacked, refused):
    member = zipfile.ZipInfo("a.csv")
    member.compress_size, member.file_size = packed, unpacked
    if not refused:
        require_unpackable(Path("a.zip"), member)
        return
    with pytest.raises(InputFileError, match=rf"a\.zip: expected at most .*, found {unpacked:,} declared"):
        require_unpackable(Path("a.zip"), member)


def test_a_slam_file_of_one_endless_line_leaves_a_short_message(tmp_path):
    archive = zipped(tmp_path / "slam.zip", "slam/t.csv", b"a" * (40 * MEGABYTE))
    with pytest.raises(InputFileError, match=r"t\.csv, header: expected lines of at most") as caught:
        read_columns(InputFile("", archive, 0, "slam/t.csv"), {"x": float})
    assert len(str(caught.value)) < 1000


def test_an_archive_that_declares_less_than_it_holds_gives_no_more_than_it_declares(tmp_path):
    archive = declaring(zipped(tmp_path / "a.zip", "a.json", bytes(20 * MEGABYTE)), 1000)
    with pytest.raises(InputFileError, match="Bad CRC-32"):
        read_all(InputFile("", archive, 0, "a.json"))


def test_compression_that_cannot_be_stopped_half_way_is_refused(tmp_path):
    archive = zipped(tmp_path / "a.zip", "a.json", b"{}", kind=zipfile.ZIP_BZIP2)
    with pytest.raises(InputFileError, match=r"a\.json: expected a member stored or deflated"):
        read_all(InputFile("", archive, 0, "a.json"))


def test_an_encrypted_archive_is_refused(tmp_path):
    archive = encrypted(zipped(tmp_path / "a.zip", "a.json", b"{}"))
    with pytest.raises(InputFileError, match=r"a\.json: expected a file that can be unpacked, found .*encrypted"):
        read_all(InputFile("", archive, 0, "a.json"))


def test_columns_that_outgrow_any_table_are_refused_while_they_are_read(tmp_path, monkeypatch):
    monkeypatch.setattr("prbench.limits.LARGEST_TABLE", MEGABYTE)
    archive = zipped(tmp_path / "a.zip", "a.csv", b"x,y\n" + b",\n" * 200_000)
    with pytest.raises(InputFileError, match=r"a\.csv: expected columns of at most 1,048,576 bytes, found more"):
        read_columns(InputFile("", archive, 0, "a.csv"), {"x": float, "y": float})


def test_long_plain_tables_are_read_in_pieces_with_the_same_result(tmp_path, monkeypatch):
    path = tmp_path / "a.csv"
    path.write_text("n,x\n" + "".join(f"{row},{row / 7}\n" for row in range(100_000)))
    whole = read_columns(path, {"x": float, "n": int})
    monkeypatch.setattr(files, "_WATCHED_SIZE", 0)
    assert read_columns(path, {"x": float, "n": int}).equals(whole)


def test_no_message_grows_with_what_a_file_holds():
    assert len(str(TableError("x" * 10**6))) < LONGEST_MESSAGE + 100


def test_an_unforeseen_error_names_the_file_its_kind_and_its_cause(tmp_path, monkeypatch):
    def stumble(_: Path, **_limits: int) -> bytes:
        raise TypeError("no number")

    monkeypatch.setattr(files, "read_all", stumble)
    with pytest.raises(UnforeseenInput, match=r"numbers\.json: .*TypeError: no number") as caught:
        decode_json(tmp_path / "numbers.json", Any)
    assert caught.value.path == tmp_path / "numbers.json"
    assert isinstance(caught.value.__cause__, TypeError)


def test_an_unforeseen_error_is_the_same_in_another_process():
    error = UnforeseenInput("a.csv", "line 2", expected="a number", found="KeyError: 'x'", remedy="Copy it again.")
    copy = pickle.loads(pickle.dumps(error))
    assert type(copy) is UnforeseenInput
    assert (str(copy), copy.path, copy.where) == (str(error), error.path, error.where)


@pytest.mark.parametrize("make", [Path.mkdir, lambda path: path.symlink_to(path)], ids=["folder", "looping link"])
def test_what_is_no_file_is_refused_with_what_the_system_says(tmp_path, make):
    path = tmp_path / "metadata.json"
    make(path)
    with pytest.raises(InputFileError, match=r"metadata\.json: expected a file.*, found") as caught:
        decode_json(path, Any)
    assert type(caught.value) is InputFileError


def test_json_nested_too_deep_is_refused(tmp_path):
    path = tmp_path / "deep.json"
    path.write_bytes(b"[" * 100_000 + b"]" * 100_000)
    with pytest.raises(InputFileError, match=r"deep\.json: expected values nested at most") as caught:
        decode_json(path, Any)
    assert type(caught.value) is InputFileError


def test_bytes_that_are_no_text_are_refused_and_not_unforeseen():
    said = "input: expected text in UTF-8, found other bytes"
    with pytest.raises(InputFileError, match=said) as caught, foreign_input():
        b"\xff".decode()
    assert type(caught.value) is InputFileError


@pytest.mark.parametrize("error", [TableError("a message"), MemoryError()], ids=["a user's error", "no memory"])
def test_errors_that_are_told_already_and_a_lack_of_memory_pass(error):
    with pytest.raises(type(error)) as caught, foreign_input():
        raise error
    assert caught.value is error


def test_where_no_path_is_known_the_place_given_is_named():
    with pytest.raises(UnforeseenInput, match="a stream: "), foreign_input("a stream"):
        raise KeyError("x")


@pytest.mark.parametrize("dataset", readable_datasets())
def test_every_reader_stands_behind_the_boundary(dataset):
    reader = reader_for(dataset)
    for door in (reader.find, reader.read):
        assert inspect.unwrap(door) is not door, f"put @foreign_input() over {door.__qualname__}"


class Unit(StrEnum):
    METRE = "m"
    INCH = "in"


class Colours(msgspec.Struct, forbid_unknown_fields=True):
    ink: Literal["black", "blue"] = "black"
    paper: Literal["white", "grey"] | None = None
    pens: tuple[Literal["thin", "broad"], ...] = ()
    width: int = 1
    unit: Unit = Unit.METRE


class Drawing(msgspec.Struct, forbid_unknown_fields=True):
    colours: Colours | None = None
    layers: dict[str, Colours] = {}


@pytest.mark.parametrize(
    ("colours", "known"),
    [
        ({"ink": "red"}, "black, blue"),
        ({"ink": 3}, "black, blue"),
        ({"paper": "red"}, "white, grey"),
        ({"pens": ["thin", "flat"]}, "thin, broad"),
        ({"unit": "ft"}, "m, in"),
        ({"width": "wide"}, ""),
        ({"inks": "black"}, ""),
    ],
)
def test_a_value_that_is_none_of_a_list_is_answered_with_the_list(colours, known):
    for drawing in ({"colours": colours}, {"layers": {"first": colours}}):
        with pytest.raises(msgspec.ValidationError) as refused:
            msgspec.convert(drawing, Drawing)
        assert allowed_values(refused.value, Drawing) == (known and f" It is one of: {known}.")
        with pytest.raises(InputFileError, match=f"what is known here: {known}, found" if known else "expected"):
            structured(Path("drawing.toml"), drawing, Drawing)
