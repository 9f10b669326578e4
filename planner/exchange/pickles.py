"""Pickles of arrays, numbers, text, lists, tuples and dictionaries, read without executing any.

``pickle.load`` calls what a file names, and even an ``Unpickler`` that allows only NumPy lets a
file ask for a terabyte or overflow the stack in a hash. Here ``pickletools.genops`` decodes the
bytes, and a stack machine of twenty lines does the rest: it has no instruction that calls or
imports anything. The few names that stand for arrays make a record of what the file said, which
becomes an array when its bytes fit its shape. Every other name is refused, with its place.
"""

from __future__ import annotations

import pickletools
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import prod
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.errors import FileFormatError

MOST_ITEMS = 500_000
"""Instructions and values of a pickle, each value counted as often as it is referred to: at most
1.5 s, and 5,000 grasps of a dictionary of 50 numbers each."""

MOST_BYTES = 1 << 26
"""Memory (bytes) for arrays that a pickle may ask for: one list may become many arrays."""

LARGEST = 1 << 25
"""Largest pickle (bytes): a text with one rare character takes four times its bytes, and the file
and the member of an archive are there as well."""

LARGEST_KEY = 1 << 60
"""Integer keys are below, either sign: from 2^61 - 1 on hashes coincide, and a dictionary of such
keys takes a time that grows with their square."""

DEEPEST = 64
"""Levels of lists and dictionaries within each other."""

_PLAIN_DTYPE = re.compile(r"[<>|=]?(b1|\?|i[1248]|u[1248]|f[248]|[SUV][1-9]\d{0,6}|O8?)")

_MULTIARRAY = ("numpy.core.multiarray", "numpy._core.multiarray")
_NUMERIC = ("numpy.core.numeric", "numpy._core.numeric")

_NAMES: Mapping[str, str] = MappingProxyType(
    {
        "numpy.ndarray": "ndarray",
        "numpy.dtype": "dtype",
        **{f"{module}._reconstruct": "array" for module in _MULTIARRAY},
        **{f"{module}.scalar": "scalar" for module in _MULTIARRAY},
        **{f"{module}._frombuffer": "buffer" for module in _NUMERIC},
        "dill._dill._create_array": "array by dill",
        "pydrake.math.RigidTransform_[float]": "pose",
        "collections.OrderedDict": "dictionary",
        "_codecs.encode": "bytes",  # how protocol 2 tells bytes
    }
)
"""Name in a file, by the module paths of NumPy 1 and 2 -> what it may make."""


class _Refused(Exception):
    """Why a file is refused, without its name and place."""


@dataclass(frozen=True)
class _Maker:
    """A name of ``_NAMES`` on the stack: it is looked at, never called."""

    kind: str
    name: str


class _Mark:
    """Where a list of operands begins."""


@dataclass(eq=False)
class Budget:
    """Memory (bytes) and instructions that are left, for all pickles of a file together."""

    left: int = MOST_BYTES
    items: int = MOST_ITEMS

    def spend(self, amount: int) -> None:
        """Take some before it is asked for."""
        self.left -= amount
        if self.left < 0:
            raise _Refused(f"arrays of more than {MOST_BYTES} bytes")


@dataclass(eq=False)
class _Dtype:
    """Element type as the file tells it; its byte order may follow."""

    code: str

    def finish(self, state: Any) -> None:
        """Take the byte order of a state (version, order, subdtype, names, fields, ...)."""
        if not isinstance(state, tuple) or len(state) < 5 or state[1] not in tuple("<>|="):
            raise _Refused("an element type that is damaged")
        if any(part is not None for part in state[2:5]):
            raise _Refused("an array of records, and only plain ones are read")
        if self.code[0] not in "<>|=":
            self.code = state[1] + self.code

    @property
    def dtype(self) -> np.dtype[Any]:
        """The NumPy type."""
        return np.dtype(self.code)


@dataclass(eq=False)
class _Array:
    """An array as the file tells it; empty until its state follows."""

    budget: Budget
    values: NDArray[Any] | None = None

    def finish(self, state: Any) -> None:
        """Take a state (version, shape, element type, Fortran order, bytes or list)."""
        if self.values is not None or not isinstance(state, tuple) or len(state) != 5:
            raise _Refused("an array that is damaged")
        _, shape, dtype, fortran, data = state
        self.values = _array(data, dtype, shape, "F" if fortran else "C", self.budget)


