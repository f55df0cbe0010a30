"""Damages one file of a folder at random: what disks, downloads, editors, scripts and malice do to files."""

from __future__ import annotations

import os
import re
import shutil
import socket
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Literal

from tests.fuzz.array_files import other_content

NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?")
IMPOSSIBLE = (
    b"nan",
    b"NaN",
    b"inf",
    b"-Infinity",
    b"1e300",
    b"9e29",
    b"1e999",
    b"-1e18",
    b"",
    b"abc",
    b"0x1F",
    b"null",
    b"0,5",  # as half of Europe writes it
    b"1.234,5",
    b"1_000",
    "\u0663".encode(),  # an Arabic three
    b"2024-02-30",
    b"3-Jan",
    b"12:30:00.5",
    b"1e5000",
    b"--5",
    b"0 0",
)
POSSIBLE = (
    b"0", b"-1", b"1", b"0.5", b"9223372036854775807", b"18446744073709551616", b"1" * 40, b"-0.0", b"1e-320", b"-7",
    b"+5", b"5.", b".5", b"1e-5000", b"4294967296", b"1E3",
)  # fmt: skip
_SHORTER_IS_ANOTHER = ("*.obj", "motion_narration.csv", "atomic_action.csv")
"""Files of which nothing says how long they should be: meshes with fewer triangles, texts of fewer minutes."""
_ONE_OF_SEVERAL = "[0-9]*_*-*.npz"
"""Outputs of EgoAllo, which stops where it likes: the last may be absent (docs/datasets.md#files-that-end-early)."""
_WINDOW = 4096
_DEEP = 100_000


@dataclass(frozen=True)
class Mutation:
    """One damage that was done."""

    path: Path
    kind: str
    detail: str
    harm: Literal["shorter", "replaced", "other"]
    """What became of the file: a part of it, nothing or something that is no file, or other bytes. A digit that became
    another digit cannot be seen; of the first two a result has to tell."""

    def __str__(self) -> str:
        return f"{self.kind} {self.path.name} {self.detail}"


