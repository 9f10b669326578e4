"""Where a model to be checked comes from: a file, a spec or a compiled model."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco

from planner.bridge import compile_spec, load_spec
from planner.bridge.load import compile_balanced
from planner.bridge.numbers import impossible_inertias, worst_inertia
from planner.bridge.structure import read_spec
from planner.errors import ModelError
from planner.hand_loading import load_hand
from planner.hands.catalog import find_hand

DESCRIPTION = ".toml"
"""How the name of a file ends that describes a hand and is no model."""

BALANCED = (
    "some inertias are impossible (the largest moment exceeds the sum of the others) and were "
    "balanced by MuJoCo: compared is the balanced model"
)
"""Note on a model that MuJoCo refuses as it is."""


@dataclass(frozen=True, kw_only=True)
class Source:
    """A model, ready to be compared.

    Attributes:
        name: For tables.
        model: ``mujoco.MjModel``.
        spec: ``mujoco.MjSpec`` that it was compiled from; None if a compiled model was given.
        path: The file that Pinocchio's own reader gets; None if there is no file.
        notes: What had to be changed before MuJoCo took the model.
    """

    name: str
    model: Any
    spec: Any
    path: Path | None
    notes: tuple[str, ...] = ()


def compiled(model: Any) -> Source:
    """Compile what was given, and note inertias that no body can have: engines read them alike.

    Args:
        model: Path of an MJCF or URDF file, a hand as for ``load_hand``, ``mujoco.MjSpec`` or
            ``mujoco.MjModel``.

    Raises:
        NotFoundError: There is no such file or hand.
        ModelError: MuJoCo cannot read or compile it, or it is none of these.
    """
    source = _compiled(model)
    impossible = impossible_inertias(source.model)
    if not impossible:
        return source
    note = (
        f"{worst_inertia(impossible)}: correct it in the model, or, for a hand, write "
        "inertia_from_geometry under [repair] in its hand.toml (opposable describe does)"
    )
    return replace(source, notes=(*source.notes, note))


def stated_velocities(source: Source) -> dict[str, float] | None:
    """Joint -> largest speed that a URDF states, rad/s or m/s; None for models of other kinds."""
    if source.path is None:
        return None
    root = ElementTree.parse(source.path).getroot()  # MuJoCo has read it before
    if root.tag != "robot":
        return None
    limits = {j.get("name", ""): j.find("limit") for j in root.findall("joint")}
    out = {}
    for name, limit in limits.items():
        if limit is None:
            continue
        text = limit.get("velocity", "inf")
        try:
            out[name] = float(text)
        except ValueError as error:
            raise ModelError(
                f"{source.path}: the velocity limit of joint {name!r} is {text!r}; give a number"
            ) from error
    return out


def _compiled(model: Any) -> Source:
    if isinstance(model, mujoco.MjModel):
        return Source(name="model", model=model, spec=None, path=None)
    if isinstance(model, mujoco.MjSpec):
        spec = read_spec(model)
        name = spec.modelname or "model"
        return Source(name=name, model=compile_spec(spec, name), spec=spec, path=None)
    if not isinstance(model, str | Path):
        raise ModelError(
            f"a {type(model).__name__} is no model; give the path of an MJCF or URDF file, a "
            "mujoco.MjSpec or a mujoco.MjModel"
        )
    path = Path(model)
    if not os.path.isfile(path) or path.suffix == DESCRIPTION:
        path = find_hand(model)
    if path.suffix == DESCRIPTION:
        hand = load_hand(model)
        note = (
            "checked as the hand is loaded; Pinocchio's own reader is asked only about model "
            "files: give the path of one"
        )
        return Source(name=hand.name, model=hand.mj_model, spec=None, path=None, notes=(note,))
    spec = load_spec(path)
    # impossible inertias are common in URDF files, and not what a cross-check is about
    model, balanced = compile_balanced(spec, str(path))
    notes = (BALANCED,) if balanced else ()
    return Source(name=str(path), model=model, spec=spec, path=path, notes=notes)
