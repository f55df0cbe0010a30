"""A machine that carries out the opcodes of pickled tensors and no others, on values that can do nothing.

A pickle is a program. Python's own unpickler imports what the program names, calls it, and sets attributes of it
(opcode BUILD), even where ``find_class`` knows a few names only; its memo grows to any index that a file names. Here
a name stands for a :class:`Name` of ours, a call for a function of ours, and BUILD reaches :class:`Unfinished` values
alone. Every opcode takes a byte and adds at most one value, so that the size of the file bounds stack, memo and time.
The standard library's disassembler, which runs nothing, tells the opcodes and their arguments.
"""

from __future__ import annotations

import io
import math
import pickle
import pickletools
import re
import struct
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from prbench.errors import InputFileError
from prbench.files.bounded import read_whole
from prbench.limits import LARGEST_PICKLE
from prbench.readers.files import must_exist


class PickleRefused(Exception):
    """A pickle is damaged, or asks for something that tensors do not need.

    Args:
        found: What stands there.
        position: Byte at which it stands, counted from the beginning of the pickle.
        foreign: Whether it is a name, an opcode or a call that the format does not have, rather than damage.
    """

    def __init__(self, found: str, position: int = 0, *, foreign: bool = False) -> None:
        self.found = found
        self.position = position
        self.foreign = foreign
        super().__init__(found)


@dataclass(frozen=True, slots=True)
class Name:
    """Stand-in that a pickle gets for the function or class that it names."""

    text: str
    make: Callable[..., Any] | None = None
    """Function that calling it runs; None where the format hands the name to another function and never calls it."""


class Unfinished:
    """A value that the format makes first and fills afterwards, by the opcode BUILD."""

    def fill(self, state: Any) -> None:
        """Take over the state.

        Raises:
            PickleRefused: if it is not the state of such a value.
        """
        raise NotImplementedError


_OPCODE_NAMES = {opcode.code: opcode.name for opcode in pickletools.opcodes}
_PLAIN_VALUES = frozenset((
    *("INT", "LONG", "LONG1", "BININT", "BININT1", "BININT2", "FLOAT", "BINFLOAT"),
    *("UNICODE", "BINUNICODE", "SHORT_BINUNICODE", "BINBYTES", "SHORT_BINBYTES"),
))  # fmt: skip
_CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False, "EMPTY_TUPLE": ()}
_OTHERS = frozenset((
    *("PROTO", "FRAME", "STOP", "MARK", "MEMOIZE", "PUT", "BINPUT", "LONG_BINPUT", "GET", "BINGET", "LONG_BINGET"),
    *("EMPTY_LIST", "EMPTY_DICT", "TUPLE", "TUPLE1", "TUPLE2", "TUPLE3", "LIST", "APPEND", "APPENDS", "DICT"),
    *("SETITEM", "SETITEMS", "GLOBAL", "STACK_GLOBAL", "REDUCE", "BUILD", "BINPERSID"),
))  # fmt: skip
_OPCODES = _PLAIN_VALUES | _CONSTANTS.keys() | _OTHERS
"""All opcodes that ``pickle`` and ``torch.save`` write for dictionaries of tensors, in the protocols 0 to 5."""