class Undo:
    """Keeps one file while it is damaged, and puts it and its folder back."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.content = path.read_bytes()
        self._beside = set(path.parent.iterdir())

    def restore(self) -> None:
        """Put the file back as it was, and remove what came beside it."""
        aside = _aside(self.path.parent)
        if aside.is_dir():
            self.path.parent.unlink()
            aside.rename(self.path.parent)
        for path in set(self.path.parent.iterdir()) - self._beside:
            shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()
        if self.path.is_dir() and not self.path.is_symlink():
            shutil.rmtree(self.path)
        else:
            self.path.unlink(missing_ok=True)
        self.path.write_bytes(self.content)


def _aside(folder: Path) -> Path:
    return folder.with_name(f"{folder.name}.aside")


def files_by_kind(root: Path, *, without: str = "truth") -> list[list[Path]]:
    """Return the files below a folder in groups: files whose names differ in digits alone are one group."""
    groups: dict[str, list[Path]] = {}
    for path in sorted(root.rglob("*")):
        if path.is_file() and without not in path.relative_to(root).parts[:1]:
            groups.setdefault(re.sub(r"\d+", "#", str(path.relative_to(root))), []).append(path)
    return list(groups.values())


def mutate(groups: list[list[Path]], random: Random) -> tuple[Mutation, Undo]:
    """Damage one file; every group of files and every kind of damage is equally likely."""
    path = random.choice(random.choice(groups))
    undo = Undo(path)
    kind = random.choice(KINDS)
    detail = kind(path, undo.content, random, groups)
    harm = _HARM.get(kind, "other")
    # A file may end a little early, as sensors stop one after another (docs/datasets.md#files-that-end-early).
    is_short_cut = path.is_file() and path.stat().st_size > 0.99 * len(undo.content)
    if harm == "replaced" and path.match(_ONE_OF_SEVERAL):
        harm = "other"
    if harm == "shorter" and (is_short_cut or any(map(path.match, _SHORTER_IS_ANOTHER))):
        harm = "other"
    return Mutation(path, kind.__name__, detail, harm), undo


Kind = Callable[[Path, bytes, Random, list[list[Path]]], str]


def flipped_bits(path: Path, content: bytes, random: Random, _: list[list[Path]]) -> str:
    """Flip up to eight bits, sometimes all of them near the start, where headers stand."""
    changed = bytearray(content)
    end = min(len(changed), random.choice([64, 512, len(changed)]))
    places = [random.randrange(end) for _ in range(random.randint(1, 8))] if end else []
    for place in places:
        changed[place] ^= 1 << random.randrange(8)
    path.write_bytes(changed)
    return f"at {places}"


def random_block(path: Path, content: bytes, random: Random, _: list[list[Path]]) -> str:
    """Overwrite a block with random bytes."""
    start = random.randrange(len(content) + 1)
    block = random.randbytes(random.randint(16, 4096))
    path.write_bytes(content[:start] + block + content[start + len(block) :])
    return f"{len(block)} bytes at {start}"


def zeroed_block(path: Path, content: bytes, random: Random, _: list[list[Path]]) -> str:
    """Overwrite a block with zeros, as file systems do after a power cut."""
    start = random.randrange(len(content) + 1)
    length = random.randint(16, max(17, len(content) // 2))
    path.write_bytes(content[:start] + bytes(len(content[start : start + length])) + content[start + length :])
    return f"{length} bytes at {start}"


def cut_anywhere(path: Path, content: bytes, random: Random, _: list[list[Path]]) -> str:
    """Cut the file at any byte."""
    end = random.randrange(len(content) + 1)
    path.write_bytes(content[:end])
    return f"after {end} of {len(content)} bytes"


def cut_at_a_line(path: Path, content: bytes, random: Random, _: list[list[Path]]) -> str:
    """Cut the file behind a line, where nothing inside the file shows it."""
    lines = content.splitlines(keepends=True)
    kept = random.randrange(len(lines) + 1)
    path.write_bytes(b"".join(lines[:kept]))
    return f"after {kept} of {len(lines)} lines"


def cut_at_a_block(path: Path, content: bytes, random: Random, _: list[list[Path]]) -> str:
    """Cut the file behind a block of a disk or of a network, as a download that stopped does."""
    block = random.choice([512, 4096, 65536])
    end = block * random.randrange(len(content) // block + 1)
    path.write_bytes(content[:end])
    return f"after {end} of {len(content)} bytes"


def sparse(path: Path, content: bytes, random: Random, _: list[list[Path]]) -> str:
    """Lengthen the file by zeros that take no space, to more than any disk or memory holds."""
    size = random.choice([2**43, 3 * 2**30, len(content) + 2**20])
    os.truncate(path, size)
    return f"{size:,} bytes"


def lost_start(path: Path, content: bytes, random: Random, _: list[list[Path]]) -> str:
    """Remove the beginning."""
    start = random.randrange(len(content) + 1)
    path.write_bytes(content[start:])
    return f"of {start} bytes"


def lost_lines(path: Path, content: bytes, random: Random, _: list[list[Path]]) -> str:
    """Remove some lines in the middle."""
    lines = content.splitlines(keepends=True)
    start = random.randrange(len(lines) + 1)
    count = random.choice([1, 3, max(1, len(lines) // 3)])
    path.write_bytes(b"".join(lines[:start] + lines[start + count :]))
    return f"{count} after {start} of {len(lines)}"


def repeated_line(path: Path, content: bytes, random: Random, _: list[list[Path]]) -> str:
    """Write one line twice."""
    lines = content.splitlines(keepends=True) or [b""]
    place = random.randrange(len(lines))
    path.write_bytes(b"".join([*lines[: place + 1], *lines[place:]]))
    return f"{place + 1}"


def swapped_lines(path: Path, content: bytes, random: Random, _: list[list[Path]]) -> str:
    """Exchange two lines."""
    lines = content.splitlines(keepends=True) or [b""]
    one = random.randrange(len(lines))
    other = random.randrange(len(lines))
    lines[one], lines[other] = lines[other], lines[one]
    path.write_bytes(b"".join(lines))
    return f"{one + 1} and {other + 1}"


def impossible_number(path: Path, content: bytes, random: Random, _: list[list[Path]]) -> str:
    """Put something that no measurement is in the place of a number."""
    return _other_number(path, content, random, IMPOSSIBLE)


def other_number(path: Path, content: bytes, random: Random, _: list[list[Path]]) -> str:
    """Put another number in the place of a number."""
    return _other_number(path, content, random, POSSIBLE)


def _other_number(path: Path, content: bytes, random: Random, values: tuple[bytes, ...]) -> str:
    start = random.randrange(len(content) + 1)
    window = content[start : start + _WINDOW]
    numbers = list(NUMBER.finditer(window))
    value = random.choice(values)
    if not numbers:
        path.write_bytes(content[:start] + value + content[start:])
        return f"{value.decode()} at {start}"
    match = random.choice(numbers)
    where = slice(start + match.start(), start + match.end())
    path.write_bytes(content[: where.start] + value + content[where.stop :])
    return f"{value.decode()[:20]} for {match.group().decode()} at {where.start}"


def other_word(path: Path, content: bytes, random: Random, _: list[list[Path]]) -> str:
    """Put another text, long or dangerous, in the place of a word."""
    values = (
        b"../../evil",
        b"\x1b[2J",
        b"\xff\xfe",
        b"<img src=x onerror=1>",
        b"=1+1",
        b"x" * 100_000,
        b"\x00",
        b"a/b",
        b"a\\b",
        b"..",
        b"-rf",
        b"CON",
        b"\r\n",
        "\u202e\u200b\u0301".encode(),  # turns, hides and crosses out letters
        b"' OR 1=1 --",
        b"{0.__class__}",
        b"%s%n",
        b"$(true)",
        b"$\\frac$",
    )
    words = list(re.finditer(rb"[A-Za-z_]{3,}", content[:200_000]))
    value = random.choice(values)
    if not words:
        path.write_bytes(value + content)
        return f"{value[:20]!r} before all"
    match = random.choice(words)
    path.write_bytes(content[: match.start()] + value + content[match.end() :])
    return f"{value[:20]!r} for {match.group()[:40]!r}"


def deep_nesting(path: Path, content: bytes, random: Random, _: list[list[Path]]) -> str:
    """Nest brackets deeper than any program's stack, alone or in the place of a value."""
    deep = random.choice([b"[" * _DEEP + b"]" * _DEEP, b'{"a":' * _DEEP + b"1" + b"}" * _DEEP])
    values = list(re.finditer(rb":\s*([^,{}\[\]]+)", content[:200_000]))
    if not values or random.random() < 0.3:
        path.write_bytes(deep)
        return "alone"
    match = random.choice(values)
    path.write_bytes(content[: match.start(1)] + deep + content[match.end(1) :])
    return f"at {match.start(1)}"


