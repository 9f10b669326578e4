"""Pickles are read without executing anything; the rest is refused by name and place."""

from __future__ import annotations

import io
import os
import pickle
import resource
import struct
import sys
import zipfile
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from planner.errors import FileFormatError, NotFoundError
from planner.exchange.array_files import (
    MOST_MEMBERS,
    READER,
    load_pickle,
    read_array_file,
    read_npz,
)

GRASP = {
    "obj_pose": np.array([0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0], dtype=np.float32),
    "obj_scale": np.float64(0.06),
    "obj_path": "objects/can",
    "names": ["a", "b"],
    "pair": (1, None, True),
    "grid": np.arange(6.0).reshape(2, 3).T,
    "inner": np.array([{"x": np.int64(3)}, None], dtype=object),
    "text": np.array(["ab", "c"]),
}


def _same(a: Any, b: Any) -> bool:
    """Whether two values are equal, arrays in them too."""
    if isinstance(b, np.ndarray):
        return (
            isinstance(a, np.ndarray)
            and a.shape == b.shape
            and a.dtype == b.dtype.newbyteorder("=")  # NumPy swaps bytes as it reads
            and all(_same(x, y) for x, y in zip(a.reshape(-1), b.reshape(-1), strict=True))
        )
    if isinstance(b, dict):
        return list(a) == list(b) and all(_same(a[k], b[k]) for k in b)
    if isinstance(b, list | tuple):
        return (
            type(a) is type(b)
            and len(a) == len(b)
            and all(_same(x, y) for x, y in zip(a, b, strict=True))
        )
    return bool(a == b) or (a != a and b != b)


@pytest.mark.parametrize("protocol", range(6))
def test_arrays_and_plain_values_come_back_from_every_protocol(protocol: int) -> None:
    assert _same(load_pickle(pickle.dumps(GRASP, protocol=protocol), "x"), GRASP)


@pytest.mark.parametrize("protocol", [2, 4])
def test_pickles_of_numpy_1_are_read(protocol: int) -> None:
    data = pickle.dumps(np.arange(3.0), protocol=protocol)
    text = b"numpy._core.multiarray"
    if protocol == 2:
        old = data.replace(text, b"numpy.core.multiarray")
    else:  # lengths are written before names, and the frame, which may be left out, has its own
        old = data[:2] + data[11:].replace(bytes([len(text)]) + text, b"\x15numpy.core.multiarray")
    assert old != data
    assert _same(load_pickle(old, "x"), np.arange(3.0))


def test_a_pose_of_drake_is_read_as_its_matrix() -> None:
    matrix = pickle.dumps(np.arange(12.0).reshape(3, 4), protocol=4)[2:-1]
    made = b"\x80\x04\x8c\x0cpydrake.math\x8c\x16RigidTransform_[float]\x93)\x81"
    assert _same(load_pickle(made + matrix + b"b.", "x"), np.arange(12.0).reshape(3, 4))
    with pytest.raises(FileFormatError, match="a pose that is damaged"):
        load_pickle(made + b"Nb.", "x")


def test_ordered_dictionaries_and_big_endian_numbers_are_read() -> None:
    value = OrderedDict(a=np.arange(3, dtype=">i4"), b=b"\x00")
    assert _same(load_pickle(pickle.dumps(value), "x"), dict(value))


@given(hnp.arrays(hnp.floating_dtypes() | hnp.integer_dtypes(), hnp.array_shapes(min_side=0)))
def test_any_array_of_numbers_comes_back(array: np.ndarray[Any, Any]) -> None:
    assert _same(load_pickle(pickle.dumps(array), "x"), array)
    assert _same(load_pickle(pickle.dumps([array, array]), "x"), [array, array])


class Calls:
    """An object whose pickle calls something."""

    def __init__(self, *reduced: Any) -> None:
        """Keep what is called, with what."""
        self.reduced = reduced

    def __reduce__(self) -> Any:
        """What pickle asks."""
        return self.reduced


