"""A machine that carries out the opcodes of pickled tensors and no others, on values that can do nothing.

A pickle is a program. Python's own unpickler imports what the program names, calls it, and sets attributes of it
(opcode BUILD), even where ``find_class`` knows a few names only; its memo grows to any index that a file names. Here
a name stands for a :class:`Name` of ours, a call for a function of ours, and BUILD reaches :class:`Unfinished` values
alone. Every opcode takes a byte and adds at most one value, so that the size of the file bounds stack, memo and time.
"""

from __future__ import annotations

import pickle
import pickletools
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any


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
        self._begin(0)

    def _begin(self, position: int) -> None:
        self.position = position
        self._opcode_at = position
        self._stack: list[Any] = []
        self._below: list[list[Any]] = []  # stacks that lie under the marks
        self._memo: dict[int, Any] = {}

    def run(self, position: int = 0) -> Any:
        """Return the value of the pickle that begins at a position; ``self.position`` is then behind its end.

        Raises:
            PickleRefused: for whatever pickled tensors do not hold, with the position of the opcode.
        """
        self._begin(position)
        try:
            self._carry_out()
            return self._stack.pop()
        except PickleRefused as error:
            error.position = self._opcode_at
            raise
        except (IndexError, KeyError, ValueError, TypeError, OverflowError, struct.error) as error:
            # What a damaged program does to a stack: it takes from an empty one, or asks for what was never kept.
            if self.position >= len(self._content):
                raise PickleRefused("the end of the file before the pickle's own end", self._opcode_at) from error
            found = f"an opcode {self._opcode_name()} that does not fit ({type(error).__name__}: {error})"
            raise PickleRefused(found, self._opcode_at) from error

    def _carry_out(self) -> None:
        content = self._content
        opcodes = _OPCODES
        while True:
            at = self._opcode_at = self.position
            self.position = at + 1
            code = content[at]
            if code == _STOP:
                return
            opcodes[code](self)

    def _opcode_name(self) -> str:
        code = self._content[self._opcode_at] if self._opcode_at < len(self._content) else 0
        return next((known.name for known in pickletools.opcodes if known.code == chr(code)), f"0x{code:02x}")

    # Bytes of the program

    def _take(self, size: int) -> bytes:
        begin = self.position
        self.position = begin + size
        taken = self._content[begin : self.position]
        if len(taken) < size:
            raise PickleRefused("the end of the bytes before the pickle's own end")
        return taken

    def _take_byte(self) -> int:
        return self._take(1)[0]

    def _take_size(self) -> int:
        return int.from_bytes(self._take(4), "little")

    def _take_line(self) -> bytes:
        end = self._content.index(b"\n", self.position)
        line = self._content[self.position : end]
        self.position = end + 1
        return line

    # Opcodes: marks, stack and memo

    def _unknown(self) -> None:
        raise PickleRefused(f"the opcode {self._opcode_name()}", foreign=True)

    def _mark(self) -> None:
        self._below.append(self._stack)
        self._stack = []

    def _since_mark(self) -> list[Any]:
        items = self._stack
        self._stack = self._below.pop()
        return items

    def _proto(self) -> None:
        protocol = self._take_byte()
        if protocol > pickle.HIGHEST_PROTOCOL:
            raise PickleRefused(f"protocol {protocol}")

    def _frame(self) -> None:
        self._take(8)

    def _push(self, value: Any) -> None:
        self._stack.append(value)

    def _memoize(self) -> None:
        self._memo[len(self._memo)] = self._stack[-1]

    def _binput(self) -> None:
        self._memo[self._content[self.position]] = self._stack[-1]
        self.position += 1

    def _binget(self) -> None:
        self._stack.append(self._memo[self._content[self.position]])
        self.position += 1

    def _long_binput(self) -> None:
        self._memo[self._take_size()] = self._stack[-1]

    def _long_binget(self) -> None:
        self._push(self._memo[self._take_size()])

    def _put(self) -> None:
        self._memo[int(self._take_line())] = self._stack[-1]

    def _get(self) -> None:
        self._push(self._memo[int(self._take_line())])

    # Opcodes: plain values

    def _int(self) -> None:
        line = self._take_line()
        self._push({b"00": False, b"01": True}.get(line) if line in (b"00", b"01") else int(line))

    def _long(self) -> None:
        self._push(int(self._take_line().removesuffix(b"L")))

    def _long1(self) -> None:
        self._push(int.from_bytes(self._take(self._take_byte()), "little", signed=True))

    def _binint(self) -> None:
        self._push(int.from_bytes(self._take(4), "little", signed=True))

    def _binint1(self) -> None:
        self._stack.append(self._content[self.position])
        self.position += 1

    def _binint2(self) -> None:
        self._push(int.from_bytes(self._take(2), "little"))

    def _float(self) -> None:
        self._push(float(self._take_line()))

    def _binfloat(self) -> None:
        self._push(struct.unpack(">d", self._take(8))[0])

    def _unicode(self) -> None:
        self._push(self._take_line().decode("raw-unicode-escape"))

    def _binunicode(self) -> None:
        self._push(self._take(self._take_size()).decode("utf-8", "surrogatepass"))

    def _short_binunicode(self) -> None:
        self._push(self._take(self._take_byte()).decode("utf-8", "surrogatepass"))

    def _binbytes(self) -> None:
        self._push(self._take(self._take_size()))

    def _short_binbytes(self) -> None:
        self._push(self._take(self._take_byte()))

    # Opcodes: containers

    def _tuple(self) -> None:
        items = self._since_mark()
        self._stack.append(tuple(items))

    def _tuple_of(self, size: int) -> None:
        if len(self._stack) < size:
            raise IndexError("the stack is empty")
        items = tuple(self._stack[-size:])
        del self._stack[-size:]
        self._stack.append(items)

    def _list(self) -> None:
        items = self._since_mark()
        self._push(items)

    def _append(self) -> None:
        item = self._stack.pop()
        self._top(list).append(item)

    def _appends(self) -> None:
        items = self._since_mark()
        self._top(list).extend(items)

    def _dict(self) -> None:
        items = self._since_mark()
        self._push({})
        self._set(items)

    def _setitem(self) -> None:
        value = self._stack.pop()
        key = self._stack.pop()
        self._set([key, value])

    def _setitems(self) -> None:
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

    # Opcodes: names, calls, states

    def _global(self) -> None:
        module = self._take_line().decode("ascii", "replace")
        self._push(self._named(module, self._take_line().decode("ascii", "replace")))

    def _stack_global(self) -> None:
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

    def _reduce(self) -> None:
        arguments = self._stack.pop()
        called = self._stack.pop()
        if not isinstance(called, Name) or type(arguments) is not tuple:
            raise PickleRefused(f"a call of a {type(called).__name__}", foreign=True)
        if called.make is None:
            raise PickleRefused(f"the name '{called.text}', called", foreign=True)
        self._push(called.make(*arguments))

    def _build(self) -> None:
        state = self._stack.pop()
        target = self._stack[-1]
        if not isinstance(target, Unfinished):
            raise PickleRefused(f"the opcode BUILD on a {type(target).__name__}", foreign=True)
        target.fill(state)

    def _binpersid(self) -> None:
        if self._persistent is None:
            raise PickleRefused("a persistent id", foreign=True)
        self._push(self._persistent(self._stack.pop()))