def other_type(path: Path, content: bytes, random: Random, _: list[list[Path]]) -> str:
    """Put JSON of another type in the place of a JSON value, or of the whole file."""
    value = random.choice(
        [b"null", b"[]", b"{}", b'"text"', b"true", b"[[1], [2, 3]]", b'{"a": [null]}', b"-1", b"1e400"]
    )
    values = list(re.finditer(rb'(?<=[:,\[])\s*("[^"]*"|-?[\d.eE+-]+|\[[^\[\]]*\]|\{[^{}]*\})', content[:200_000]))
    if not values or random.random() < 0.1:
        path.write_bytes(value)
        return f"{value.decode()} alone"
    match = random.choice(values)
    path.write_bytes(content[: match.start(1)] + value + content[match.end(1) :])
    return f"{value.decode()} for {match.group(1)[:30]!r}"


def other_encoding(path: Path, content: bytes, random: Random, _: list[list[Path]]) -> str:
    """Save the text again as some editors do."""
    way = random.choice(["bom", "crlf", "cr", "utf-16", "no final newline", "blank lines"])
    text = {
        "bom": b"\xef\xbb\xbf" + content,
        "crlf": content.replace(b"\n", b"\r\n"),
        "cr": content.replace(b"\n", b"\r"),
        "utf-16": content.decode("latin-1").encode("utf-16"),
        "no final newline": content.rstrip(b"\n"),
        "blank lines": content + b"\n\n\n",
    }[way]
    path.write_bytes(text)
    return way