def _evil(tmp_path: Path) -> dict[str, bytes]:
    """Pickles that would do something, each of which would leave a file."""
    command = f"touch {tmp_path / 'ran'}"
    nested = np.empty(1, dtype=object)
    nested[0] = {"deep": [Calls(os.system, (command,))]}
    made = f"__import__('pathlib').Path({str(tmp_path / 'ran')!r}).touch()"
    getattr_eval = (
        f"cbuiltins\ngetattr\n(cbuiltins\n__import__\n(S'builtins'\ntRS'eval'\ntR(S{made!r}\ntR."
    ).encode()
    return {
        "os.system": pickle.dumps(Calls(os.system, (command,))),
        "posix.system by text": f"cposix\nsystem\n(S'{command}'\ntR.".encode(),
        "builtins.getattr": getattr_eval,
        "builtins.eval": b"cbuiltins\neval\n(S'1'\ntR.",
        "nested": pickle.dumps(nested),
        "numpy testing": b"cnumpy.testing._private.utils\nrunstring\n(S'1'\n}tR.",
        "numpy load": b"cnumpy\nload\n(S'x.npy'\nNI01\ntR.",
        "numpy multiarray function": b"cnumpy._core.multiarray\nfromfile\n(S'x'\ntR.",
        "numpy f2py": b"cnumpy.f2py.capi_maps\nload_f2cmap_file\n(S'x'\ntR.",
        "dotted": b"\x80\x04\x8c\x05numpy\x8c\x0endarray.tofile\x93.",
        "inst": f"(S'{command}'\nios\nsystem\n.".encode(),
        "obj": f"(cos\nsystem\nS'{command}'\no.".encode(),
        "persistent": b"Pid\n.",
        "extension": b"\x82\x01.",
        "newobj": b"\x80\x02cnumpy\nndarray\n)\x81.",
        "called array": b"cnumpy\nndarray\n(I3\ntR.",
        "state of a name": b"cnumpy\nndarray\n}S'x'\nI1\nsb.",
        "subclass": b"cnumpy._core.multiarray\n_reconstruct\n(cnumpy\nmatrix\n(I0\ntS'b'\ntR.",
        "set": pickle.dumps({1, 2}),
        "bare name": b"cnumpy\ndtype\n.",
        "bytes of another codec": b"c_codecs\nencode\n(S'aa'\nS'zlib'\ntR.",
        "records": pickle.dumps(np.zeros(2, dtype=[("a", float)])),
        "date": pickle.dumps(np.zeros(2, dtype="M8[s]")),
    }


@pytest.mark.parametrize("name", list(_evil(Path("x"))))
def test_what_would_have_to_be_executed_is_refused(name: str, tmp_path: Path) -> None:
    data = _evil(tmp_path)[name]
    file = tmp_path / "grasps.npy"
    file.write_bytes(_npy_of(data))
    before = sorted(tmp_path.iterdir())
    with pytest.raises(FileFormatError, match=r"grasps\.npy: .*nothing of it was executed"):
        read_array_file(file)
    assert sorted(tmp_path.iterdir()) == before, "nothing may have run"


def test_the_tests_own_pickles_do_run_where_they_are_executed(tmp_path: Path) -> None:
    for name in ("os.system", "nested", "builtins.getattr"):
        pickle.loads(_evil(tmp_path)[name])
        assert (tmp_path / "ran").exists(), name
        (tmp_path / "ran").unlink()


def test_a_refusal_says_what_is_named() -> None:
    with pytest.raises(FileFormatError, match=r"'os\.system'|'posix\.system'|'nt\.system'"):
        load_pickle(pickle.dumps(Calls(os.system, ("true",))), "file")


def _laugh() -> bytes:
    """A list of two of a list of two of ..., forty deep."""
    value: list[Any] = [1]
    for _ in range(40):
        value = [value, value]
    return pickle.dumps(value)


def _deep_key() -> bytes:
    """A key whose hash would overflow the stack."""
    return b"})" + b"\x85" * 1_000_000 + b"I1\ns."


def _list_of_many_arrays() -> bytes:
    """One list of 100,000 values that becomes 5,000 arrays of 800 kB."""
    head = b"cnumpy\ndtype\n(S'O'\nI0\nI1\ntR(I3\nS'|'\nNNNI-1\nI-1\nI63\ntbp0\n0"
    many = b"(" + b"N" * 100_000 + b"lp1\n0"
    made = b"cnumpy._core.multiarray\n_reconstruct\np2\n0cnumpy\nndarray\np3\n0("
    one = b"g2\n(g3\n(I0\ntS'b'\ntR(I1\n(I100000\ntg0\nI0\ng1\ntb"
    return head + many + made + one * 5_000 + b"l."


