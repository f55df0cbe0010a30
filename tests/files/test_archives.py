"""Archives of strangers are taken only where every member is a plain file inside of them, of an honest size."""

from __future__ import annotations

import stat
import struct
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from prbench.errors import InputFileError
from prbench.files.archives import open_archive, write_archive
from prbench.limits import MOST_MEMBERS
from tests.bombs import MEGABYTE, declaring, encrypted, zipped

NAME = "runs/a/run.json"


def entry(name: str = NAME, *, mode: int = 0, **fields: object) -> zipfile.ZipInfo:
    made = zipfile.ZipInfo(name)
    made.external_attr = mode << 16
    for key, value in fields.items():
        setattr(made, key, value)
    return made


def members(*entries: zipfile.ZipInfo | str, content: bytes = b"{}") -> Callable[[Path], Path]:
    """Write an archive of these members."""

    def make(path: Path) -> Path:
        with zipfile.ZipFile(path, "w") as archive:
            for each in entries:
                archive.writestr(each, content)
        return path

    return make


def named(raw: bytes, flag: int = 0) -> Callable[[Path], Path]:
    """Write an archive of one member whose name has these bytes."""

    def make(path: Path) -> Path:
        members("x" * len(raw))(path)
        content = bytearray(path.read_bytes().replace(b"x" * len(raw), raw))
        content[content.find(b"PK\x03\x04") + 7] |= flag >> 8
        content[content.find(b"PK\x01\x02") + 9] |= flag >> 8
        path.write_bytes(content)
        return path

    return make


def edited(change: Callable[[bytearray], Any], *names: str) -> Callable[[Path], Path]:
    """Write an archive and change its bytes."""

    def make(path: Path) -> Path:
        content = bytearray(members(*names or (NAME, "runs/a/b.json"))(path).read_bytes())
        path.write_bytes(bytes(change(content) or content))
        return path

    return make


def end(content: bytearray, offset: int, form: str, value: int) -> None:
    struct.pack_into(form, content, len(content) - 22 + offset, value)


def overlapping(content: bytearray) -> None:
    """The second member is said to lie where the first one does."""
    second = content.find(b"PK\x01\x02", content.find(b"PK\x01\x02") + 1)
    struct.pack_into("<L", content, second + 42, 0)


def nested(path: Path) -> Path:
    """The second member lies inside the first one, and as many bytes lie idle behind it, so that the sums are right."""
    one = members("b")(path).read_bytes()
    inner, listed, _ = one[: one.find(b"PK\x01\x02")], one[one.find(b"PK\x01\x02") : -22], one[-22:]
    outer = members("a", content=inner)(path).read_bytes()
    start = outer.find(b"PK\x01\x02")
    listed = listed[:42] + struct.pack("<L", 31) + listed[46:]  # behind the header of the first
    table = outer[start:-22] + listed
    behind = struct.pack("<4s4H2LH", b"PK\x05\x06", 0, 0, 2, 2, len(table), start + len(inner), 0)
    path.write_bytes(outer[:start] + bytes(len(inner)) + table + behind)
    assert zipfile.ZipFile(path).read("b") == b"{}"
    return path


def million(path: Path, *, told: int) -> Path:
    """A table of contents of a million members, of which the end of the archive tells so many."""
    one = struct.pack("<4s6H3L5H2L", b"PK\x01\x02", 20, 20, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0) + b"a"
    path.write_bytes(one * 10**6 + struct.pack("<4s4H2LH", b"PK\x05\x06", 0, 0, told, told, len(one) * 10**6, 0, 0))
    return path