def other_header(path: Path, content: bytes, random: Random, _: list[list[Path]]) -> str:
    """Rename, remove, repeat or exchange a column of the first line."""
    first, newline, rest = content.partition(b"\n")
    names = first.split(b",")
    place = random.randrange(len(names))
    way = random.choice(["rename", "remove", "repeat", "exchange", "upper", "space", "mark", "semicolons"])
    if way == "rename":
        names[place] = b"other"
    elif way == "remove":
        del names[place]
    elif way == "repeat":
        names[place] = random.choice(names)
    elif way in ("upper", "space", "mark"):
        names[place] = {"upper": names[place].swapcase(), "space": b" " + names[place], "mark": b"\xc2\xa0"}[way]
    elif way == "semicolons":
        names = [content.replace(b",", b";")]
        newline = rest = b""
    else:
        other = random.randrange(len(names))
        names[place], names[other] = names[other], names[place]
    path.write_bytes(b",".join(names) + newline + rest)
    return f"{way} {place}"


def other_column(path: Path, content: bytes, random: Random, groups: list[list[Path]]) -> str:
    """Change a whole column of a table of text, below its header; a number where the file is none."""
    rows = [line.split(b",") for line in content.splitlines()]
    width = len(rows[0]) if len(rows) > 2 else 0
    if width < 2 or any(len(row) != width for row in rows):
        return other_number(path, content, random, groups)
    one, other = random.sample(range(width), 2)
    factor = random.choice([1000, 1e-3, 100, 0.01, 1e9, 0.0174532925, 3.28084, -1, 0])
    way = random.choice(["swapped", "frozen", "scaled", "twice", "shifted", "rounded", "lost", "quoted", "blank"])
    start = 1 if random.random() < 0.5 else random.randrange(1, len(rows))  # sometimes half of the column
    before = [list(row) for row in rows]
    for number, row in enumerate(rows):
        if number < start and way not in ("twice", "lost"):
            continue
        if way == "swapped":
            row[one], row[other] = row[other], row[one]
        elif way == "frozen":
            row[one] = before[start][one]
        elif way == "twice":
            row.append(row[one])
        elif way == "shifted":
            row[one] = before[number - 1][one]
        elif way == "lost":
            del row[one]
        elif way == "quoted":
            row[one] = b'"' + row[one] + b'"'
        elif way == "blank":
            row[one] = b""
        elif way in ("scaled", "rounded") and NUMBER.fullmatch(row[one]):
            number_there = float(row[one])
            row[one] = repr(number_there * factor if way == "scaled" else float(round(number_there))).encode()
    path.write_bytes(b"\n".join(map(b",".join, rows)) + b"\n")
    return f"{way} {one} and {other} from row {start}, factor {factor:g}"


def other_key(path: Path, content: bytes, random: Random, groups: list[list[Path]]) -> str:
    """Rename, repeat or remove a key of JSON or TOML; change the header of another file."""
    keys = list(re.finditer(rb'"([^"\\]{1,80})"\s*:|^([A-Za-z_-]+)\s*=', content[:200_000], re.MULTILINE))
    if not keys:
        return other_header(path, content, random, groups)
    match = random.choice(keys)
    group = 1 if match[1] else 2
    key = match[group]
    way = random.choice(["upper", "title", "twice", "space", "control", "underscore", "empty", "number", "prototype"])
    new = {
        "upper": key.upper(),
        "title": key.title(),
        "space": b" " + key,
        "control": b"\x1b[2J" + key,
        "underscore": key.replace(b"_", b"-") + b"_",
        "empty": b"",
        "number": b"0",
        "prototype": b"__class__",
    }
    if way == "twice":
        again = match.group() + (random.choice([b"null", b"-1", b'"x"']) + (b"," if group == 1 else b"\n"))
        path.write_bytes(content[: match.start()] + again + content[match.start() :])
    else:
        path.write_bytes(content[: match.start(group)] + new[way] + content[match.end(group) :])
    return f"{way} {key[:30]!r}"