def run_pickle(
    content: bytes,
    names: Mapping[str, Name],
    position: int = 0,
    *,
    persistent: Callable[[Any], Any] | None = None,
) -> tuple[Any, int]:
    """Carry out the pickle that begins at a position of some bytes.

    Args:
        content: The bytes.
        names: Maps "module name" to what stands for it; every other name is refused.
        position: Where the pickle begins.
        persistent: Makes the value of a persistent id; None refuses them.

    Returns:
        The pickle's value, and the position behind its end.

    Raises:
        PickleRefused: for whatever pickled tensors do not hold, with the position of the opcode.
    """
    stream = io.BytesIO(content)
    stream.seek(position)
    opcodes = pickletools.genops(stream)
    stack: list[Any] = []
    below: list[list[Any]] = []  # stacks that lie under the marks
    memo: dict[int, Any] = {}
    at = position
    name = ""
    argument: Any
    try:
        while True:
            at = stream.tell()
            if at >= len(content):
                raise PickleRefused("the end of the file before the pickle's own end")
            name = _OPCODE_NAMES.get(chr(content[at]), f"0x{content[at]:02x}")
            if name not in _OPCODES:
                raise PickleRefused(f"the opcode {name}", foreign=True)
            try:
                argument = next(opcodes)[1]
            except ValueError:
                if stream.tell() >= len(content):
                    raise PickleRefused("the end of the bytes before the pickle's own end") from None
                raise  # an argument that is none
            if name in _PLAIN_VALUES:
                stack.append(argument)
                continue
            if name in _CONSTANTS:
                stack.append(_CONSTANTS[name])
                continue
            items: list[Any] = []
            if name in ("TUPLE", "LIST", "DICT", "APPENDS", "SETITEMS"):  # they take all since the last mark
                items = stack
                stack = below.pop()
            match name:
                case "STOP":
                    return stack.pop(), stream.tell()
                case "PROTO":
                    if argument > pickle.HIGHEST_PROTOCOL:
                        raise PickleRefused(f"protocol {argument}")
                case "FRAME":
                    pass  # frames help only those who read a pickle in pieces
                case "MARK":
                    below.append(stack)
                    stack = []
                case "MEMOIZE":
                    memo[len(memo)] = stack[-1]
                case "PUT" | "BINPUT" | "LONG_BINPUT":
                    memo[argument] = stack[-1]
                case "GET" | "BINGET" | "LONG_BINGET":
                    stack.append(memo[argument])
                case "EMPTY_LIST":
                    stack.append([])
                case "EMPTY_DICT":
                    stack.append({})
                case "TUPLE":
                    stack.append(tuple(items))
                case "TUPLE1" | "TUPLE2" | "TUPLE3":
                    size = int(name[-1])
                    if len(stack) < size:
                        raise IndexError("the stack is empty")
                    stack[-size:] = [tuple(stack[-size:])]
                case "LIST":
                    stack.append(items)
                case "APPEND":
                    item = stack.pop()
                    _own(stack, list, name).append(item)
                case "APPENDS":
                    _own(stack, list, name).extend(items)
                case "DICT":
                    stack.append({})
                    _set(stack[-1], items)
                case "SETITEM":
                    value = stack.pop()
                    key = stack.pop()
                    _set(_own(stack, dict, name), [key, value])
                case "SETITEMS":
                    _set(_own(stack, dict, name), items)
                case "GLOBAL":
                    module, _, own_name = argument.partition(" ")
                    stack.append(_named(names, module, own_name))
                case "STACK_GLOBAL":
                    own_name = stack.pop()
                    stack.append(_named(names, stack.pop(), own_name))
                case "REDUCE":
                    arguments = stack.pop()
                    called = stack.pop()
                    if not isinstance(called, Name) or type(arguments) is not tuple:
                        raise PickleRefused(f"a call of a {type(called).__name__}", foreign=True)
                    if called.make is None:
                        raise PickleRefused(f"the name '{called.text}', called", foreign=True)
                    stack.append(called.make(*arguments))
                case "BUILD":
                    state = stack.pop()
                    target = stack[-1]
                    if not isinstance(target, Unfinished):
                        raise PickleRefused(f"the opcode BUILD on a {type(target).__name__}", foreign=True)
                    target.fill(state)
                case "BINPERSID":
                    if persistent is None:
                        raise PickleRefused("a persistent id", foreign=True)
                    stack.append(persistent(stack.pop()))
    except PickleRefused as error:
        error.position = at
        raise
    except (IndexError, KeyError, ValueError, TypeError, OverflowError) as error:
        # What a damaged program does to a stack: it takes from an empty one, or asks for what was never kept.
        raise PickleRefused(f"an opcode {name} that does not fit ({type(error).__name__}: {error})", at) from error


