"""A scene as the bytes that a page unpacks: JSON for the structure, a block of bytes for arrays.

An array stands in the JSON as ``{"$": [type, shape, offset]}``. Positions of vertices are 16-bit
steps within the box of their part (0.2 m: 3 um), so that a page stays small.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.pages.scene import Part, Scene

__all__ = ["pack", "scene_bytes"]

STEPS = 65535
"""Steps of a coordinate within a part's box."""

ALIGNMENT = 8
"""Bytes; arrays begin at multiples, as the browser's typed arrays require."""

_TYPES = {"float32": "f4", "float64": "f8", "uint16": "u2", "uint32": "u4", "uint8": "u1"}


def scene_bytes(scene: Scene, extra: Mapping[str, Any]) -> bytes:
    """A scene, and what a page's own scripts need, as bytes."""
    return pack({"scene": scene, "extra": dict(extra)})


def pack(tree: Any) -> bytes:
    """Plain data, dataclasses and arrays as bytes: length of the JSON (4), JSON, arrays."""
    blocks: list[bytes] = []
    plain = _plain(tree, blocks)
    text = json.dumps(plain, allow_nan=False, separators=(",", ":")).encode()
    text += b" " * (-(len(text) + 4) % ALIGNMENT)
    return len(text).to_bytes(4, "little") + text + b"".join(blocks)


def _plain(value: Any, blocks: list[bytes]) -> Any:
    if isinstance(value, Part):
        return _part(value, blocks)
    if isinstance(value, Scene):
        out = {f.name: _plain(getattr(value, f.name), blocks) for f in fields(value)}
        out["time"] = _array(np.asarray(value.time, np.float64), blocks)
        return out
    if isinstance(value, np.ndarray):
        return _small_or_array(value, blocks)
    if is_dataclass(value):
        return {f.name: _plain(getattr(value, f.name), blocks) for f in fields(value)}
    if isinstance(value, Mapping):
        return {str(k): _plain(v, blocks) for k, v in value.items()}
    if isinstance(value, frozenset | set):
        return sorted(value)
    if isinstance(value, list | tuple):
        return [_plain(v, blocks) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _small_or_array(values: NDArray[Any], blocks: list[bytes]) -> Any:
    """Up to 16 numbers are readable JSON, more are bytes; NaN needs bytes."""
    if values.ndim == 1 and values.size <= 16 and np.isfinite(values).all():
        return [float(v) for v in values]
    return _array(np.asarray(values, np.float32), blocks)


def _array(values: NDArray[Any], blocks: list[bytes]) -> dict[str, Any]:
    data = np.ascontiguousarray(values).tobytes()
    offset = sum(len(b) for b in blocks)
    blocks.append(data + b"\0" * (-len(data) % ALIGNMENT))
    return {"$": [_TYPES[values.dtype.name], list(values.shape), offset]}


def _part(part: Part, blocks: list[bytes]) -> dict[str, Any]:
    """A mesh with 16-bit coordinates; vertices at one place become one."""
    vertices = np.asarray(part.vertices, np.float64)
    low, size = vertices.min(axis=0), np.maximum(np.ptp(vertices, axis=0), 1e-9)
    steps = np.rint((vertices - low) / size * STEPS).astype(np.int64)
    key = (steps[:, 0] << 32) + (steps[:, 1] << 16) + steps[:, 2]
    _, first, number = np.unique(key, return_index=True, return_inverse=True)
    # in the order of the mesh, which compresses better
    order = np.argsort(first)
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    triangles = rank[number][np.asarray(part.triangles)]
    width = np.uint16 if len(order) <= STEPS else np.uint32
    return {
        "name": part.name,
        "joint": part.joint,
        "layer": part.layer,
        "low": [float(v) for v in low],
        "size": [float(v) for v in size],
        "vertices": _array(steps[first[order]].astype(np.uint16), blocks),
        "triangles": _array(triangles.astype(width), blocks),
        "colour": [float(v) for v in part.colour],
        "smooth": part.smooth,
    }
