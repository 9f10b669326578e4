"""``.npy``, ``.npz`` and pickle files, read without executing anything that they hold.

The size that a file declares is compared with what it has before memory is asked for. Pickles are
read by another process with an allow-list and limits, ``planner.exchange.unpickle``.
"""

from __future__ import annotations

import atexit
import io
import os
import pickle
import signal
import subprocess
import sys
import threading
import zipfile
import zlib
from contextlib import suppress
from dataclasses import dataclass
from math import prod
from pathlib import Path
from tokenize import TokenError
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

import planner.exchange.unpickle as unpickle
from planner.errors import FileFormatError, NotFoundError
from planner.exchange.unpickle import DAMAGED, MEMORY, REPLY, REQUEST, SECONDS, VALUE

ARRAY_SUFFIXES = (".npy", ".npz", ".pkl", ".pickle", ".pt", ".pth")
"""How files end that are read here, or refused by name."""

MOST_BYTES = 1 << 27
"""Largest file (bytes), and half of the memory that an archive may take: a process that has loaded
all packages (205 MB) refuses a file at its last byte with less than 500 MB."""

OWN_BYTES = 1 << 30
"""The same of logs and states, which we write and nobody may find too large to be read: 3.5 hours
at 500 Hz, two million states. A hostile file may cost as much."""

MOST_MEMBERS = 4096
"""Most arrays of an archive (-): each costs 0.1 ms, whatever its size."""

SMALL = 1 << 22
"""Bytes of an array of names or text that becomes objects of Python, of some 60 bytes each."""

LARGEST_PICKLE = 1 << 25
"""Largest pickle (bytes)."""

MOST_ITEMS = 500_000
"""Values of all pickles of a file, each counted as often as it is referred to: 5,000 grasps of a
dictionary of 50 numbers each."""

_NPY, _ZIP, _TORCH_MAGIC = b"\x93NUMPY", b"PK\x03\x04", b"\x8a\x0al\xfc\x9cF\xf9 j\xa8P\x19."


def read_array_file(path: Path) -> Any:
    """What a ``.npy``, ``.npz`` or pickle file holds, by its content.

    Returns:
        An array; the one value of an array without dimensions; a dictionary of arrays of an
        ``.npz``; or the value of a pickle.

    Raises:
        FileFormatError: It is none of these, a PyTorch file, damaged, too large, or holds what
            would have to be executed.
        NotFoundError: There is no such file.
    """
    data = _bytes(path)
    if data.startswith(_NPY):
        array = _npy(data, str(path))
        return array.item() if array.ndim == 0 else array
    if data.startswith(_ZIP):
        return _npz(data, path)
    return load_pickle(data, str(path))


def read_npz(path: Path, most: int = MOST_BYTES) -> dict[str, NDArray[Any]]:
    """The arrays of an ``.npz`` file of at most so many bytes; raises as ``read_array_file``."""
    return _npz(_bytes(path, most), path, most)


def checked_small(array: NDArray[Any], what: str) -> NDArray[Any]:
    """An array that is about to become objects of Python; ``FileFormatError`` beyond ``SMALL``."""
    if array.nbytes > SMALL:
        raise FileFormatError(f"{what} has {array.nbytes} bytes and {SMALL} are read")
    return array


def read_pickle(path: Path) -> Any:
    """The value of a pickle file; raises as ``read_array_file``."""
    return load_pickle(_bytes(path), str(path))


@dataclass(eq=False)
class Budget:
    """Values that are left for all pickles of a file together."""

    items: int = MOST_ITEMS