def _own(stack: list[Any], kind: type, opcode: str) -> Any:
    """The uppermost value, which must be a list or dictionary of the program's own."""
    if type(stack[-1]) is not kind:
        raise PickleRefused(f"the opcode {opcode} on a {type(stack[-1]).__name__}", foreign=True)
    return stack[-1]


def _set(target: dict, items: list[Any]) -> None:
    for key, value in zip(items[::2], items[1::2], strict=True):
        if not isinstance(key, str | int):
            raise PickleRefused(f"a key of the type {type(key).__name__}")
        if key in target:
            raise PickleRefused(f"the key '{key}' twice")
        target[key] = value


def _named(names: Mapping[str, Name], module: Any, name: Any) -> Name:
    if not (isinstance(module, str) and isinstance(name, str)):
        raise PickleRefused("a name that is no text", foreign=True)
    known = names.get(f"{module} {name}")
    if known is None:
        raise PickleRefused(f"the name '{module}.{name}'", foreign=True)
    return known


_EXPECTED = "a pickled dictionary of torch tensors"
_MAGIC_NUMBER = 0x1950A86A20F9469CFC6C
_FORM_VERSION = 1001
_MACHINE = {"protocol_version": 1001, "little_endian": True, "type_sizes": {"short": 2, "int": 4, "long": 4}}
_STREAM_START = b"".join(pickle.dumps(part, protocol=2) for part in (_MAGIC_NUMBER, _FORM_VERSION, _MACHINE))
"""Beginning of the older form of ``torch.save``: three pickles, which are the same before every storage."""
_USUAL_STORAGE = re.compile(
    re.escape(_STREAM_START)
    + rb"\x80\x02\(X\x07\0\0\0storageq\0ctorch\n(?P<kind>\w+)\nq\x01"
    + rb"X(?P<length>.)\0\0\0(?P<key>\d+)q\x02X\x03\0\0\0cpuq\x03(?:K(?P<size>.)|M(?P<longer>..))Ntq\x04Q\."
    + rb"\x80\x02\]q\0X(?P=length)\0\0\0(?P=key)q\x01a\.",
    re.DOTALL,
)
"""All that torch writes before the numbers of one storage of up to 65,535. The machine understands it just as well, but
these are nine tenths of a pose's opcodes, and a segment has some thousand poses."""
_ZIP_START = b"PK\x03\x04"
_MOST_AXES = 8
_ITEM_TYPES = {
    b"FloatStorage": np.dtype("<f4"),
    b"DoubleStorage": np.dtype("<f8"),
    b"HalfStorage": np.dtype("<f2"),
    b"LongStorage": np.dtype("<i8"),
    b"IntStorage": np.dtype("<i4"),
    b"ShortStorage": np.dtype("<i2"),
    b"CharStorage": np.dtype("<i1"),
    b"ByteStorage": np.dtype("<u1"),
}
"""Both forms of ``torch.save`` hold numbers with their least significant byte first."""


@dataclass
class _Storage:
    """The numbers behind tensors; in the files of ``torch.save`` they lie behind the pickle."""

    item_type: np.dtype
    size: int
    numbers: np.ndarray | None = None

    def take(self, content: bytes, position: int) -> int:
        """Take the numbers from the bytes at a position; return the position behind them."""
        end = position + self.size * self.item_type.itemsize
        if end > len(content):
            raise PickleRefused(f"{max(len(content) - position, 0)} bytes for {self.size} numbers", position)
        self.numbers = np.frombuffer(content, self.item_type, self.size, position)
        return end

    def take_counted(self, content: bytes, position: int) -> int:
        """The same where the number of numbers stands before them."""
        size = int.from_bytes(content[position : position + 8], "little")
        if size != self.size:
            raise PickleRefused(f"{size} numbers in a storage of {self.size}", position)
        return self.take(content, position + 8)


