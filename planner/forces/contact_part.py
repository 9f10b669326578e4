"""The contacts' part in a force problem: columns, bounds, cost, friction pyramids or round cones.

Without a cost on the edge a contact has the faces or the cone of ``planner.forces.friction``. With
one, an excess e >= 0 is added: the tangential part stays within (1 - margin) f_n + e of the
friction instead of f_n of it, with e <= margin f_n, and e^2 costs. Forces that keep the margin then
cost no more than before, and the whole cone remains open to those that cannot.
"""

from __future__ import annotations

import numpy as np

from planner.contacts import ContactSet
from planner.forces.friction import Cone, LimitSurface, pyramid_faces, round_cone
from planner.forces.problem import contact_names
from planner.spatial import FloatArray

__all__ = ["ContactPart"]

_COMPONENTS = ("f_n", "f_t1", "f_t2", "tau_n")


class ContactPart:
    """Columns of the contact forces and of the excess, with their friction.

    Attributes:
        names, excess_names: Of the force components (nf) and of the excess (ne, 0 or n).
        cost, unit, lower, upper: (nf,) of the force components.
        faces: (m, nf + ne), rows <= 0.
        cones: (mc, nf + ne), blocks [head, tail ...].
        cone_sizes: Rows of each block.
        face_names, cone_names: Of rows and blocks.
    """

    def __init__(
        self,
        contacts: ContactSet,
        low: FloatArray,
        high: FloatArray,
        *,
        edges: int,
        cone: Cone,
        limit_surface: LimitSurface,
        tangential_cost: float,
        margin: float,
    ) -> None:
        """Lay them out contact by contact; friction is that of ``contacts``.

        Args:
            contacts: n contacts.
            low: Least normal forces (n,), N.
            high: Greatest normal forces (n,), N.
            edges: Sides of a pyramid.
            cone: Which pyramid, or "round".
            limit_surface: How sliding and torsion share the friction.
            tangential_cost: Of a squared tangential force beside a squared normal force.
            margin: Share of the friction that costs, in [0, 1); 0 for no excess.
        """
        size, n = sum(contacts.dims), len(contacts)
        labels = contact_names(contacts)
        self.names: list[str] = []
        self.excess_names = [f"{label} excess" for label in labels] if margin else []
        self.cost, self.unit = np.ones(size), np.ones(size)
        self.lower, self.upper = np.full(size, -np.inf), np.full(size, np.inf)
        self.face_names: list[str] = []
        self.cone_names: list[str] = []
        width = size + len(self.excess_names)
        face_rows, cone_rows = [np.zeros((0, width))], [np.zeros((0, width))]
        for i, dim in enumerate(contacts.dims):
            at = len(self.names)
            self.names += [f"{labels[i]} {c}" for c in _COMPONENTS[:dim]]
            self.lower[at], self.upper[at] = low[i], high[i]
            self.cost[at + 1 : at + dim] = tangential_cost
            mu = float(contacts.mu[i]) if dim >= 3 else 0.0
            twist = float(contacts.mu_torsion[i]) if dim == 4 else 0.0
            if mu == 0.0:
                self._pin(at + 1, min(at + 3, at + dim))
            if dim == 4 and twist == 0.0:
                self._pin(at + 3, at + 4)
            elif dim == 4:
                # A torsion counts like the normal force that its friction needs.
                self.unit[at + 3] = twist
                self.cost[at + 3] /= twist**2
            cones, faces = round_cone(mu, twist, limit_surface), np.zeros((0, 4))
            if cone == "round" and limit_surface == "independent" and mu and twist:
                faces = pyramid_faces(0.0, twist, edges, "circumscribed")
            elif cone != "round":
                faces = pyramid_faces(mu, twist, edges, cone, limit_surface)
                cones = np.zeros((0, 4))
            name = f"friction of {labels[i]}"
            for rows, into, named in (
                (faces, face_rows, self.face_names),
                (cones, cone_rows, self.cone_names),
            ):
                block = np.zeros((len(rows), width))
                block[:, at : at + dim] = rows[:, :dim]
                if margin:
                    block[:, size + i] = rows[:, 0]
                    block[:, at] *= 1.0 - margin
                into.append(block)
                count = len(rows) if into is face_rows else min(len(rows), 1)
                named.extend([name] * count)
            if margin:
                most = np.zeros((1, width))
                most[0, size + i], most[0, at] = 1.0, -margin
                face_rows.append(most)
                self.face_names.append(name)
        self.faces, self.cones = np.vstack(face_rows), np.vstack(cone_rows)
        self.cone_sizes = tuple(len(rows) for rows in cone_rows if len(rows))
        self.excess = n if margin else 0

    def _pin(self, begin: int, end: int) -> None:
        self.lower[begin:end] = self.upper[begin:end] = 0.0
