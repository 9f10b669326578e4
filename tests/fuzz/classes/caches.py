"""Cached pieces, fields, marks of soundness and proposals that were changed or planted."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from random import Random
from shutil import copytree

import numpy as np
import trimesh

from planner.describe import proposed_description
from planner.shapes import Mesh
from planner.shapes.pieces import convex_pieces
from planner.system.disk_cache import CACHE_VARIABLE, read_arrays, write_arrays, write_text

from ..hostile import array, damaged, text
from ..samples import Samples
from . import models


def case(rng: Random, samples: Samples) -> Callable[[], object]:
    warm = samples.folder / "warm"
    if not warm.exists():  # filled by the first case of a run
        made = Path(tempfile.mkdtemp(dir=samples.folder))
        os.environ[CACHE_VARIABLE] = str(made / "cache")
        (made / "hand.xml").write_text(models.mjcf(Random(0)), encoding="utf-8")
        trimesh.creation.box((0.03, 0.04, 0.05)).export(made / "part.stl")
        with contextlib.chdir(made):
            for use in USES.values():
                use()
        with suppress(OSError):  # another case was faster
            made.rename(warm)
    copytree(warm, ".", dirs_exist_ok=True)
    os.environ[CACHE_VARIABLE] = str(Path("cache").absolute())
    convex_pieces.cache_clear()
    kind = rng.choice(["pieces", "pieces", "sound", "proposal", "field"])
    for stored in sorted(Path("cache", kind).iterdir()):
        _spoil(stored, kind, rng)
    return USES[kind]


def _spoil(stored: Path, kind: str, rng: Random) -> None:
    arrays = read_arrays(kind, stored.stem)
    assert arrays is not None
    how = rng.randrange(8)
    if how == 0:
        stored.write_bytes(damaged(stored.read_bytes(), rng))
    elif how == 1:
        stored.write_bytes(rng.randbytes(rng.randrange(200)))
    elif how == 2:
        stored.unlink()
        place = rng.randrange(3)
        if place == 0:
            stored.mkdir()
        elif place == 1:
            os.mkfifo(stored)
        else:
            stored.symlink_to("/dev/zero")
    elif how == 3 and kind == "proposal":
        write_text(kind, stored.stem, text(rng).encode(errors="replace").decode())
    elif how == 4:
        stored.chmod(rng.choice([0, 0o666, 0o777]))
    else:
        for name in rng.sample(sorted(arrays), rng.randrange(1, len(arrays) + 1)):
            change = rng.randrange(5)
            value = arrays.pop(name)
            if change == 0:
                continue
            made = array(rng, *value.shape) if change < 3 else np.asarray(value) * 1.3
            try:
                arrays[name] = np.array(made)
                if arrays[name].dtype.kind == "O":
                    arrays[name] = value.ravel()
            except ValueError:
                arrays[name] = value[:0]
        write_arrays(kind, stored.stem, arrays)


def _pieces() -> object:
    mesh = Mesh.load("part.stl")
    convex_pieces.cache_clear()
    pieces = convex_pieces(mesh)
    assert len(pieces) == 1
    assert np.allclose(np.abs(pieces.vertices[0]).max(axis=0), [0.015, 0.02, 0.025])
    return pieces


def _field() -> object:
    field = Mesh.load("part.stl").field()
    assert np.isfinite(field.value(np.zeros((1, 3)))).all()
    return field


def _sound() -> object:
    return Mesh.load("part.stl")


def _proposal() -> object:
    return proposed_description("hand.xml")


USES: dict[str, Callable[[], object]] = {
    "pieces": _pieces,
    "field": _field,
    "sound": _sound,
    "proposal": _proposal,
}