@dataclass
class _Tensor:
    """A view of a storage, made once the storage has its numbers."""

    storage: _Storage
    offset: int
    shape: tuple[int, ...]
    strides: tuple[int, ...]
    """In numbers, not in bytes."""

    def array(self) -> np.ndarray:
        """The tensor's numbers, which the storage holds by now."""
        assert self.storage.numbers is not None, "every way that makes tensors fills their storages or raises"
        item = self.storage.item_type.itemsize
        strides = tuple(stride * item for stride in self.strides)
        return np.ndarray(self.shape, self.storage.item_type, self.storage.numbers, self.offset * item, strides)


_LOAD_STORAGE = "torch.storage _load_from_bytes"


def load_tensors(path: Path) -> dict[str, np.ndarray]:
    """Read the named tensors of a pickled dictionary.

    Returns:
        One array a name, of the tensor's shape and type (whole or floating-point numbers); read-only.

    Raises:
        InputFileError: if the file is missing, too large or damaged, holds an opcode or a name that tensors do not need
            (nothing of it is imported or run), or holds anything but a dictionary of tensors.
    """
    with must_exist(path):
        content = read_whole(path, largest=LARGEST_PICKLE)
    try:
        loaded = _loaded(content, _NAMES | {_LOAD_STORAGE: Name("torch.storage._load_from_bytes", _StorageLoader())})
    except PickleRefused as error:
        remedy = "Nothing of it was run; do not open it with other programs." if error.foreign else "Copy it again."
        raise _refused(path, f"byte {error.position}", error.found, remedy) from error
    if not isinstance(loaded, dict):
        raise _refused(path, "", f"a {type(loaded).__name__}", "")
    return {str(name): _array(path, str(name), value) for name, value in loaded.items()}


def _loaded(content: bytes, names: Mapping[str, Name]) -> Any:
    """Decode some bytes: a plain pickle, or either form of ``torch.save``."""
    if content.startswith(_ZIP_START):
        # Read the newer form: an archive of a pickle and one uncompressed file a storage.
        try:
            with zipfile.ZipFile(io.BytesIO(content)) as archive:
                # Maps names, without the folder that all lie in, to contents; as nothing is compressed, these fit the
                # archive.
                most = len(content)
                entries = archive.infolist()
                compressed = any(entry.compress_type != zipfile.ZIP_STORED for entry in entries)
                if compressed or sum(entry.file_size for entry in entries) > most:
                    raise PickleRefused("compressed files in the archive", foreign=True)
                files = {entry.filename.partition("/")[2]: archive.read(entry) for entry in entries}
        except (zipfile.BadZipFile, ValueError, RuntimeError, EOFError, OSError, struct.error) as error:
            raise PickleRefused(f"a damaged archive: {error}") from error
        if "data.pkl" not in files or files.get("byteorder", b"little") != b"little":
            raise PickleRefused("an archive of another kind")
        storages = _Storages()
        loaded, _ = run_pickle(files["data.pkl"], names, persistent=storages)
        for key, storage in storages.by_key.items():
            storage.take(files.get(f"data/{key}", b""), 0)
        return loaded
    loaded, position = run_pickle(content, names)
    if loaded != _MAGIC_NUMBER:
        return loaded
    version, position = run_pickle(content, names, position)
    if version != _FORM_VERSION:
        raise PickleRefused("another version of torch's files", position)
    _, position = run_pickle(content, names, position)  # sizes of types where it was written; torch does not use them
    # Then the pickle itself, the keys of its storages, and their numbers.
    storages = _Storages()
    loaded, position = run_pickle(content, names, position, persistent=storages)
    keys, position = run_pickle(content, names, position)
    named = {key for key in keys if isinstance(key, str)} if isinstance(keys, list) else set()
    if named != storages.by_key.keys() or len(keys) != len(named):
        raise PickleRefused("other storages than those that the tensors name", position)
    for key in keys:
        position = storages.by_key[key].take_counted(content, position)
    return loaded