def many_bombs(path: Path) -> Path:
    """Every member is harmless by itself, and all of them together fill a disk."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for number in range(4):
            archive.writestr(f"{number}.json", bytes(30 * MEGABYTE))
    return path


OUT = "member inside the archive's folder"
HIDDEN = "members behind one another|overlapping"
LINK = stat.S_IFLNK | 0o777
HOSTILE = {
    "up": (members("../run.json"), OUT),
    "up from below": (members("runs/../../run.json"), OUT),
    "absolute": (members("/etc/passwd"), OUT),
    "drive letter": (members("C:/run.json"), OUT),
    "backslash": (members("runs\\..\\run.json"), OUT),
    "another stream": (members("run.json:hidden"), OUT),
    "link": (members(entry(mode=LINK)), "a link"),
    "device": (members(entry(mode=stat.S_IFBLK | 0o600)), "a device"),
    "pipe": (members(entry(mode=stat.S_IFIFO | 0o600)), "expected a plain file"),
    "folder": (members("runs/"), "found a folder"),
    "folder of MS-DOS": (members(entry(external_attr=16)), "found a folder"),
    "control character": (members("runs/a\x1b[31m.json"), "every system can store"),
    "line break": (members("runs/a\n.json"), "every system can store"),
    "name with a zero": (named(b"run.json\0.exe"), "every system can store"),
    "not UTF-8": (named(b"run\xff\xfe.json", flag=0x800), "a whole ZIP archive"),
    "bytes of another code": (named(b"run\xff\xfe.json"), "every system can store"),
    "turned writing": (members("runs/\u202enosj.exe"), "every system can store"),
    "device of Windows": (members("runs/NUL.json"), "every system can store"),
    "option": (members("-rf"), "every system can store"),
    "hidden": (members("runs/.git"), "every system can store"),
    "dot at the end": (members("runs/a."), "every system can store"),
    "very long": (members("a" * 300), "every system can store"),
    "other letters": (members("runs/a.json", "runs/A.json"), "each member once"),
    "file and folder": (members("runs/a", "runs/a/b"), "each member once"),
    "folder and file": (members("runs/a/b", "runs/a"), "each member once"),
    "repeated": (members(NAME, NAME), "each member once"),
    "encrypted": (lambda path: encrypted(members(NAME)(path)), "encrypted"),
    "extra field": (members(entry(extra=struct.pack("<HHQ", 1, 8, 5))), "without extra fields|a whole ZIP"),
    "comment of a member": (members(entry(comment=b"hello")), "without extra fields"),
    "declared bomb": (lambda path: declaring(zipped(path, NAME, b"{}"), 3 * 2**30), "3,221,225,472 declared"),
    "real bomb": (lambda path: zipped(path, NAME, bytes(80 * MEGABYTE)), "83,886,080 declared"),
    "many bombs": (many_bombs, "bytes unpacked, found 125,829,120 declared"),
    "stored, more declared": (lambda path: declaring(members(NAME)(path), 1000), "2 bytes, as are stored"),
    "other packing": (lambda path: zipped(path, NAME, b"{}", kind=zipfile.ZIP_LZMA), "stored or deflated|extra fields"),
    "a million": (lambda path: million(path, told=0xFFFF), "ZIP64, which is for more"),
    "a million, fewer told": (lambda path: million(path, told=MOST_MEMBERS), "1,000,000 listed"),
    "a million, one told": (lambda path: million(path, told=1), "47,000,000 bytes"),
    "too many": (lambda path: million(path, told=MOST_MEMBERS + 1), "at most 50,000 members"),
    "more told": (edited(lambda content: end(content, 8, "<H", 3) or end(content, 10, "<H", 3)), "expected 3 members"),
    "trailing bytes": (edited(lambda content: content + b"hidden"), "bytes behind its end"),
    "comment": (edited(lambda content: end(content, 20, "<H", 1) or content + b"x"), "a ZIP archive"),
    "leading bytes": (edited(lambda content: b"hidden" + content), "missing or hidden"),
    "cut": (edited(lambda content: content[:-30]), "a ZIP archive"),
    "cut in front": (edited(lambda content: content[30:]), "missing or hidden"),
    "overlapping": (edited(overlapping), HIDDEN),
    "one inside another": (nested, HIDDEN),
    "another name inside": (edited(lambda content: content.replace(b"runs/a/b", b"runs/a/c", 1)), HIDDEN),
    "second disk": (edited(lambda content: end(content, 4, "<H", 1)), "missing or hidden"),
    "empty": (lambda path: (path.write_bytes(b"") and path) or path, "a ZIP archive"),
    "text": (lambda path: (path.write_text("hello" * 20) and path) or path, "a ZIP archive"),
    "a folder itself": (lambda path: path.mkdir() or path, "a folder"),
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_archive_is_refused_before_anything_is_unpacked(tmp_path, name):
    make, message = HOSTILE[name]
    path = make(tmp_path / "a.zip")
    started = time.monotonic()
    with pytest.raises(InputFileError, match=message), open_archive(path):
        pytest.fail("it was opened")
    assert time.monotonic() - started < 2


@pytest.mark.parametrize("damage", [lambda content: content[40] ^ 1, lambda content: 0])
def test_damaged_bytes_of_a_member_are_told(tmp_path, damage):
    path = edited(lambda content: content.__setitem__(46, damage(content)))(tmp_path / "a.zip")
    with pytest.raises(InputFileError, match="a whole ZIP archive, found Bad CRC-32"), open_archive(path) as archive:
        archive.read(NAME)


def test_a_member_never_yields_more_than_it_declares(tmp_path):
    path = declaring(zipped(tmp_path / "a.zip", NAME, b"1234567890" * 1000), 10)
    content = bytearray(path.read_bytes())
    struct.pack_into("<L", content, 22, 10)  # in both places, so that nothing but the packed bytes tells
    path.write_bytes(content)
    with pytest.raises(InputFileError, match="Bad CRC-32"), open_archive(path) as archive:
        archive.read(NAME)


def test_equal_files_give_equal_bytes_and_come_back(tmp_path):
    (tmp_path / "run.json").write_bytes(b"{}")
    contents = {"submission.json": b"[1]", NAME: tmp_path / "run.json"}
    for name in ("a.zip", "b.zip"):
        write_archive(tmp_path / name, contents)
        (tmp_path / "run.json").touch()
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()
    with open_archive(tmp_path / "a.zip") as archive:
        assert archive.namelist() == list(contents)
        assert archive.read(NAME) == b"{}"


def test_a_name_that_would_be_refused_is_not_written(tmp_path):
    with pytest.raises(InputFileError, match="every system can store"):
        write_archive(tmp_path / "a.zip", {"läufe/run.json": b""})
    assert list(tmp_path.iterdir()) == []