@dataclass(eq=False)
class _Pose(_Array):
    """A pose of Drake: an array (3, 4) follows as its state."""

    def finish(self, state: Any) -> None:
        """Take the matrix."""
        values = state.values if isinstance(state, _Array) else None
        if values is None or values.shape != (3, 4) or values.dtype.kind != "f":
            raise _Refused("a pose that is damaged")
        self.values = values


def load_pickle(data: bytes, where: str, budget: Budget | None = None) -> Any:
    """The value of a pickle, nothing of which is executed.

    Args:
        data: The bytes; what follows the end of the pickle does not count.
        where: File and place, for messages.
        budget: What is left for this one; a whole one if None.

    Returns:
        None, bool, int, float, str, bytes, read-only array, or list, tuple or dictionary of these;
        NumPy numbers as Python's.

    Raises:
        FileFormatError: It is truncated or damaged, too large or too deep, or holds anything else;
            with the byte.
    """
    budget = budget or Budget()
    machine = _Machine(budget)
    place = 0
    try:
        if len(data) > LARGEST:
            raise _Refused(f"{len(data)} bytes, and {LARGEST} are read")
        for opcode, argument, position in pickletools.genops(data):
            place = position or 0
            budget.items -= 1
            if budget.items < 0:
                raise _Refused(f"more than {MOST_ITEMS} instructions")
            machine.do(opcode.name, argument)
        value = machine.result()
        return _Finisher().finish(value, 0)
    except _Refused as refused:
        raise FileFormatError(
            f"{where}, byte {place}: it holds {refused}; nothing of it was executed. Object arrays "
            "are pickles: arrays, numbers, text, lists, tuples and dictionaries are read. Save the "
            "grasps with these alone"
        ) from None
    except (ValueError, IndexError, KeyError, TypeError, AttributeError) as damage:
        raise FileFormatError(
            f"{where}, byte {place}: the pickle is truncated or damaged ({damage}); nothing of it "
            "was executed. Copy the file again"
        ) from None


class _Machine:
    """Stack and memo of a pickle; each instruction is a line of ``_OPERATIONS`` or of ``do``."""

    def __init__(self, budget: Budget) -> None:
        """Begin empty."""
        self.stack: list[Any] = []
        self.memo: dict[int, Any] = {}
        self.budget = budget
        self.stopped = False

    def do(self, name: str, argument: Any) -> None:
        """One instruction with its decoded argument."""
        if name in _LITERALS:
            # bytes are shared by all arrays that are made of them
            self.stack.append(bytes(argument) if isinstance(argument, bytearray) else argument)
        elif name in _CONSTANTS:
            self.stack.append(_CONSTANTS[name]())
        elif name in ("PUT", "BINPUT", "LONG_BINPUT"):
            self.memo[argument] = self.stack[-1]
        elif name == "MEMOIZE":
            self.memo[len(self.memo)] = self.stack[-1]
        elif name in ("GET", "BINGET", "LONG_BINGET"):
            self.stack.append(self.memo[argument])
        elif name == "GLOBAL":
            self.stack.append(_named(*argument.split(" ", 1)))
        elif name in _OPERATIONS:
            _OPERATIONS[name](self)
        elif name not in ("PROTO", "FRAME"):
            raise _Refused(f"the instruction {name}")

    def since_mark(self) -> list[Any]:
        """Take what was put since the last mark."""
        for i in reversed(range(len(self.stack))):
            if isinstance(self.stack[i], _Mark):
                taken = self.stack[i + 1 :]
                del self.stack[i:]
                return taken
        raise ValueError("no mark")

    def take(self, count: int) -> tuple[Any, ...]:
        """Take the last values."""
        if len(self.stack) < count:
            raise IndexError("empty stack")
        taken = tuple(self.stack[len(self.stack) - count :])
        del self.stack[len(self.stack) - count :]
        return taken

    def global_on_stack(self) -> None:
        """Put what a module and a name on the stack stand for."""
        module, name = self.take(2)
        self.stack.append(_named(module, name))

    def make(self) -> None:
        """What pickle would call: make a record instead."""
        maker, arguments = self.take(2)
        if not isinstance(maker, _Maker):
            raise _Refused(f"a call of {type(maker).__name__}")
        self.stack.append(_made(maker, arguments, self.budget))

    def finish(self) -> None:
        """Give a record its state."""
        state = self.stack.pop()
        record = self.stack[-1]
        if not isinstance(record, _Array | _Dtype):
            raise _Refused(f"a state for {type(record).__name__}")
        record.finish(state)

    def append(self, values: list[Any]) -> None:
        """Lengthen the list on the stack."""
        if not isinstance(self.stack[-1], list):
            raise ValueError("values are appended to something else than a list")
        self.stack[-1].extend(values)

    def insert(self, values: list[Any]) -> None:
        """Add keys and values to the dictionary on the stack."""
        if not isinstance(self.stack[-1], dict) or len(values) % 2:
            raise ValueError("keys are set on something else than a dictionary")
        for key, value in zip(values[::2], values[1::2], strict=True):
            if not isinstance(key, str | int):  # what else hashes may do so without end
                raise _Refused(f"a key that is a {type(key).__name__}, neither text nor a number")
            if isinstance(key, int) and abs(key) >= LARGEST_KEY:
                raise _Refused(f"a key that is an integer beyond {LARGEST_KEY}")
            self.stack[-1][key] = value

    def dictionary(self) -> None:
        """Make a dictionary of what was put since the last mark."""
        values = self.since_mark()
        self.stack.append({})
        self.insert(values)

    def stop(self) -> None:
        """The end."""
        self.stopped = True

    def result(self) -> Any:
        """What is left at the end."""
        if not self.stopped or len(self.stack) != 1:
            raise ValueError("it does not end")
        return self.stack[0]