class _Storages:
    """All storages of one file by key: what its persistent ids stand for."""

    def __init__(self) -> None:
        self.by_key: dict[str, _Storage] = {}

    def __call__(self, identity: Any) -> _Storage:
        """Return the storage of one persistent id: ("storage", its class, key, device, how many numbers[, None])."""
        if type(identity) is not tuple or len(identity) not in (5, 6) or identity[0] != "storage":
            raise PickleRefused("a persistent id of something else than a storage", foreign=True)
        kind = identity[1]
        key = identity[2]
        size = identity[4]
        item_type = _ITEM_TYPES.get(kind.text.encode()) if isinstance(kind, Name) else None
        if item_type is None or not isinstance(key, str) or identity[5:] not in ((), (None,)):
            raise PickleRefused("a storage of another kind", foreign=True)
        if type(size) is not int or size < 0:
            raise PickleRefused(f"a storage of {size} numbers")
        return self.by_key.setdefault(key, _Storage(item_type, size))


def _rebuild_tensor(storage: Any, offset: Any, shape: Any, strides: Any, *_: Any) -> _Tensor:
    """``torch._utils._rebuild_tensor_v2``; what follows the strides (gradient, hooks) concerns training."""
    if not isinstance(storage, _Storage):
        raise PickleRefused(f"a tensor of a {type(storage).__name__}", foreign=True)
    shape = _whole_numbers(shape)
    strides = _whole_numbers(strides)
    if type(offset) is not int or offset < 0 or len(shape) != len(strides):
        raise PickleRefused("a tensor without place in its storage")
    last = offset + sum((size - 1) * stride for size, stride in zip(shape, strides, strict=True))
    # A stride of 0 shows one number many times: no format needs it, and a small file would unpack to any size.
    size = math.prod(shape)
    if size > storage.size or (size > 0 and last >= storage.size) or offset > storage.size:
        raise PickleRefused(f"a tensor of {size} numbers in a storage of {storage.size}")
    return _Tensor(storage, offset, shape, strides)


def _whole_numbers(values: Any) -> tuple[int, ...]:
    if type(values) is not tuple or not all(type(value) is int and 0 <= value <= LARGEST_PICKLE for value in values):
        raise PickleRefused("sizes that are no whole numbers from 0")
    if len(values) > _MOST_AXES:
        raise PickleRefused(f"{len(values)} axes")
    return values


def _rebuild_parameter(tensor: Any, *_: Any) -> _Tensor:
    """``torch._utils._rebuild_parameter``: the tensor itself."""
    if not isinstance(tensor, _Tensor):
        raise PickleRefused(f"a parameter of a {type(tensor).__name__}", foreign=True)
    return tensor


def _ordered_dict(*items: Any) -> dict:
    """``collections.OrderedDict``, whose items come afterwards."""
    if items:
        raise PickleRefused("the name 'collections.OrderedDict' with other things than items", foreign=True)
    return {}


def _latin_bytes(text: Any, encoding: Any = "latin1") -> bytes:
    """``_codecs.encode``: how old protocols hold bytes; no other codec is looked up."""
    if encoding not in ("latin1", "latin-1") or not isinstance(text, str):
        raise PickleRefused(f"the name '_codecs.encode' with '{encoding}'", foreign=True)
    return text.encode("latin-1")


class _NumpyType(Unfinished):
    """``numpy.dtype``: its code first, the order of bytes by BUILD."""

    def __init__(self, code: Any, *_: Any) -> None:
        if code not in ("f2", "f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8"):
            raise PickleRefused("an array of other things than numbers", foreign=True)
        self.type = np.dtype(code)

    def fill(self, state: Any) -> None:
        """See :class:`Unfinished`: (version, order of bytes, and parts that plain numbers do not have)."""
        if type(state) is not tuple or len(state) < 2 or state[1] not in ("<", ">", "|"):
            raise PickleRefused("an array of other things than numbers", foreign=True)
        self.type = self.type.newbyteorder(state[1])