def garbage_behind(path: Path, content: bytes, random: Random, _: list[list[Path]]) -> str:
    """Append something."""
    behind = random.choice([random.randbytes(100), b"{}", b"1,2,3\n", b"\n" * 1000, content])
    path.write_bytes(content + behind)
    return f"{len(behind)} bytes"


def empty(path: Path, content: bytes, random: Random, _: list[list[Path]]) -> str:
    """Leave nothing in the file."""
    path.write_bytes(b"")
    return ""


def missing(path: Path, content: bytes, random: Random, _: list[list[Path]]) -> str:
    """Remove the file."""
    path.unlink()
    return ""


def folder_instead(path: Path, content: bytes, random: Random, _: list[list[Path]]) -> str:
    """Put a folder in its place."""
    path.unlink()
    path.mkdir()
    if random.random() < 0.5:
        (path / path.name).write_bytes(content)
    return ""


def link_instead(path: Path, content: bytes, random: Random, _: list[list[Path]]) -> str:
    """Put a link in its place: to itself, to nothing, to a folder, or to what never ends or waits for ever."""
    endless = ["/dev/zero", "/dev/null", "/dev/tty", "/dev/stdin", "/proc/kmsg", "/proc/self/mem", "/proc/kcore"]
    target = random.choice([path.name, "nothing-here", ".", *endless])
    path.unlink()
    path.symlink_to(target)
    return f"to {target}"


def pipe_instead(path: Path, content: bytes, random: Random, _: list[list[Path]]) -> str:
    """Put a named pipe in its place, which nobody ever writes to, or a socket that nobody listens to."""
    path.unlink()
    if random.random() < 0.7 or len(str(path)) > 100:
        os.mkfifo(path)
        return "pipe"
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(str(path))
    return "socket"


def file_for_folder(path: Path, content: bytes, random: Random, _: list[list[Path]]) -> str:
    """Put the file in the place of its folder."""
    path.parent.rename(_aside(path.parent))
    path.parent.write_bytes(content if random.random() < 0.5 else b"")
    return path.parent.name


def no_permission(path: Path, content: bytes, random: Random, _: list[list[Path]]) -> str:
    """Forbid everybody to read it; the administrator reads it all the same."""
    path.write_bytes(content + b" ")
    path.chmod(0)
    return ""


def other_name(path: Path, content: bytes, random: Random, _: list[list[Path]]) -> str:
    """Give it another name, such as a copying program or a person does."""
    stem, suffix = path.stem, path.suffix
    names = (
        f"{stem}\x1b[31m{suffix}", f"{stem}\n{suffix}", path.name.swapcase(), f"{stem} (1){suffix}", f".{path.name}",
        f"-{path.name}", f"{path.name}.part", f"{stem}{suffix}{suffix}", f"{stem}\udcff{suffix}",
        f"{stem}\u0301{suffix}", f"{'x' * 200}{suffix}", f"{stem} {suffix}", stem or "x",
    )  # fmt: skip
    name = random.choice(names)
    path.rename(path.with_name(name))
    return f"now {name!r}"