_CONSTANTS: Mapping[str, Callable[[], Any]] = MappingProxyType(
    {
        "NONE": lambda: None,
        "NEWTRUE": lambda: True,
        "NEWFALSE": lambda: False,
        "EMPTY_LIST": list,
        "EMPTY_DICT": dict,
        "EMPTY_TUPLE": tuple,
        "MARK": _Mark,
    }
)

_LITERALS = frozenset(
    {
        *("INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4", "FLOAT", "BINFLOAT"),
        *("STRING", "BINSTRING", "SHORT_BINSTRING", "BINBYTES", "SHORT_BINBYTES", "BINBYTES8"),
        *("UNICODE", "BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8", "BYTEARRAY8"),
    }
)

_OPERATIONS: Mapping[str, Callable[[_Machine], Any]] = MappingProxyType(
    {
        "STOP": _Machine.stop,
        "POP": lambda m: m.stack.pop(),
        "POP_MARK": _Machine.since_mark,
        "DUP": lambda m: m.stack.append(m.stack[-1]),
        "STACK_GLOBAL": _Machine.global_on_stack,
        "REDUCE": _Machine.make,
        "NEWOBJ": _Machine.make,
        "BUILD": _Machine.finish,
        "TUPLE": lambda m: m.stack.append(tuple(m.since_mark())),
        "TUPLE1": lambda m: m.stack.append(m.take(1)),
        "TUPLE2": lambda m: m.stack.append(m.take(2)),
        "TUPLE3": lambda m: m.stack.append(m.take(3)),
        "LIST": lambda m: m.stack.append(m.since_mark()),
        "APPEND": lambda m: m.append([m.stack.pop()]),
        "APPENDS": lambda m: m.append(m.since_mark()),
        "DICT": _Machine.dictionary,
        "SETITEM": lambda m: m.insert(list(m.take(2))),
        "SETITEMS": lambda m: m.insert(m.since_mark()),
    }
)


def _named(module: Any, name: Any) -> _Maker:
    """What a name may make; refuses all that are not in ``_NAMES``."""
    if not isinstance(module, str) or not isinstance(name, str):
        raise _Refused("a name that is no text")
    full = f"{module}.{name}"
    if full not in _NAMES:
        raise _Refused(f"{full[:200]!r}, which is neither an array nor a plain value")
    return _Maker(_NAMES[full], full)