BOMBS: dict[str, Callable[[], bytes]] = {
    "references": _laugh,
    "deep": lambda: b"]" * 5001 + b"a" * 5000 + b".",
    "deep key": _deep_key,
    "itself": lambda: b"]p0\nh\x00a.",
    "length of bytes": lambda: b"\x80\x04\x8e" + struct.pack("<Q", 1 << 60) + b"x.",
    "length of text": lambda: b"\x80\x04\x8d" + struct.pack("<Q", 1 << 60) + b"x.",
    "frame": lambda: b"\x80\x04\x95" + struct.pack("<Q", 1 << 60) + b"x.",
    "memo": lambda: b"Nr" + struct.pack("<I", 0xFFFFFFFF) + b"h\x05.",
    "digits": lambda: b"I" + b"9" * 100_000 + b"\n.",
    "shape": lambda: (
        b"cnumpy._core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(I0\ntS'b'\ntR(I1\n"
        b"(I1000000000\nI1000000000\ntcnumpy\ndtype\n(S'f8'\nI0\nI1\ntRI0\nS'x'\ntb."
    ),
    "objects": _list_of_many_arrays,
    "keys of one hash": lambda: (
        b"}("
        + b"".join(
            b"\x8a\x0a" + (i * (2**61 - 1)).to_bytes(10, "little") + b"N" for i in range(1, 50_000)
        )
        + b"u."
    ),
    "large text": lambda: b"X" + struct.pack("<I", 1 << 26) + b"a" * (1 << 26) + b".",
    "repr": lambda: b"\x80\x04" + _laugh()[2:-1] + b"\x8c\x01x\x93.",
}


def _children_cpu() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


@pytest.mark.parametrize("name", list(BOMBS))
def test_bombs_are_refused_at_a_bounded_price(name: str) -> None:
    bomb = BOMBS[name]()
    READER.close()
    before = _children_cpu()
    with pytest.raises(FileFormatError, match=r"^bomb"):
        load_pickle(bomb, "bomb")
    READER.close()
    assert _children_cpu() - before < 2.0, "s, with the start of the process"
    assert load_pickle(pickle.dumps([1]), "after") == [1], "the next file is read again"


@pytest.mark.skipif(sys.platform != "linux", reason="macOS heeds no limit of memory")
def test_the_reader_cannot_take_more_memory_than_it_may() -> None:
    load_pickle(pickle.dumps(1), "any")
    assert READER.process is not None
    limits = Path(f"/proc/{READER.process.pid}/limits").read_text(encoding="ascii")
    line = next(row for row in limits.splitlines() if row.startswith("Max address space"))
    assert int(line.split()[3]) < 400e6, "bytes, code and libraries among them"
    # what is refused for its memory is a value of 5,000 x 800 kB
    with pytest.raises(FileFormatError, match="more memory than is allowed"):
        load_pickle(BOMBS["objects"](), "bomb")


def test_a_pickle_cut_anywhere_is_refused() -> None:
    data = pickle.dumps(GRASP)
    for length in range(len(data)):
        with pytest.raises(FileFormatError, match=r"truncated or damaged|it holds"):
            load_pickle(data[:length], "cut")


@given(st.integers(0, 10_000), st.binary(min_size=1, max_size=8))
def test_damaged_bytes_never_do_more_than_be_refused(place: int, other: bytes) -> None:
    data = bytearray(pickle.dumps(GRASP))
    place %= len(data)
    data[place : place + len(other)] = other
    try:
        load_pickle(bytes(data), "damaged")
    except FileFormatError as error:
        assert str(error).startswith("damaged: ")


def _npy_of(pickled: bytes) -> bytes:
    """An .npy file of one object around a pickle."""
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        stream, {"descr": "|O", "fortran_order": False, "shape": ()}
    )
    return stream.getvalue() + pickled


