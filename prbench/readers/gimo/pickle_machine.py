"""A machine that carries out the opcodes of pickled tensors and no others, on values that can do nothing.

A pickle is a program. Python's own unpickler imports what the program names, calls it, and sets attributes of it
(opcode BUILD), even where ``find_class`` knows a few names only; its memo grows to any index that a file names. Here
a name stands for a :class:`Name` of ours, a call for a function of ours, and BUILD reaches :class:`Unfinished` values
alone. Every opcode takes a byte and adds at most one value, so that the size of the file bounds stack, memo and time.
The standard library's disassembler, which runs nothing, tells the opcodes and their arguments.
"""

from __future__ import annotations

import io
import pickle
import pickletools
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