class _Reader:
    """The process that reads pickles; made when it is needed, and again when it has died."""

    def __init__(self) -> None:
        """Nothing runs yet."""
        self._lock = threading.Lock()
        self.process: subprocess.Popen[bytes] | None = None
        self._owner = 0

    def ask(self, data: bytes, most: int) -> tuple[int, bytes, int]:
        """Kind of reply, its bytes and the values that were taken; why it died as ``MEMORY``."""
        with self._lock:
            process = self._started()
            assert process.stdin is not None and process.stdout is not None  # pipes, see below
            header = b""
            with suppress(BrokenPipeError):
                process.stdin.write(REQUEST.pack(len(data), most) + data)
                process.stdin.flush()
                header = process.stdout.read(REPLY.size)
            if len(header) == REPLY.size:
                kind, length, taken = REPLY.unpack(header)
                reply = process.stdout.read(length)
                if kind == MEMORY:
                    self.close()
                return kind, reply, taken
            died = process.wait()
            self.close()
        why = f"what takes more than {SECONDS} s to read"
        return MEMORY, (why if died == -signal.SIGPROF else "what breaks its reader").encode(), 0

    def _started(self) -> subprocess.Popen[bytes]:
        if self.process is None or self._owner != os.getpid():  # a copy of us has its own
            self._owner = os.getpid()
            self.process = subprocess.Popen(
                [sys.executable, "-P", unpickle.__file__],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
            )
            atexit.register(self.close)
        return self.process

    def close(self) -> None:
        """End it."""
        if self.process is None or self._owner != os.getpid():
            return
        for pipe in (self.process.stdin, self.process.stdout):
            with suppress(BrokenPipeError):
                if pipe is not None:
                    pipe.close()
        self.process.wait()
        self.process = None


READER = _Reader()


def load_pickle(data: bytes, where: str, budget: Budget | None = None) -> Any:
    """The value of a pickle, nothing of which is executed.

    Args:
        data: The bytes; what follows the end of the pickle does not count.
        where: File and place, for messages.
        budget: What is left for this one; a whole one if None.

    Returns:
        None, bool, int, float, str, bytes, array, or list, tuple or dictionary of these; NumPy
        numbers as Python's.

    Raises:
        FileFormatError: It is truncated or damaged, too large or too deep, or holds anything else.
    """
    budget = budget or Budget()
    if len(data) > LARGEST_PICKLE:
        raise FileFormatError(
            f"{where} has {len(data)} bytes, and pickles of {LARGEST_PICKLE} are read"
        )
    kind, reply, taken = READER.ask(data, budget.items)
    budget.items -= taken
    if kind == VALUE:
        return pickle.loads(reply)  # made by our own process, of plain values
    said = reply.decode(errors="replace")
    if kind == DAMAGED:
        raise FileFormatError(
            f"{where}: the pickle is truncated or damaged ({said}); nothing of it was executed. "
            "Copy the file again"
        )
    raise FileFormatError(
        f"{where}: it holds {said}; nothing of it was executed. Object arrays are pickles: arrays, "
        "numbers, text, lists, tuples and dictionaries are read. Save the grasps with these alone"
    )


def is_torch(data: bytes) -> bool:
    """Whether a file that begins with these bytes, or has them, is PyTorch's."""
    if data.startswith(_ZIP):
        return b"data.pkl" in data[:4096]
    return _TORCH_MAGIC in data[:64]


def _bytes(path: Path, most: int = MOST_BYTES) -> bytes:
    """All of a file, if it is not too large and not PyTorch's."""
    if not path.is_file():
        raise NotFoundError("file", str(path), (), "give the path of a file", is_path=True)
    if (size := path.stat().st_size) > most:
        raise FileFormatError(
            f"{path} has {size} bytes and {most} are read; split it into several files"
        )
    try:
        data = path.read_bytes()
    except OSError as error:
        raise FileFormatError(
            f"{path} cannot be read: {error.strerror}; give a file that can be"
        ) from error
    if is_torch(data) or path.suffix in (".pt", ".pth"):
        raise FileFormatError(
            f"{path} is a PyTorch file, a pickle of PyTorch's classes; it was not opened. Where "
            "PyTorch is installed, read it with torch.load(FILE, weights_only=True), turn its "
            "tensors into arrays with .cpu().numpy() and save them with numpy.save"
        )
    return data