def _made(maker: _Maker, arguments: Any, budget: Budget) -> Any:
    """The record or value that a name makes of its arguments."""
    arguments = arguments if isinstance(arguments, tuple) else (arguments,)
    match maker.kind, arguments:
        case "dtype", (str(code), *_) if _PLAIN_DTYPE.fullmatch(code):
            return _Dtype(code)
        case "dtype", (str(code), *_):
            raise _Refused(f"elements of the type {code[:50]!r}")
        case "array", (_Maker(kind="ndarray"), *_):
            return _Array(budget)
        case "scalar", (_Dtype() as dtype, data) if not dtype.dtype.hasobject:
            return _array(data, dtype, (), "C", budget).item()
        case "buffer", (data, dtype, shape, str(order), *_) if order in ("C", "F"):
            return _Array(budget, _array(data, dtype, shape, order, budget))
        case "array by dill", (_Maker(kind="array") as inner, made, state, None):
            array = _made(inner, made, budget)
            array.finish(state)
            return array
        case "pose", ():
            return _Pose(budget)
        case "dictionary", ():
            return {}
        case "bytes", (str(text), "latin1" | "latin-1"):
            budget.spend(len(text))
            return text.encode("latin-1")
    raise _Refused(f"{maker.name} with what it does not take")


def _array(data: Any, dtype: Any, shape: Any, order: str, budget: Budget) -> NDArray[Any]:
    """An array whose size is proven by its data before memory is asked for."""
    if not isinstance(dtype, _Dtype):
        raise _Refused("an array without an element type")
    lengths = shape if isinstance(shape, tuple) else (shape,)
    if not all(isinstance(n, int) and 0 <= n < 2**40 for n in lengths) or len(lengths) > 16:
        raise _Refused("an array whose shape is damaged")
    kind = dtype.dtype
    size = prod(lengths)
    if kind.hasobject:
        if not isinstance(data, list) or len(data) != size:
            raise _Refused(f"an array of {size} objects, and tells others")
        budget.spend(64 * size)  # time counts too
        values = np.empty(size, dtype=object)
        for i, value in enumerate(data):
            values[i] = value
    else:
        if not isinstance(data, bytes | str) or len(data) != size * kind.itemsize:
            has = len(data) if isinstance(data, bytes | str) else "none"
            raise _Refused(f"an array of {size * kind.itemsize} bytes, and has {has}")
        if isinstance(data, str):  # of Python 2
            budget.spend(len(data))
            data = data.encode("latin-1")
        values = np.frombuffer(data, dtype=kind)
    return values.reshape(lengths, order="F" if order == "F" else "C")


class _Finisher:
    """Records become arrays; counts what the value holds, and how deep."""

    def __init__(self) -> None:
        """Nothing is known yet."""
        self.known: dict[int, tuple[Any, int, int]] = {}

    def finish(self, value: Any, depth: int) -> Any:
        """The value with arrays for records.

        Raises:
            _Refused: Too many items, too deep (a value that holds itself too), or a record that is
                not finished.
        """
        finished, count, _ = self._finished(value, depth)
        if count > MOST_ITEMS:
            raise _Refused(f"more than {MOST_ITEMS} values")
        return finished

    def _finished(self, value: Any, depth: int) -> tuple[Any, int, int]:
        """The finished value, how many values it holds, and its height."""
        if value is None or isinstance(value, bool | int | float | str | bytes):
            return value, 1, 0
        height = self.known[id(value)][2] if id(value) in self.known else 0
        if depth + height > DEEPEST:
            raise _Refused(f"more than {DEEPEST} levels within each other")
        if id(value) not in self.known:
            self.known[id(value)] = self._container(value, depth)
        return self.known[id(value)]

    def _container(self, value: Any, depth: int) -> tuple[Any, int, int]:
        """The same of what holds others."""
        if isinstance(value, _Array):
            if value.values is None:
                raise _Refused("an array without its values")
            return self._finished(value.values, depth)
        if isinstance(value, np.ndarray) and not value.dtype.hasobject:
            return value, 1, 0
        if isinstance(value, np.ndarray):
            parts = [self._finished(v, depth + 1) for v in value.reshape(-1)]
            array = np.empty(len(parts), dtype=object)
            for i, part in enumerate(parts):
                array[i] = part[0]
            out: Any = array.reshape(value.shape)
            out.flags.writeable = False
        elif isinstance(value, dict):
            parts = [self._finished(v, depth + 1) for v in value.values()]
            out = {key: part[0] for key, part in zip(value, parts, strict=True)}
        elif isinstance(value, list | tuple):
            parts = [self._finished(v, depth + 1) for v in value]
            out = type(value)(part[0] for part in parts)
        else:
            raise _Refused(f"a bare {getattr(value, 'name', type(value).__name__)}")
        count = 1 + sum(part[1] for part in parts)
        if count > MOST_ITEMS:
            raise _Refused(f"more than {MOST_ITEMS} values")
        return out, count, 1 + max((part[2] for part in parts), default=0)