def twin(path: Path, content: bytes, random: Random, _: list[list[Path]]) -> str:
    """Put a copy beside it, under a name that some systems or people take for the same."""
    names = (
        path.name.swapcase(),
        f"{path.stem} (1){path.suffix}",
        f"{path.name}~",
        f"._{path.name}",
        "\x1b[31m",
        "Thumbs.db",
    )
    name = random.choice(names)
    path.with_name(name).write_bytes(content if random.random() < 0.5 else content[: len(content) // 2])
    return f"beside {name!r}"


def other_file(path: Path, content: bytes, random: Random, groups: list[list[Path]]) -> str:
    """Put a copy of another file of the folder in its place."""
    other = random.choice(random.choice(groups))
    path.write_bytes(other.read_bytes())
    return f"copied from {other.name}"


def archive_damage(path: Path, content: bytes, random: Random, _: list[list[Path]]) -> str:
    """Damage a zip archive from inside: a member missing, repeated, renamed, encrypted or with a false size."""
    if not zipfile.is_zipfile(path):
        return flipped_bits(path, content, random, _)
    way = random.choice(["missing", "repeated", "renamed", "encrypted", "size", "bomb", "absolute", "case", "packed"])
    with zipfile.ZipFile(path) as archive:
        members = [(info.filename, archive.read(info)) for info in archive.infolist()]
    if way in ("encrypted", "size"):
        changed = bytearray(content)
        place = content.rfind(b"PK\x01\x02")
        if way == "encrypted":
            changed[place + 8] |= 1
            changed[content.find(b"PK\x03\x04") + 6] |= 1
        else:
            changed[place + 24 : place + 28] = random.choice(
                [b"\xff\xff\xff\xff", b"\x00\x00\x00\x00", b"\x00\x00\x00\x7f"]
            )
        path.write_bytes(changed)
        return way
    place = random.randrange(len(members))
    name, held = members[place]
    others = members[:place] + members[place + 1 :]
    changed_members = {
        "missing": others,
        "repeated": [*members, (name, held)],
        "renamed": [*others, ("../" + name, held)],
        "absolute": [*others, ("/" + name, held)],
        "case": [*others, (name.swapcase(), held)],
        "bomb": [*others, (name, held[:200] + bytes(2**27))],
        "packed": members,
    }
    packing = {"bomb": zipfile.ZIP_DEFLATED, "packed": zipfile.ZIP_LZMA}.get(way, zipfile.ZIP_STORED)
    with zipfile.ZipFile(path, "w", packing, compresslevel=1) as archive:
        for written_name, written in changed_members[way]:
            archive.writestr(written_name, written)
    return f"{way} {name}"


def array_damage(path: Path, content: bytes, random: Random, _: list[list[Path]]) -> str:
    """Change what the header of a NumPy array declares, alone or inside an archive that is not compressed."""
    start = content.find(b"\x93NUMPY")
    shape = re.search(rb"'shape': \(([^)]*)\)", content[start : start + 300]) if start >= 0 else None
    if shape is None:
        return zeroed_block(path, content, random, _)
    values = (b"999999999999,", b"0,", b"-1,", b"2**40,", b"70368744177664, 5", b"1,1,1", b"(1,)*9")
    value = random.choice(values)[: len(shape.group(1))].ljust(len(shape.group(1)))
    where = start + shape.start(1)
    path.write_bytes(content[:where] + value + content[where + len(value) :])
    return f"shape {value.decode()!r} for {shape.group(1).decode()!r}"


def other_arrays(path: Path, content: bytes, random: Random, _: list[list[Path]]) -> str:
    """Put another array or column into a sound file; other bytes where the file holds none."""
    return other_content(path, content, random) or random_block(path, content, random, _)


KINDS: tuple[Kind, ...] = (
    flipped_bits, random_block, zeroed_block, cut_anywhere, cut_at_a_line, lost_start, lost_lines, repeated_line,
    swapped_lines, impossible_number, other_number, other_word, deep_nesting, other_type, other_encoding, other_header,
    garbage_behind, empty, missing, folder_instead, link_instead, pipe_instead, other_file, archive_damage,
    array_damage, other_arrays, other_arrays, cut_at_a_block, sparse, other_column, other_column, other_key, other_key,
    file_for_folder, no_permission, other_name, twin,
)  # fmt: skip
_HARM: dict[Kind, Literal["shorter", "replaced"]] = {
    **dict.fromkeys((cut_anywhere, cut_at_a_line, cut_at_a_block, lost_start, empty), "shorter"),
    **dict.fromkeys((missing, folder_instead, link_instead, pipe_instead, sparse, file_for_folder), "replaced"),
    other_name: "replaced",
}
