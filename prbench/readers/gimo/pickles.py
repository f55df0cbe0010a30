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


class PickleMachine:
    """Carries out pickles that lie in some bytes.

    Args:
        content: The bytes.
        names: Maps "module name" to what stands for it; every other name is refused.
        persistent: Makes the value of a persistent id; None refuses them.
    """

    def __init__(
        self,
        content: bytes,
        names: Mapping[str, Name],
        *,
        persistent: Callable[[Any], Any] | None = None,
    ) -> None:
        self._content = content
        self._names = names
        self._persistent = persistent
        self.position = 0

    def run(self, position: int = 0) -> Any:
        """Return the value of the pickle that begins at a position; ``self.position`` is then behind its end.

        Raises:
            PickleRefused: for whatever pickled tensors do not hold, with the position of the opcode.
        """
        self._stack: list[Any] = []
        self._below: list[list[Any]] = []  # stacks that lie under the marks
        self._memo: dict[int, Any] = {}
        self._at = position
        try:
            self._carry_out(position)
            return self._stack.pop()
        except PickleRefused as error:
            error.position = self._at
            raise
        except (IndexError, KeyError, ValueError, TypeError, OverflowError) as error:
            # What a damaged program does to a stack: it takes from an empty one, or asks for what was never kept.
            found = f"an opcode {self._opcode_name()} that does not fit ({type(error).__name__}: {error})"
            raise PickleRefused(found, self._at) from error

    def _carry_out(self, position: int) -> None:
        stream = io.BytesIO(self._content)
        stream.seek(position)
        opcodes = pickletools.genops(stream)
        while True:
            self._at = stream.tell()
            try:
                opcode, argument, _ = next(opcodes)
            except ValueError as error:
                raise self._undecodable(error, at_end=stream.tell() >= len(self._content)) from error
            if opcode.name == "STOP":
                self.position = stream.tell()
                return
            _HANDLERS.get(opcode.name, PickleMachine._unknown)(self, argument)

    def _undecodable(self, error: ValueError, *, at_end: bool) -> PickleRefused:
        """The refusal of an opcode that the disassembler cannot tell or whose argument it cannot read."""
        if self._at >= len(self._content):
            return PickleRefused("the end of the file before the pickle's own end")
        if self._opcode_name() not in _HANDLERS:
            return PickleRefused(f"the opcode {self._opcode_name()}", foreign=True)
        if at_end:
            return PickleRefused("the end of the bytes before the pickle's own end")
        return PickleRefused(f"an opcode {self._opcode_name()} that does not fit ({type(error).__name__}: {error})")

    def _opcode_name(self) -> str:
        code = chr(self._content[self._at])
        return _OPCODE_NAMES.get(code, f"0x{ord(code):02x}")

    # Marks, stack and memo

    def _unknown(self, _: object) -> None:
        raise PickleRefused(f"the opcode {self._opcode_name()}", foreign=True)

    def _proto(self, protocol: int) -> None:
        if protocol > pickle.HIGHEST_PROTOCOL:
            raise PickleRefused(f"protocol {protocol}")

    def _frame(self, _: object) -> None:
        """Do nothing: frames help only those who read a pickle in pieces."""

    def _mark(self, _: object) -> None:
        self._below.append(self._stack)
        self._stack = []

    def _since_mark(self) -> list[Any]:
        items = self._stack
        self._stack = self._below.pop()
        return items

    def _push(self, value: Any) -> None:
        self._stack.append(value)

    def _memoize(self, _: object) -> None:
        self._memo[len(self._memo)] = self._stack[-1]

    def _put(self, index: int) -> None:
        self._memo[index] = self._stack[-1]

    def _get(self, index: int) -> None:
        self._push(self._memo[index])

    # Containers

    def _tuple(self, _: object) -> None:
        items = self._since_mark()
        self._push(tuple(items))

    def _short_tuple(self, _: object) -> None:
        size = int(self._opcode_name()[-1])  # TUPLE1, TUPLE2, TUPLE3
        if len(self._stack) < size:
            raise IndexError("the stack is empty")
        items = tuple(self._stack[-size:])
        del self._stack[-size:]
        self._push(items)

    def _list(self, _: object) -> None:
        items = self._since_mark()
        self._push(items)

    def _append(self, _: object) -> None:
        item = self._stack.pop()
        self._top(list).append(item)

    def _appends(self, _: object) -> None:
        items = self._since_mark()
        self._top(list).extend(items)

    def _dict(self, _: object) -> None:
        items = self._since_mark()
        self._push({})
        self._set(items)

    def _setitem(self, _: object) -> None:
        value = self._stack.pop()
        key = self._stack.pop()
        self._set([key, value])

    def _setitems(self, _: object) -> None:
        self._set(self._since_mark())

    def _set(self, items: list[Any]) -> None:
        target = self._top(dict)
        for key, value in zip(items[::2], items[1::2], strict=True):
            if not isinstance(key, str | int):
                raise PickleRefused(f"a key of the type {type(key).__name__}")
            if key in target:
                raise PickleRefused(f"the key '{key}' twice")
            target[key] = value

    def _top(self, kind: type) -> Any:
        """The uppermost value, which must be a list or dictionary of the program's own."""
        target = self._stack[-1]
        if type(target) is not kind:
            raise PickleRefused(f"the opcode {self._opcode_name()} on a {type(target).__name__}", foreign=True)
        return target

    # Names, calls, states

    def _global(self, names: str) -> None:
        module, _, name = names.partition(" ")
        self._push(self._named(module, name))

    def _stack_global(self, _: object) -> None:
        name = self._stack.pop()
        module = self._stack.pop()
        self._push(self._named(module, name))

    def _named(self, module: Any, name: Any) -> Name:
        if not (isinstance(module, str) and isinstance(name, str)):
            raise PickleRefused("a name that is no text", foreign=True)
        known = self._names.get(f"{module} {name}")
        if known is None:
            raise PickleRefused(f"the name '{module}.{name}'", foreign=True)
        return known

    def _reduce(self, _: object) -> None:
        arguments = self._stack.pop()
        called = self._stack.pop()
        if not isinstance(called, Name) or type(arguments) is not tuple:
            raise PickleRefused(f"a call of a {type(called).__name__}", foreign=True)
        if called.make is None:
            raise PickleRefused(f"the name '{called.text}', called", foreign=True)
        self._push(called.make(*arguments))

    def _build(self, _: object) -> None:
        state = self._stack.pop()
        target = self._stack[-1]
        if not isinstance(target, Unfinished):
            raise PickleRefused(f"the opcode BUILD on a {type(target).__name__}", foreign=True)
        target.fill(state)

    def _binpersid(self, _: object) -> None:
        if self._persistent is None:
            raise PickleRefused("a persistent id", foreign=True)
        self._push(self._persistent(self._stack.pop()))