class _NumpyArray(Unfinished):
    """``numpy.ndarray``: empty first, everything else by BUILD."""

    def __init__(self, *_: Any) -> None:
        self._array: np.ndarray | None = None

    def fill(self, state: Any) -> None:
        """See :class:`Unfinished`: (version, shape, type, whether the first axis runs fastest, bytes)."""
        if type(state) is not tuple or len(state) != 5:
            raise PickleRefused("an array of another kind", foreign=True)
        shape = _whole_numbers(state[1])
        kind = state[2]
        by_column = state[3]
        raw = state[4]
        if not isinstance(kind, _NumpyType) or not isinstance(raw, bytes):
            raise PickleRefused("an array of another kind", foreign=True)
        self._array = np.frombuffer(raw, kind.type).reshape(shape, order="F" if by_column is True else "C")

    def array(self) -> np.ndarray | None:
        """The array; None if the pickle never filled it."""
        return self._array


_NAMES = {
    "torch._utils _rebuild_tensor_v2": Name("torch._utils._rebuild_tensor_v2", _rebuild_tensor),
    "torch._utils _rebuild_parameter": Name("torch._utils._rebuild_parameter", _rebuild_parameter),
    "collections OrderedDict": Name("collections.OrderedDict", _ordered_dict),
    "_codecs encode": Name("_codecs.encode", _latin_bytes),
    "numpy ndarray": Name("numpy.ndarray"),
    "numpy dtype": Name("numpy.dtype", _NumpyType),
    "numpy.core.multiarray _reconstruct": Name("numpy.core.multiarray._reconstruct", _NumpyArray),
    "numpy._core.multiarray _reconstruct": Name("numpy._core.multiarray._reconstruct", _NumpyArray),
    **{f"torch {kind.decode()}": Name(kind.decode()) for kind in _ITEM_TYPES},
}


class _StorageLoader:
    """``torch.storage._load_from_bytes``: in a plain pickle a storage is a file of its own, which holds no others."""

    def __init__(self) -> None:
        self._left = LARGEST_PICKLE

    def __call__(self, raw: Any) -> _Storage:
        """Read one storage; a program may hand the same bytes in again and again, which is counted."""
        if not isinstance(raw, bytes):
            raise PickleRefused(f"a storage of the type {type(raw).__name__}", foreign=True)
        self._left -= len(raw)
        if self._left < 0:
            raise PickleRefused(f"storages of more than {LARGEST_PICKLE:,} bytes")
        try:
            storage = _usual_storage(raw) or _loaded(raw, _NAMES)
        except PickleRefused as error:
            found = f"{error.found} (byte {error.position} of a storage)"
            raise PickleRefused(found, foreign=error.foreign) from error
        if not isinstance(storage, _Storage):
            raise PickleRefused(f"a {type(storage).__name__} in the place of a storage", foreign=True)
        return storage


def _usual_storage(content: bytes) -> _Storage | None:
    """The storage in some bytes that hold it in the usual form; None for all others."""
    usual = _USUAL_STORAGE.match(content)
    if usual is None or usual["length"][0] != len(usual["key"]) or usual["kind"] not in _ITEM_TYPES:
        return None
    storage = _Storage(_ITEM_TYPES[usual["kind"]], int.from_bytes(usual["size"] or usual["longer"], "little"))
    storage.take_counted(content, usual.end())
    return storage


def _refused(path: Path, where: str, found: str, remedy: str) -> InputFileError:
    return InputFileError(path, where, expected=_EXPECTED, found=found, remedy=remedy)


def _array(path: Path, name: str, value: Any) -> np.ndarray:
    array = value.array() if isinstance(value, _Tensor | _NumpyArray) else None
    if array is None:
        raise _refused(path, name, f"a {type(value).__name__}", "")
    return array
