"""How far the answers of friction pyramids are from the round cone's, by the number of sides.

A pyramid with k sides has between cos(pi/k) (inscribed) and 1 (or between 1 and 1/cos(pi/k),
circumscribed) of the sliding friction, so 1 - cos(pi/k) bounds what an inscribed one loses where
there is no torsion: 50 % at 3 sides, 7.6 % at 8, 1.9 % at 16. Inscribed answers cost at least what
the cone's costs, circumscribed ones at most that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Unpack, get_args

import numpy as np
from numpy.typing import ArrayLike

from planner.contacts import ContactSet, Pyramid
from planner.forces.build import ForceArguments
from planner.forces.solve import distribute_forces
from planner.numerics.qp_workspace import DEFAULT_SOLVER

SIDES = (3, 4, 6, 8, 12, 16, 32)
"""Numbers of sides that are compared unless others are given."""


@dataclass(frozen=True, kw_only=True)
class PyramidGap:
    """Answers of one pyramid beside those of the cone, over the wrenches that both hold.

    Attributes:
        cone: "inscribed" or "circumscribed".
        edges: Sides k.
        compared: Wrenches that pyramid and cone hold.
        cone_only: Wrenches that the cone holds and the pyramid does not.
        pyramid_only: Wrenches that the pyramid holds and the cone does not.
        median_N, worst_N: Greatest change of a force component per wrench, N; NaN if none compared.
        median_cost, worst_cost: Change of the cost, relative; > 0 above the cone's.
    """

    cone: Pyramid
    edges: int
    compared: int
    cone_only: int
    pyramid_only: int
    median_N: float
    worst_N: float
    median_cost: float
    worst_cost: float


def cone_gaps(
    contacts: ContactSet,
    wrenches: ArrayLike,
    *,
    sides: Sequence[int] = SIDES,
    **arguments: Unpack[ForceArguments],
) -> tuple[PyramidGap, ...]:
    """Compare pyramids with the cone on wrenches (m, 6), N and N m.

    Args:
        contacts: n contacts.
        wrenches: External wrenches, one programme each.
        sides: Numbers of sides.
        **arguments: As for ``build_force_problem``; ``wrench``, ``cone``, ``edges`` are not read.

    Raises:
        ContactError: The arguments do not fit together.
        NotFoundError: Clarabel is not installed.
    """
    rows = np.asarray(wrenches, dtype=np.float64).reshape(-1, 6)
    exact = []
    for wrench in rows:
        given: ForceArguments = {**arguments, "wrench": wrench, "cone": "round"}
        exact.append(distribute_forces(contacts, **given))
    out = []
    for cone in get_args(Pyramid):
        for edges in sides:
            moved, dearer, cone_only, pyramid_only = [], [], 0, 0
            for wrench, best in zip(rows, exact, strict=True):
                given = {**arguments, "wrench": wrench, "cone": cone, "edges": edges}
                answer = distribute_forces(contacts, solver=DEFAULT_SOLVER, **given)
                cone_only += best.found and not answer.found
                pyramid_only += answer.found and not best.found
                if best.found and answer.found:
                    moved.append(float(np.abs(answer.forces - best.forces).max(initial=0.0)))
                    dearer.append(answer.cost / best.cost - 1.0 if best.cost else 0.0)
            out.append(
                PyramidGap(
                    cone=cone,
                    edges=edges,
                    compared=len(moved),
                    cone_only=cone_only,
                    pyramid_only=pyramid_only,
                    median_N=float(np.median(moved)) if moved else np.nan,
                    worst_N=max(moved, default=np.nan),
                    median_cost=float(np.median(dearer)) if dearer else np.nan,
                    worst_cost=max(dearer, key=abs, default=np.nan),
                )
            )
    return tuple(out)
