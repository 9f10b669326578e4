"""The process that reads pickles of others, with limits of time and memory; started as a script.

Names come from an allow-list: those that stand for arrays, numbers and dictionaries in files of
NumPy 1 and 2, dill and Drake. None of them runs anything that a file chooses. What else hashes,
nests or repeats without end ends at this process's limits, or breaks it and nothing else.

It imports NumPy alone. Requests and replies have a header each (``REQUEST``, ``REPLY``); a value
goes back as a pickle that was made here, of plain values.
"""

from __future__ import annotations

import collections
import io
import pickle
import resource
import signal
import struct
import sys
from typing import Any

import numpy as np
from numpy._core import multiarray

REQUEST, REPLY = struct.Struct("<QQ"), struct.Struct("<BQQ")
"""Bytes that follow and values that are left; kind of reply, bytes that follow, values taken."""

VALUE, REFUSED, DAMAGED, MEMORY = range(4)
"""Kinds of replies."""

SECONDS = 1.2
"""CPU time (s) of one pickle; with a start of this process below 2 s."""

BYTES = 160 << 20
"""Memory (bytes) beyond that of the process when it begins."""

LARGEST_KEY = 1 << 60
"""Integer keys are below, either sign: from 2^61 - 1 on hashes coincide."""

DEEPEST = 64
"""Levels of lists and dictionaries within each other."""


DAMAGES = (
    *(pickle.UnpicklingError, EOFError, ValueError, TypeError, AttributeError, LookupError),
    *(ArithmeticError, ImportError, SystemError, BufferError),
)
"""What damaged bytes make pickle and NumPy say."""


class Refused(Exception):
    """Why a pickle is refused."""


class _NdArray:
    """Stands for ``numpy.ndarray``, which no file may call."""


class _Pose:
    """A pose of Drake: an array (3, 4) follows as its state."""

    def __setstate__(self, state: Any) -> None:
        if not isinstance(state, np.ndarray) or state.shape != (3, 4) or state.dtype.kind != "f":
            raise Refused("a pose that is damaged")
        self.values = state


def _reconstruct(kind: Any, shape: Any, code: Any) -> Any:
    """An array that is empty until its state follows."""
    if kind is not _NdArray:
        raise Refused("an array of a class of its own")
    return multiarray._reconstruct(np.ndarray, (0,), b"b")


def _scalar(dtype: np.dtype[Any], *data: Any) -> Any:
    if dtype.hasobject:
        raise Refused("a number that is an object")
    return multiarray.scalar(dtype, *data)


def _of_buffer(data: Any, dtype: Any, shape: Any, order: Any, axes: Any = None) -> Any:
    """An array as protocol 5 tells it."""
    return np.frombuffer(data, dtype=dtype).reshape(shape, order=order)


def _of_dill(make: Any, arguments: Any, state: Any, attributes: Any) -> Any:
    """An array as dill writes it."""
    if make is not _reconstruct or attributes is not None:
        raise Refused("an array of dill with more than its values")
    array = _reconstruct(*arguments)
    array.__setstate__(state)
    return array


def _encode(text: str, codec: str) -> bytes:
    """Bytes as protocol 2 tells them."""
    if codec not in ("latin1", "latin-1"):
        raise Refused(f"bytes of the codec {codec!r}"[:80])
    return text.encode("latin-1")


NAMES: dict[str, Any] = {
    "numpy.ndarray": _NdArray,
    "numpy.dtype": np.dtype,
    **dict.fromkeys(
        ("numpy.core.multiarray._reconstruct", "numpy._core.multiarray._reconstruct"), _reconstruct
    ),
    **dict.fromkeys(("numpy.core.multiarray.scalar", "numpy._core.multiarray.scalar"), _scalar),
    **dict.fromkeys(
        ("numpy.core.numeric._frombuffer", "numpy._core.numeric._frombuffer"), _of_buffer
    ),
    "dill._dill._create_array": _of_dill,
    "pydrake.math.RigidTransform_[float]": _Pose,
    "collections.OrderedDict": collections.OrderedDict,
    "_codecs.encode": _encode,
}
"""Name in a file -> what it stands for."""


