"""Pickled tensors, read without importing or running anything that a file names.

A pickle is a program. Python's own unpickler imports what the program names, calls it, and sets attributes of it
(opcode BUILD). Here it is the standard library's unpickler that is written in Python, cut down to the opcodes of a
dictionary of tensors. The four names that such a dictionary needs stand for functions of ours; every other name, and
every other opcode, is refused. Each opcode takes a byte and adds at most one value, and its memo is a dictionary, so
that the size of the file bounds memory and time.
"""

from __future__ import annotations

import io
import math
import pickle
import pickletools
import re
from pathlib import Path
from typing import Any

import numpy as np

from prbench.errors import InputFileError
from prbench.files.bounded import read_whole
from prbench.limits import LARGEST_PICKLE
from prbench.readers.files import must_exist

# All opcodes that ``pickle`` writes for dictionaries of tensors, in the protocols 0 to 5. REDUCE calls what lies on the
# stack, and nothing can be called there but the functions that stand for names.
_OPCODES = frozenset((
    *("INT", "LONG", "LONG1", "BININT", "BININT1", "BININT2", "FLOAT", "BINFLOAT", "NONE", "NEWTRUE", "NEWFALSE"),
    *("UNICODE", "BINUNICODE", "SHORT_BINUNICODE", "BINBYTES", "SHORT_BINBYTES", "PROTO", "FRAME", "STOP", "MARK"),
    *("MEMOIZE", "PUT", "BINPUT", "LONG_BINPUT", "GET", "BINGET", "LONG_BINGET", "EMPTY_TUPLE", "TUPLE", "TUPLE1"),
    *("TUPLE2", "TUPLE3", "EMPTY_LIST", "LIST", "APPEND", "APPENDS", "EMPTY_DICT", "DICT", "SETITEM", "SETITEMS"),
    *("GLOBAL", "STACK_GLOBAL", "REDUCE"),
))  # fmt: skip
_ITEM_TYPES = {
    b"FloatStorage": "<f4", b"DoubleStorage": "<f8", b"HalfStorage": "<f2", b"LongStorage": "<i8",
    b"IntStorage": "<i4", b"ShortStorage": "<i2", b"CharStorage": "<i1", b"ByteStorage": "<u1",
}  # fmt: skip
_MACHINE = {"protocol_version": 1001, "little_endian": True, "type_sizes": {"short": 2, "int": 4, "long": 4}}
# All that torch writes before the numbers of one pickled storage: its stream's magic number, version and machine; the
# storage's kind, key (a memory address), device and size; and the list of keys. Nothing of it has to be run.
STORAGE = re.compile(
    b"".join(re.escape(pickle.dumps(part, protocol=2)) for part in (0x1950A86A20F9469CFC6C, 1001, _MACHINE))
    + rb"\x80\x02\(X\x07\0\0\0storageq\0ctorch\n(?P<kind>\w+)\nq\x01X(?P<length>.)\0\0\0(?P<key>\d+)q\x02"
    + rb"X.\0\0\0[a-z]+(?::\d+)?q\x03(?:K(?P<byte>.)|M(?P<short>..)|J(?P<long>....))Ntq\x04Q\."
    + rb"\x80\x02\]q\0X(?P=length)\0\0\0(?P=key)q\x01a\.",
    re.DOTALL,
)


class _Foreign(pickle.UnpicklingError):
    """A pickle asks for something that tensors do not need."""


def _refusing(opcode: str):
    def refuse(_: object) -> None:
        raise _Foreign(f"the opcode {opcode}")

    return refuse


class _TensorUnpickler(pickle._Unpickler):
    """Carries out the opcodes of pickled tensors on values that can do nothing."""

    dispatch = {  # noqa: RUF012 - the base class reads it as it is
        ord(opcode.code): pickle._Unpickler.dispatch[ord(opcode.code)]
        if opcode.name in _OPCODES
        else _refusing(opcode.name)
        for opcode in pickletools.opcodes
    }

    def __init__(self, content: bytes) -> None:
        super().__init__(io.BytesIO(content))
        self._left = LARGEST_PICKLE  # bytes; a program may hand the same storage in again and again

    def find_class(self, module: str, name: str) -> Any:
        """Return the function of ours that stands for a name."""
        match f"{module}.{name}":
            case "torch.storage._load_from_bytes":
                return self._storage
            case "torch._utils._rebuild_tensor_v2":
                return _tensor
            case "torch._utils._rebuild_parameter":
                return lambda tensor, *_: tensor  # what follows it concerns training
            case "collections.OrderedDict":  # a tensor's hooks, of which there are none
                return lambda: {}
            case foreign:
                raise _Foreign(f"the name '{foreign}'")

    def _storage(self, raw: bytes) -> np.ndarray:
        self._left -= len(raw)
        if self._left < 0:
            raise ValueError(f"storages of more than {LARGEST_PICKLE:,} bytes")
        head = STORAGE.match(raw)
        if head is None or head["length"][0] != len(head["key"]) or head["kind"] not in _ITEM_TYPES:
            raise _Foreign("a storage in another form than torch pickles it")
        size = int.from_bytes(head["byte"] or head["short"] or head["long"], "little")
        if int.from_bytes(raw[head.end() : head.end() + 8], "little") != size:
            raise ValueError(f"another number of numbers in a storage of {size}")
        return np.frombuffer(raw, _ITEM_TYPES[head["kind"]], size, head.end() + 8)


def _tensor(storage: np.ndarray, offset: int, shape: tuple[int, ...], strides: tuple[int, ...], *_: Any) -> np.ndarray:
    """Stand for ``torch._utils._rebuild_tensor_v2``; what follows the strides (gradient, hooks) concerns training."""
    size = math.prod(shape)
    # A stride of 0 shows one number many times: no format needs it, and a small file would unpack to any size.
    if size > storage.size:
        raise ValueError(f"a tensor of {size} numbers in a storage of {storage.size}")
    if size == 0:
        return np.zeros(shape, storage.dtype)
    item = storage.itemsize
    return np.ndarray(shape, storage.dtype, storage, offset * item, [stride * item for stride in strides])


def load_tensors(path: Path) -> dict[str, np.ndarray]:
    """Read the named tensors of a pickled dictionary.

    Returns:
        One array a name, of the tensor's shape and type (whole or floating-point numbers).

    Raises:
        InputFileError: if the file is missing, too large or damaged, holds an opcode or a name that tensors do not need
            (nothing of it is imported or run), or holds anything but a dictionary of tensors.
    """
    with must_exist(path):
        content = read_whole(path, largest=LARGEST_PICKLE)
    remedy = "Copy it again."
    try:
        loaded = _TensorUnpickler(content).load()
        if not isinstance(loaded, dict):
            raise TypeError(f"a {type(loaded).__name__}")
        for name, value in loaded.items():
            if not isinstance(value, np.ndarray):
                raise TypeError(f"a {type(value).__name__} as '{name}'")
    except Exception as error:  # the unpickler raises whatever a damaged program makes it stumble over
        if isinstance(error, _Foreign):
            remedy = "Nothing of it was run; do not open it with other programs."
        found = str(error) or type(error).__name__
        expected = "a pickled dictionary of torch tensors"
        raise InputFileError(path, "", expected=expected, found=found, remedy=remedy) from error
    return {str(name): array for name, array in loaded.items()}