_STOP = pickle.STOP[0]

_KNOWN: dict[bytes, Callable[[PickleMachine], None]] = {
    pickle.PROTO: PickleMachine._proto,
    pickle.FRAME: PickleMachine._frame,
    pickle.MARK: PickleMachine._mark,
    pickle.MEMOIZE: PickleMachine._memoize,
    pickle.BINPUT: PickleMachine._binput,
    pickle.BINGET: PickleMachine._binget,
    pickle.LONG_BINPUT: PickleMachine._long_binput,
    pickle.LONG_BINGET: PickleMachine._long_binget,
    pickle.PUT: PickleMachine._put,
    pickle.GET: PickleMachine._get,
    pickle.NONE: lambda machine: machine._push(None),
    pickle.NEWTRUE: lambda machine: machine._push(True),
    pickle.NEWFALSE: lambda machine: machine._push(False),
    pickle.INT: PickleMachine._int,
    pickle.LONG: PickleMachine._long,
    pickle.LONG1: PickleMachine._long1,
    pickle.BININT: PickleMachine._binint,
    pickle.BININT1: PickleMachine._binint1,
    pickle.BININT2: PickleMachine._binint2,
    pickle.FLOAT: PickleMachine._float,
    pickle.BINFLOAT: PickleMachine._binfloat,
    pickle.UNICODE: PickleMachine._unicode,
    pickle.BINUNICODE: PickleMachine._binunicode,
    pickle.SHORT_BINUNICODE: PickleMachine._short_binunicode,
    pickle.BINBYTES: PickleMachine._binbytes,
    pickle.SHORT_BINBYTES: PickleMachine._short_binbytes,
    pickle.EMPTY_TUPLE: lambda machine: machine._push(()),
    pickle.TUPLE: PickleMachine._tuple,
    pickle.TUPLE1: lambda machine: machine._tuple_of(1),
    pickle.TUPLE2: lambda machine: machine._tuple_of(2),
    pickle.TUPLE3: lambda machine: machine._tuple_of(3),
    pickle.EMPTY_LIST: lambda machine: machine._push([]),
    pickle.LIST: PickleMachine._list,
    pickle.APPEND: PickleMachine._append,
    pickle.APPENDS: PickleMachine._appends,
    pickle.EMPTY_DICT: lambda machine: machine._push({}),
    pickle.DICT: PickleMachine._dict,
    pickle.SETITEM: PickleMachine._setitem,
    pickle.SETITEMS: PickleMachine._setitems,
    pickle.GLOBAL: PickleMachine._global,
    pickle.STACK_GLOBAL: PickleMachine._stack_global,
    pickle.REDUCE: PickleMachine._reduce,
    pickle.BUILD: PickleMachine._build,
    pickle.BINPERSID: PickleMachine._binpersid,
}
"""All opcodes that ``pickle`` and ``torch.save`` write for dictionaries of tensors, in the protocols 0 to 5."""

_OPCODES = [_KNOWN.get(bytes([code]), PickleMachine._unknown) for code in range(256)]
