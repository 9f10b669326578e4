"""``friction_part``: what of a force problem depends on the contacts' friction alone.

Attempts of one task have the same friction at every contact, wherever it is; so bounds, faces,
cones and names are laid out once for all of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.contacts import CONTACT_DIM, Cone, ContactModel, pyramid_faces, round_cone
from planner.forces.problem import names_of_contacts
from planner.spatial import FloatArray, IntArray
from planner.system.threads import made_once

KEPT = 64
"""Layouts that are kept (-), 10 kB each."""

_COMPONENTS = ("f_n", "f_t1", "f_t2", "tau_n")


@dataclass(frozen=True, kw_only=True, eq=False)
class FrictionPart:
    """Columns of the contact forces and of the excess, with their friction; read-only.

    Attributes:
        names: Of the force components (nf,).
        excess_names: Of the excess (ne,), one per contact if there is a margin.
        normal: Which of them are normal forces (n,).
        unit: (nf,), unit of each per newton.
        lower, upper: (nf,), with nothing said of normal forces.
        faces: (m, nf + ne), rows <= 0.
        cones: (mc, nf + ne), blocks [head, tail ...].
        cone_sizes: Rows of each block.
        face_names, cone_names: Of rows and blocks.
    """

    names: tuple[str, ...]
    excess_names: tuple[str, ...]
    normal: IntArray
    unit: FloatArray
    lower: FloatArray
    upper: FloatArray
    faces: FloatArray
    cones: FloatArray
    cone_sizes: tuple[int, ...]
    face_names: tuple[str, ...]
    cone_names: tuple[str, ...]


@made_once(KEPT)
def friction_part(
    models: tuple[ContactModel, ...],
    fingers: tuple[str, ...],
    friction: bytes,
    edges: int,
    cone: Cone,
    margin: float,
) -> FrictionPart:
    """Lay them out contact by contact.

    Args:
        models: Friction law of each contact.
        fingers: Their names.
        friction: Sliding (-) and torsional friction (m) of each, the bytes of (n, 2).
        edges: Sides of each pyramid.
        cone: As for ``build_force_problem``.
        margin: Share of the friction that is kept; above 0 it brings the excess.

    Raises:
        ContactError: ``edges`` is not usable.
    """
    dims, labels = [CONTACT_DIM[m] for m in models], names_of_contacts(fingers)
    size, n = sum(dims), len(dims)
    width = size + (n if margin else 0)
    names, face_names, cone_names = list[str](), list[str](), list[str]()
    normal = np.cumsum([0, *dims])[:-1]
    unit = np.ones(size)
    lower, upper = np.full(size, -np.inf), np.full(size, np.inf)
    faces, cones = [np.zeros((0, width))], [np.zeros((0, width))]
    of_contacts = np.frombuffer(friction).reshape(n, 2).tolist()
    for i, (at, dim) in enumerate(zip(normal, dims, strict=True)):
        names += [f"{labels[i]} {c}" for c in _COMPONENTS[:dim]]
        mu, twist = of_contacts[i]
        without = np.flatnonzero(np.array([1.0, mu, mu, twist])[:dim] == 0.0)
        lower[at + without] = upper[at + without] = 0.0
        if twist:
            unit[at + 3] = twist  # a torsion counts like the normal force that it needs
        name = f"friction of {labels[i]}"
        rows = round_cone(mu, twist) if cone == "round" else pyramid_faces(mu, twist, edges, cone)
        block = np.zeros((len(rows), width))
        block[:, at : at + dim] = rows[:, :dim]
        if margin:
            block[:, size + i] = rows[:, 0]
            block[:, at] *= 1.0 - margin
            most = np.zeros((1, width))
            most[0, size + i], most[0, at] = 1.0, -margin
        if cone == "round":
            cones.append(block)
            cone_names += [name] * min(len(rows), 1)
        else:
            faces.append(block)
            face_names += [name] * len(rows)
        if margin:
            faces.append(most)
            face_names.append(name)
    tables = np.vstack(faces), np.vstack(cones)
    for array in (normal, unit, lower, upper, *tables):
        array.flags.writeable = False
    return FrictionPart(
        names=tuple(names),
        excess_names=tuple(f"{label} excess" for label in labels) if margin else (),
        normal=normal,
        unit=unit,
        lower=lower,
        upper=upper,
        faces=tables[0],
        cones=tables[1],
        cone_sizes=tuple(len(rows) for rows in cones if len(rows)),
        face_names=tuple(face_names),
        cone_names=tuple(cone_names),
    )
