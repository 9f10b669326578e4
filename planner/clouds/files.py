"""Reading clouds and depth images: a path becomes a ``PointCloud``, or a named error.

=========  =========================================================================================
``.ply``   vertices, with normals and a property ``view`` if there are; ``comment view x y z`` names
           a camera's place, ``comment noise``, ``comment table`` say what they say, in m
``.pcd``   fields x, y, z, with normals if there are; ``VIEWPOINT``, unless at the origin, is a view
``.xyz``   a row of x y z, or x y z nx ny nz, per point; lines that begin with # are comments
``.npy``   an array (n, 3), or (n, 6) with normals
``.json``  depth images: ``{"views": [{"depth": "a.png", "K": [[fx, 0, cx], [0, fy, cy], [0, 0, 1]],
           "scale": 0.001, "T_world_camera": [[...], ...], "mask": "m.png"}], "noise": 0.002}``
=========  =========================================================================================

All lengths are m (``scale`` makes m of a depth image's numbers), z is up. A camera looks along its
z axis, x to the right and y down. Of a depth image, 0 and NaN are no depth; where there is a mask,
its pixels above 0 are the object, and rays outside of it went past.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from planner.arrays import checked_number
from planner.clouds.cloud import PointCloud
from planner.clouds.level import levelled
from planner.errors import ObjectError, shown
from planner.spatial import FloatArray

MOST_BYTES = 1 << 28
"""Largest file (bytes): five million points with normals and colours."""

LONGEST_HEADER = 1 << 16
"""Bytes within which the header of a PLY or PCD file ends."""

PLY_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"},
}
"""Types of PLY properties as NumPy writes them."""

PLY_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
"""Formats of PLY files and their byte order; "" for text."""


@dataclass(frozen=True, kw_only=True)
class _Header:
    """What a PLY or PCD file says of its points.

    Attributes:
        names: Columns.
        types: NumPy types of the columns, without byte order; for text too.
        order: Byte order; "" for text.
        count: Points.
        begin: Byte at which they begin.
        comments: Words of the comments, or of ``VIEWPOINT``.
        faces: Faces that follow.
    """

    names: tuple[str, ...]
    types: tuple[str, ...]
    order: str
    count: int
    begin: int
    comments: tuple[tuple[str, ...], ...] = ()
    faces: int = 0


def is_cloud_file(spec: str) -> bool:
    """Whether an object's specification is the path of a cloud, and not of a mesh or a plan.

    A PLY file is a cloud if it has no faces, a JSON file if it is none of ours, as plans are; a
    file that is missing or damaged is one if its suffix belongs to no other kind of object.
    """
    path = Path(spec)
    suffix = path.suffix.lower()
    if suffix not in READERS:
        return False
    if suffix not in (".ply", ".json"):
        return True
    try:
        with path.open("rb") as stream:
            head = stream.read(LONGEST_HEADER)
    except (OSError, ValueError):  # a null character in the name
        return suffix == ".json"
    if suffix == ".json":
        return b'"opposable-' not in head
    try:
        return _ply_header(path, head).faces == 0
    except ObjectError:
        return b"element face" not in head


def read_cloud(
    path: Path | str, *, noise: float | None = None, table: float | Literal["find"] | None = "find"
) -> PointCloud:
    """The cloud of a file; see the module.

    Args:
        path: The file.
        noise: Standard deviation of a point, m; that of the file if None, or estimated.
        table: Height of the table's top, m, to which the one that is seen is brought
            (``planner.clouds.level``); None for no table; "find" for that of the file, or the one
            that is seen.

    Raises:
        ObjectError: Missing, damaged, cut short, too large, or not a cloud; says what to do.
    """
    path = Path(path)
    if path.suffix.lower() not in READERS:
        raise ObjectError(f"{path.name!r} is no cloud; give one of {', '.join(READERS)}")
    try:
        if path.stat().st_size > MOST_BYTES:
            raise ObjectError(
                f"{path.name} has {path.stat().st_size >> 20} MB, and {MOST_BYTES >> 20} are read; "
                "thin it first: a point per mm is enough"
            )
        content = path.read_bytes()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ObjectError(f"cannot read the cloud {str(path)[:200]!r}: {reason}") from error
    found = READERS[path.suffix.lower()](path, content)
    if noise is not None:
        found["noise"] = noise
    known = found.pop("table", None) if table == "find" else table
    cloud = PointCloud.create(**found, table=None)
    return cloud if table is None else levelled(cloud, known)


def file_comments(path: Path) -> tuple[tuple[str, ...], ...]:
    """Words of the comments of a PLY file, () if it is none.

    Raises:
        ObjectError: It cannot be read.
    """
    if path.suffix.lower() != ".ply":
        return ()
    try:
        with path.open("rb") as stream:
            return _ply_header(path, stream.read(LONGEST_HEADER)).comments
    except OSError as error:
        raise ObjectError(f"cannot read the cloud {path}: {error.strerror}") from error


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthView:
    """A depth image and where it was taken.

    Attributes:
        depth: (h, w), m along the camera's axis; NaN without a depth.
        intrinsics: fx, fy, cx, cy, pixels; pixel (0, 0) has its centre at 0, 0.
        T_world_camera: (4, 4); z looks ahead, x to the right, y down.
        mask: (h, w), whether a pixel is the object; all of them if None.
    """

    depth: FloatArray
    intrinsics: tuple[float, float, float, float]
    T_world_camera: FloatArray
    mask: NDArray[np.bool_] | None = field(default=None)

    def points(self) -> FloatArray:
        """Points (h, w, 3) in the world, m; NaN without a depth."""
        fx, fy, cx, cy = self.intrinsics
        v, u = np.mgrid[: self.depth.shape[0], : self.depth.shape[1]].astype(np.float64)
        rays = np.stack([(u - cx) / fx, (v - cy) / fy, np.ones_like(u)], axis=-1)
        seen = self.depth[..., None] * rays
        return np.asarray(seen @ self.T_world_camera[:3, :3].T + self.T_world_camera[:3, 3])


def cloud_of_views(views: tuple[DepthView, ...] | list[DepthView], **more: Any) -> PointCloud:
    """The cloud that depth images show together.

    Args:
        views: At least one.
        more: Arguments of ``PointCloud.create``: noise, table.

    Raises:
        ObjectError: See ``PointCloud.create``.
    """
    return PointCloud.create(**_seen(views), **more)


def _seen(views: tuple[DepthView, ...] | list[DepthView]) -> dict[str, Any]:
    points, view_of, past, past_of = [], [], [], []
    for k, view in enumerate(views):
        seen = view.points().reshape(-1, 3)
        there = np.isfinite(seen).all(axis=1)
        mine = there if view.mask is None else there & view.mask.ravel()
        points.append(seen[mine])
        past.append(seen[there & ~mine])
        view_of.append(np.full(len(points[-1]), k))
        past_of.append(np.full(len(past[-1]), k))
    return {
        "points": np.concatenate(points),
        "views": np.array([view.T_world_camera[:3, 3] for view in views]),
        "view_of": np.concatenate(view_of),
        "past": np.concatenate(past),
        "past_of": np.concatenate(past_of),
        "one": all(view.mask is not None for view in views),
    }


# ---- text and tables


def _npy(path: Path, content: bytes) -> dict[str, Any]:
    return _columns(path, _array(path, content))


def _array(path: Path, content: bytes) -> NDArray[Any]:
    """The array of an ``.npy`` file, none of objects."""
    import io

    try:
        array: NDArray[Any] = np.load(io.BytesIO(content), allow_pickle=False)
    except (ValueError, OSError, EOFError, MemoryError, TypeError, SyntaxError) as error:
        raise ObjectError(
            f"{path.name} holds no array of numbers, or is cut short: {str(error)[:120]}; write it "
            "with numpy.save"
        ) from error
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu":
        kind = getattr(array, "dtype", type(array).__name__)
        raise ObjectError(f"{path.name} holds {kind}; give an array of numbers")
    return array


def _xyz(path: Path, content: bytes) -> dict[str, Any]:
    rows = [row.split() for row in content.splitlines() if row.strip()]
    rows = [row for row in rows if not row[0].startswith((b"#", b"//"))]
    widths = {len(row) for row in rows}
    if len(widths) > 1:
        raise ObjectError(
            f"{path.name} has rows of {sorted(widths)} numbers, or is cut short; give x y z, or "
            "x y z nx ny nz, in every row"
        )
    return _columns(path, _floats(path, rows, max(widths, default=3)))


def _floats(path: Path, rows: Any, width: int) -> FloatArray:
    try:
        return np.array(rows, dtype=np.float64).reshape(-1, width)
    except ValueError as error:
        raise ObjectError(
            f"{path.name} holds something else than numbers: {error}; write it again, with a dot "
            "in decimals and blanks in between"
        ) from error


def _columns(path: Path, array: NDArray[Any]) -> dict[str, Any]:
    if array.ndim != 2 or array.shape[1] not in (3, 6):
        raise ObjectError(
            f"{path.name} has the shape {array.shape}; give (n, 3), or (n, 6) with normals; of a "
            'depth image, a JSON file with its "views"'
        )
    values = array.astype(np.float64)
    return {"points": values[:, :3], "normals": values[:, 3:] if values.shape[1] == 6 else None}


# ---- PLY and PCD: a header of lines, then a table


def _ply(path: Path, content: bytes) -> dict[str, Any]:
    header = _ply_header(path, content[:LONGEST_HEADER])
    if header.faces:
        raise ObjectError(f"{path.name} is a mesh with {header.faces} faces; a cloud has none")
    found = _of_table(path, header, content)
    said: dict[str, list[tuple[str, ...]]] = {}
    for words in header.comments:
        said.setdefault(words[0] if words else "", []).append(words[1:])
    views = [row for row in said.get("view", ()) if len(row) == 3]
    if views:
        found["views"] = _floats(path, views, 3)
    for name in ("noise", "table"):
        if len(value := said.get(name, [()])[-1]) == 1:
            found[name] = None if value == ("none",) else float(_floats(path, [value], 1)[0, 0])
    return found


def _ply_header(path: Path, head: bytes) -> _Header:
    lines, begin = _lines(path, head, b"end_header")
    if not lines or lines[0] != ["ply"]:
        raise ObjectError(f"{path.name} does not begin as a PLY file; export it again")
    order, elements, comments = None, [], []
    columns: list[tuple[str, str]] = []
    for words in lines[1:]:
        match words:
            case ["format", kind, _] if kind in PLY_ORDERS:
                order = PLY_ORDERS[kind]
            case ["comment" | "obj_info", *rest]:
                comments.append(tuple(rest))
            case ["element", name, count] if count.isdigit():
                elements.append((name, int(count)))
            case ["property", kind, name] if kind in PLY_TYPES and len(elements) == 1:
                columns.append((name, PLY_TYPES[kind]))
            case ["property", *_] if len(elements) > 1:
                pass
            case ["end_header"] | []:
                pass
            case _:
                raise ObjectError(
                    f"{path.name}: {shown(' '.join(words))} is not understood in the header of a "
                    "cloud; export it again with x, y, z as properties of its vertices"
                )
    if order is None or not elements or elements[0][0] != "vertex":
        raise ObjectError(f"{path.name} does not begin with vertices; export it again")
    return _Header(
        names=tuple(name for name, _ in columns),
        types=tuple(kind for _, kind in columns),
        order=order,
        count=elements[0][1],
        begin=begin,
        comments=tuple(comments),
        faces=sum(count for name, count in elements if name == "face"),
    )


def _pcd(path: Path, content: bytes) -> dict[str, Any]:
    lines, begin = _lines(path, content[:LONGEST_HEADER], b"DATA")
    said = {words[0]: words[1:] for words in lines if words and not words[0].startswith("#")}
    missing = {"FIELDS", "SIZE", "TYPE", "DATA"} - set(said)
    kinds = {"I": "i", "U": "u", "F": "f"}
    count = said.get("POINTS", said.get("WIDTH", ["0"]))
    repeats = said.get("COUNT", ["1"] * len(said.get("FIELDS", ())))
    lists = [said.get(name, []) for name in ("FIELDS", "SIZE", "TYPE")] + [repeats]
    sound = len({len(one) for one in lists}) == 1 and set(lists[2]) <= set(kinds)
    digits = [*lists[1], *repeats, *count]
    if missing or not sound or not all(one.isdigit() for one in digits):
        raise ObjectError(
            f"{path.name}: its header lacks or garbles {', '.join(sorted(missing)) or 'a field'}; "
            "save it again as a PCD file of version 0.7"
        )
    form = " ".join(said["DATA"])
    if form not in ("ascii", "binary"):
        raise ObjectError(
            f"{path.name}: DATA {form!r} is not read; save it as ascii or binary "
            "(pcl_convert_pcd_ascii_binary)"
        )
    names, types = [], []
    for name, size, kind, times in zip(*lists, strict=True):
        if int(size) not in (1, 2, 4, 8) or int(times) > LONGEST_HEADER:
            raise ObjectError(f"{path.name}: {name} has SIZE {size} and COUNT {times}; save again")
        names += [name if times == "1" else f"{name}/{k}" for k in range(int(times))]
        types += [f"{kinds[kind]}{size}"] * int(times)
    order = "" if form == "ascii" else "<"
    header = _Header(
        names=tuple(names), types=tuple(types), order=order, count=int(count[0]), begin=begin
    )
    found = _of_table(path, header, content)
    viewpoint = _floats(path, [said.get("VIEWPOINT", ["0"] * 7)], 7)[0, :3]
    if viewpoint.any():
        found["views"] = viewpoint[None]
    return found


def _lines(path: Path, head: bytes, last: bytes) -> tuple[list[list[str]], int]:
    """Words of the lines of a header, to one that begins with a word, and where its body begins."""
    begin, lines = 0, []
    while (end := head.find(b"\n", begin)) >= 0:
        line, begin = head[begin:end], end + 1
        lines.append(line.decode("utf-8", "replace").split())
        if line.startswith(last):
            return lines, begin
    raise ObjectError(
        f"{path.name} has no line {last.decode()!r} in its first {LONGEST_HEADER >> 10} kB: it is "
        "not of this format, or cut short; export it again"
    )


def _of_table(path: Path, header: _Header, content: bytes) -> dict[str, Any]:
    """Points, and normals and views if there are, of the table behind a header."""
    names = header.names
    if not {"x", "y", "z"} <= set(names) or len(set(names)) != len(names):
        raise ObjectError(f"{path.name} has the columns {shown(names)}; x, y, z are needed, once")
    body = content[header.begin :]
    if header.order:
        row = np.dtype([(n, header.order + t) for n, t in zip(names, header.types, strict=True)])
        there = len(body) // row.itemsize
    else:
        words = body.split()
        there = len(words) // len(names)
    if there < header.count:
        raise ObjectError(
            f"{path.name} is cut short: it announces {header.count} points and has {there}; write "
            "it again"
        )
    if header.order:
        table = np.frombuffer(body, row, header.count)
        column = {name: table[name].astype(np.float64) for name in names}
    else:
        values = _floats(path, words[: header.count * len(names)], len(names))
        column = dict(zip(names, values.T, strict=True))
    found: dict[str, Any] = {"points": np.stack([column[n] for n in "xyz"], axis=1)}
    for normal in (("nx", "ny", "nz"), ("normal_x", "normal_y", "normal_z")):
        if set(normal) <= set(names):
            found["normals"] = np.stack([column[n] for n in normal], axis=1)
    if "view" in names:
        found["view_of"] = column["view"].astype(np.int64)
    return found


# ---- depth images


def _images(path: Path, content: bytes) -> dict[str, Any]:
    try:
        data = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise ObjectError(f"{path.name} is no JSON file: {str(error)[:120]}") from error
    listed = data.get("views") if isinstance(data, dict) else None
    if not isinstance(listed, list) or not listed:
        raise ObjectError(
            f'{path.name} lists no "views"; give {{"views": [{{"depth": "depth.png", "K": '
            '[...], "T_world_camera": [...]}]}'
        )
    _known(path.name, data, {"views", "noise", "table"})
    table = data.get("table")
    if table not in (None, "find") and type(table) not in (int, float):
        raise ObjectError(
            f'{path.name}: table is {shown(table)}; give its height in m, null for none, or "find"'
        )
    found = _seen([_view(path, view, k) for k, view in enumerate(listed)])
    return found | {name: data[name] for name in ("noise", "table") if name in data}


def _view(path: Path, data: Any, k: int) -> DepthView:
    where = f"{path.name}: view {k}"
    if not isinstance(data, dict) or not {"depth", "K", "T_world_camera"} <= set(data):
        raise ObjectError(f"{where} needs depth (a file), K (3, 3) and T_world_camera (4, 4)")
    _known(where, data, {"depth", "K", "T_world_camera", "scale", "mask"})
    for name in ("depth", "mask"):
        if not isinstance(data.get(name, ""), str):
            raise ObjectError(f"{where}: {name} is {shown(data[name])}; give the name of a file")
    K = _matrix(where, "K", data["K"], 3)
    T = _matrix(where, "T_world_camera", data["T_world_camera"], 4)
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    if not (fx > 0 and fy > 0 and np.array_equal(K[2], [0.0, 0.0, 1.0])):
        raise ObjectError(
            f"{where}: K has the focal lengths {fx:g}, {fy:g} and the last row {K[2].tolist()}; "
            "give [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] in pixels"
        )
    scale = checked_number(f"{where}: scale", data.get("scale", 1.0), above=0.0, error=ObjectError)
    image = _image(path.parent / str(data["depth"])) * scale
    mask = _image(path.parent / str(data["mask"])) > 0 if "mask" in data else None
    if mask is not None and mask.shape != image.shape:
        raise ObjectError(f"{where}: the mask is {mask.shape}, the depth {image.shape}; make equal")
    image[~(np.isfinite(image) & (image > 0))] = np.nan
    return DepthView(depth=image, intrinsics=(fx, fy, cx, cy), T_world_camera=T, mask=mask)


def _matrix(where: str, name: str, value: Any, n: int) -> FloatArray:
    try:
        matrix = np.array(value, dtype=np.float64)
    except (ValueError, TypeError):
        matrix = np.zeros(0)
    if matrix.shape != (n, n) or not np.isfinite(matrix).all():
        raise ObjectError(f"{where}: {name} is {shown(value)}; give ({n}, {n}) finite numbers")
    turn = matrix[:3, :3]
    rigid = np.allclose(turn @ turn.T, np.eye(3), atol=1e-3) and np.linalg.det(turn) > 0.0
    if n == 4 and not (rigid and np.array_equal(matrix[3], [0.0, 0.0, 0.0, 1.0])):
        raise ObjectError(
            f"{where}: {name} is no pose, its rotation is not orthogonal and right-handed or its "
            "last row not 0, 0, 0, 1; invert?"
        )
    return matrix


def _known(where: str, data: dict[str, Any], names: set[str]) -> None:
    """Refuse fields that nothing reads.

    Raises:
        ObjectError: There are some.
    """
    if unknown := sorted(set(data) - names):
        raise ObjectError(f"{where} has {shown(unknown)}; give some of {sorted(names)}")


def _image(path: Path) -> FloatArray:
    """A PNG or ``.npy`` image of one channel as numbers (h, w)."""
    from PIL import Image, UnidentifiedImageError

    try:
        if path.suffix.lower() == ".npy":
            array = _array(path, path.read_bytes())
        else:
            with Image.open(path) as image:
                array = np.asarray(image)
    except (OSError, ValueError, UnidentifiedImageError, Image.DecompressionBombError) as error:
        raise ObjectError(f"cannot read the image {path}: {str(error)[:120]}") from error
    if array.ndim != 2:
        raise ObjectError(f"{path.name} has the shape {array.shape}; give one channel (h, w)")
    return array.astype(np.float64)


READERS: dict[str, Callable[[Path, bytes], dict[str, Any]]] = {
    ".ply": _ply,
    ".pcd": _pcd,
    ".xyz": _xyz,
    ".npy": _npy,
    ".json": _images,
}
"""What reads a file, by its suffix in lower case, as arguments of ``PointCloud.create``."""