def _npy(data: bytes, where: str, budget: Budget | None = None) -> NDArray[Any]:
    """The array of the bytes of an ``.npy`` file."""
    stream = io.BytesIO(data)
    try:
        version = npy.read_magic(stream)
        if version not in ((1, 0), (2, 0), (3, 0)):
            raise ValueError(f"version {version}; 1.0, 2.0 and 3.0 are read")
        read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        shape, fortran, dtype = read(stream)
        if any(n < 0 for n in shape):
            raise ValueError(f"the shape {shape}")
    except (ValueError, TypeError, SyntaxError, TokenError, RecursionError, MemoryError) as error:
        first = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise FileFormatError(
            f"{where} is no .npy file, or damaged in its header ({first}); copy the file again"
        ) from None
    begin = stream.tell()
    if dtype.hasobject:
        array = load_pickle(data[begin:], where, budget)
        if not isinstance(array, np.ndarray) or array.shape != tuple(shape):
            raise FileFormatError(
                f"{where} is damaged: its header tells an array of the shape {tuple(shape)}, its "
                f"content is {_said(array)}; copy the file again"
            )
        return array
    if not dtype.itemsize or len(data) - begin != prod(shape) * dtype.itemsize:
        raise FileFormatError(
            f"{where} is truncated or damaged: its header tells {prod(shape)} x {dtype.itemsize} "
            f"bytes and {len(data) - begin} follow; copy the file again"
        )
    values = np.frombuffer(data, dtype=dtype, offset=begin)
    return values.reshape(shape, order="F" if fortran else "C")


def _directory_bytes(data: bytes) -> int:
    """Size of the directory of a ZIP archive, by the record at its end; ``BadZipFile`` without."""
    end = data.rfind(b"PK\x05\x06", -(22 + 0xFFFF))
    if end < 0 or len(data) < end + 22 or data[max(0, end - 20) :].startswith(b"PK\x06\x07"):
        raise zipfile.BadZipFile("its end is missing, or that of an archive of the large kind")
    return int.from_bytes(data[end + 12 : end + 16], "little")


def _npz(data: bytes, path: Path, most: int = MOST_BYTES) -> dict[str, NDArray[Any]]:
    """The arrays of the bytes of an ``.npz`` file."""
    budget = Budget()
    try:
        # a name has some 20 bytes and an entry 46 more
        if (size := _directory_bytes(data)) > 256 * MOST_MEMBERS:
            raise FileFormatError(f"{path} has a directory of {size} bytes; split it")
        with zipfile.ZipFile(io.BytesIO(data)) as packed:
            members = packed.infolist()
            if len(members) > MOST_MEMBERS:
                raise FileFormatError(
                    f"{path} has {len(members)} arrays and {MOST_MEMBERS} are read; split it"
                )
            if any(
                m.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for m in members
            ):
                raise FileFormatError(f"{path} is packed otherwise than numpy.savez does")
            packs = [m.file_size for m in members if m.compress_type != zipfile.ZIP_STORED]
            # what is unpacked is there twice for a moment
            size = len(data) + sum(m.file_size for m in members) + max(packs, default=0)
            if size > 2 * most:
                raise FileFormatError(
                    f"{path} takes {size} bytes to unpack and {2 * most} are allowed; split it"
                )
            if any(m.filename.endswith("data.pkl") for m in members):
                raise FileFormatError(
                    f"{path} is a PyTorch file; save its tensors as arrays with numpy.save"
                )
            return {
                m.filename.removesuffix(".npy"): _npy(
                    packed.read(m), f"{path}, {m.filename}", budget
                )
                for m in members
            }
    # zipfile raises RuntimeError for encrypted members, NotImplementedError for other compressions
    except (zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError, EOFError) as error:
        raise FileFormatError(
            f"{path} is a damaged or encrypted .npz file ({error}); copy it again"
        ) from None


def _said(value: Any) -> str:
    """What a value is, in a few words."""
    if isinstance(value, np.ndarray):
        return f"an array of the shape {value.shape}"
    return f"a {type(value).__name__}"