def test_npy_files_of_objects_and_numbers_are_read(tmp_path: Path) -> None:
    np.save(tmp_path / "one.npy", np.array(GRASP, dtype=object))
    np.save(tmp_path / "many.npy", np.array([GRASP, GRASP], dtype=object))
    np.save(tmp_path / "numbers.npy", np.arange(6.0).reshape(2, 3).T)
    assert _same(read_array_file(tmp_path / "one.npy"), GRASP)
    assert _same(list(read_array_file(tmp_path / "many.npy")), [GRASP, GRASP])
    assert _same(read_array_file(tmp_path / "numbers.npy"), np.arange(6.0).reshape(2, 3).T)


def test_npz_and_pickle_files_are_read(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "a.npz", x=np.arange(3), o=np.array([{"k": 1}], dtype=object))
    found = read_npz(tmp_path / "a.npz")
    assert list(found) == ["x", "o"]
    assert found["o"][0] == {"k": 1}
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(GRASP))
    assert _same(read_array_file(tmp_path / "a.pkl"), GRASP)


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (lambda a: a[:-1], "truncated or damaged"),
        (lambda a: a + b"x", "truncated or damaged"),
        (lambda a: a[:9], "damaged in its header"),
        (lambda a: a.replace(b"(3,)", b"(9,)"), "truncated or damaged"),
        (lambda a: a.replace(b"(3,)", b"((("), "damaged in its header"),
        (lambda a: a[:6] + b"\x07\x00" + a[8:], "version"),
    ],
)
def test_damaged_npy_files_are_refused(
    made: Callable[[bytes], bytes], said: str, tmp_path: Path
) -> None:
    stream = io.BytesIO()
    np.save(stream, np.arange(3.0))
    (tmp_path / "a.npy").write_bytes(made(stream.getvalue()))
    with pytest.raises(FileFormatError, match=said):
        read_array_file(tmp_path / "a.npy")


def test_a_header_that_tells_more_than_the_pickle_has_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.npy").write_bytes(_npy_of(pickle.dumps(np.array([None, None]))))
    with pytest.raises(FileFormatError, match=r"shape \(\), its content is an array"):
        read_array_file(tmp_path / "a.npy")


def test_a_damaged_npz_is_refused(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "a.npz", x=np.arange(1000))
    data = (tmp_path / "a.npz").read_bytes()
    (tmp_path / "b.npz").write_bytes(data[:-30])
    (tmp_path / "c.npz").write_bytes(data[:200] + b"\x00" * 20 + data[220:])
    for name in ("b.npz", "c.npz"):
        with pytest.raises(FileFormatError, match="damaged"):
            read_npz(tmp_path / name)


def _archive(path: Path, packing: int, members: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w", packing, compresslevel=1) as packed:
        for name, data in members.items():
            packed.writestr(name, data)
    return path


def test_archives_that_cost_more_than_they_may_are_refused_before_they_are_unpacked(
    tmp_path: Path,
) -> None:
    zeros, one = bytes(1 << 27), pickle.dumps(np.array([None] * 200_000, dtype=object))
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        head, {"descr": "|O", "fortran_order": False, "shape": (200_000,)}
    )
    pack = zipfile.ZIP_DEFLATED
    for members, packing, said in (
        ({"x.npy": zeros, "y.npy": zeros}, pack, "bytes to unpack"),
        ({"x.npy": b"x"}, zipfile.ZIP_BZIP2, "packed otherwise"),
        ({f"{i}.npy": b"" for i in range(MOST_MEMBERS + 1)}, pack, "arrays and"),
        ({f"{i:0300}.npy": b"" for i in range(MOST_MEMBERS + 1)}, pack, "directory of"),
        ({f"{i}.npy": head.getvalue() + one for i in range(4)}, pack, "more values than"),
    ):
        path = _archive(tmp_path / "bomb.npz", packing, members)
        with pytest.raises(FileFormatError, match=said):
            read_npz(path)


def test_pytorch_files_are_refused_with_what_to_do(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as packed:
        packed.writestr("archive/data.pkl", b"x")
    (tmp_path / "b.pt").write_bytes(b"anything")
    (tmp_path / "c.npy").write_bytes(pickle.dumps(0x1950A86A20F9469CFC6C, protocol=2))
    for name in ("a.npz", "b.pt", "c.npy"):
        with pytest.raises(FileFormatError, match=r"PyTorch file.*weights_only=True"):
            read_array_file(tmp_path / name)


def test_a_file_that_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(NotFoundError, match="does not exist"):
        read_array_file(tmp_path / "none.npy")