class _Unpickler(pickle.Unpickler):
    """Knows ``NAMES`` and no others."""

    def find_class(self, module: str, name: str) -> Any:
        """What a name stands for."""
        if (full := f"{module}.{name}") not in NAMES:
            raise Refused(f"{full[:200]!r}, which is neither an array nor a plain value")
        return NAMES[full]

    def persistent_load(self, pid: Any) -> Any:
        """What another file holds."""
        raise Refused("a value that is elsewhere")


class _Plain:
    """Copies values as plain ones, and counts them."""

    def __init__(self, most: int) -> None:
        self.left = self.most = most

    def of(self, value: Any, depth: int = 0) -> Any:
        """A value of None, bool, int, float, str, bytes, arrays, lists, tuples, dictionaries."""
        self.left -= 1
        if self.left < 0:
            raise Refused("more values than are read")
        if depth > DEEPEST:
            raise Refused(f"more than {DEEPEST} levels within each other")
        if isinstance(value, np.generic):
            value = value.item()
        if value is None or type(value) in (bool, int, float, str, bytes):
            return value
        if isinstance(value, bytearray):
            return bytes(value)
        if isinstance(value, _Pose):
            return self.of(value.values)
        if type(value) in (list, tuple):
            return type(value)([self.of(v, depth + 1) for v in value])
        if isinstance(value, dict):
            return {self._key(k): self.of(v, depth + 1) for k, v in value.items()}
        if type(value) is np.ndarray:
            return self._array(value, depth)
        what = getattr(value, "__name__", type(value).__name__)
        raise Refused(f"{what!r}, which is neither an array nor a plain value")

    def _key(self, key: Any) -> Any:
        if not isinstance(key, str | int) or (isinstance(key, int) and abs(key) >= LARGEST_KEY):
            raise Refused(f"a key that is neither text nor a small number, {type(key).__name__}")
        return key

    def _array(self, value: np.ndarray[Any, Any], depth: int) -> np.ndarray[Any, Any]:
        if value.dtype.names is not None or value.dtype.kind not in "biufSUVO":
            raise Refused(f"an array of elements of the type {value.dtype}"[:80])
        if not value.dtype.hasobject:
            return value
        out = np.empty(value.size, dtype=object)
        for i, part in enumerate(value.reshape(-1)):
            out[i] = self.of(part, depth + 1)
        return out.reshape(value.shape)


def answer(data: bytes, most: int) -> tuple[int, bytes, int]:
    """Kind of reply, its bytes, and how many values were taken."""
    plain = _Plain(most)
    try:
        value = plain.of(_Unpickler(io.BytesIO(data), encoding="latin1").load())
        return VALUE, pickle.dumps(value, protocol=5), plain.most - plain.left
    except Refused as refused:
        return REFUSED, str(refused).encode(), 0
    except (MemoryError, RecursionError):
        return MEMORY, b"what takes more memory than is allowed", 0
    except DAMAGES as damage:  # anything else ends this process
        return DAMAGED, str(damage)[:200].encode(errors="replace"), 0


def main() -> None:
    """Answer requests until there are no more."""
    if sys.platform == "linux":  # macOS heeds no such limit
        with open("/proc/self/statm", encoding="ascii") as stream:
            now = int(stream.read().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (now + BYTES, now + BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    while header := sys.stdin.buffer.read(REQUEST.size):
        length, most = REQUEST.unpack(header)
        data = sys.stdin.buffer.read(length)
        signal.setitimer(signal.ITIMER_PROF, SECONDS)
        kind, reply, taken = answer(data, most)
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        sys.stdout.buffer.write(REPLY.pack(kind, len(reply), taken) + reply)
        sys.stdout.buffer.flush()
        del data, reply


if __name__ == "__main__":
    main()