_PLAIN_VALUES = (
    *("INT", "LONG", "LONG1", "BININT", "BININT1", "BININT2", "FLOAT", "BINFLOAT"),
    *("UNICODE", "BINUNICODE", "SHORT_BINUNICODE", "BINBYTES", "SHORT_BINBYTES"),
)
_HANDLERS: dict[str, Callable[[PickleMachine, Any], None]] = {
    "PROTO": PickleMachine._proto,
    "FRAME": PickleMachine._frame,
    "MARK": PickleMachine._mark,
    "MEMOIZE": PickleMachine._memoize,
    **dict.fromkeys(("PUT", "BINPUT", "LONG_BINPUT"), PickleMachine._put),
    **dict.fromkeys(("GET", "BINGET", "LONG_BINGET"), PickleMachine._get),
    **dict.fromkeys(_PLAIN_VALUES, PickleMachine._push),
    "NONE": lambda machine, _: machine._push(None),
    "NEWTRUE": lambda machine, _: machine._push(True),
    "NEWFALSE": lambda machine, _: machine._push(False),
    "EMPTY_TUPLE": lambda machine, _: machine._push(()),
    "EMPTY_LIST": lambda machine, _: machine._push([]),
    "EMPTY_DICT": lambda machine, _: machine._push({}),
    "TUPLE": PickleMachine._tuple,
    **dict.fromkeys(("TUPLE1", "TUPLE2", "TUPLE3"), PickleMachine._short_tuple),
    "LIST": PickleMachine._list,
    "APPEND": PickleMachine._append,
    "APPENDS": PickleMachine._appends,
    "DICT": PickleMachine._dict,
    "SETITEM": PickleMachine._setitem,
    "SETITEMS": PickleMachine._setitems,
    "GLOBAL": PickleMachine._global,
    "STACK_GLOBAL": PickleMachine._stack_global,
    "REDUCE": PickleMachine._reduce,
    "BUILD": PickleMachine._build,
    "BINPERSID": PickleMachine._binpersid,
}
"""All opcodes that ``pickle`` and ``torch.save`` write for dictionaries of tensors, in the protocols 0 to 5."""


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
        return _loaded_from_zip(content, names)
    machine = PickleMachine(content, names)
    loaded = machine.run()
    if loaded != _MAGIC_NUMBER:
        return loaded
    if machine.run(machine.position) != _FORM_VERSION:
        raise PickleRefused("another version of torch's files", machine.position)
    machine.run(machine.position)  # sizes of types on the machine that wrote the file, which torch does not use either
    return _loaded_from_stream(content, machine.position, names)


def _loaded_from_zip(content: bytes, names: Mapping[str, Name]) -> Any:
    """Read the newer form: an archive of a pickle and one uncompressed file a storage."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            files = _stored_files(archive, len(content))
    except (zipfile.BadZipFile, ValueError, RuntimeError, EOFError, OSError, struct.error) as error:
        raise PickleRefused(f"a damaged archive: {error}") from error
    if "data.pkl" not in files or files.get("byteorder", b"little") != b"little":
        raise PickleRefused("an archive of another kind")
    storages = _Storages()
    loaded = PickleMachine(files["data.pkl"], names, persistent=storages).run()
    for key, storage in storages.by_key.items():
        storage.take(files.get(f"data/{key}", b""), 0)
    return loaded


def _stored_files(archive: zipfile.ZipFile, most: int) -> dict[str, bytes]:
    """Maps names, without the folder that all lie in, to contents; as nothing is compressed, these fit the archive."""
    entries = archive.infolist()
    compressed = any(entry.compress_type != zipfile.ZIP_STORED for entry in entries)
    if compressed or sum(entry.file_size for entry in entries) > most:
        raise PickleRefused("compressed files in the archive", foreign=True)
    return {entry.filename.partition("/")[2]: archive.read(entry) for entry in entries}


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


def _loaded_from_stream(content: bytes, position: int, names: Mapping[str, Name]) -> Any:
    """Read what follows the start of the older form: the pickle, the keys of its storages, and their numbers."""
    storages = _Storages()
    machine = PickleMachine(content, names, persistent=storages)
    loaded = machine.run(position)
    keys = machine.run(machine.position)
    position = machine.position
    named = {key for key in keys if isinstance(key, str)} if isinstance(keys, list) else set()
    if named != storages.by_key.keys() or len(keys) != len(named):
        raise PickleRefused("other storages than those that the tensors name", position)
    for key in keys:
        position = storages.by_key[key].take_counted(content, position)
    return loaded


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
