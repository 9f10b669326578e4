"""Distances of the true links, linear in the unknowns from where they were measured.

In the other terms spheres and capsules stand for links, and bars and hulls are wider than those in
places. Pairs that coal finds too near at the end of a run of least squares are kept apart in the
next one:

    d = n . (b - a),   d' = n . (b' - a'),   p' = R (omega x p + v(q')) + t',

nearest points a and b, and the normal n from a to b. Between fingers the base drops out; what
stands still does not move (``planner.synthesis.terms.clearance`` has the same rates).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from planner.collision.pad_contact import pad_contact_queries
from planner.collision.world import CollisionWorld
from planner.hands.hand import Hand
from planner.numerics.kernels import loops_of_kernels
from planner.spatial import SE3, FloatArray, IntArray
from planner.synthesis.mesh_surface import Field
from planner.synthesis.symbols import Unknowns, mrp_rates
from planner.synthesis.terms.hand_points import Rows, end_row
from planner.synthesis.terms.standard import PER_METRE
from planner.synthesis.terms.term import ActiveRows, Role, Row, RowSource, Term

LEAST_DISTANCE = 0.0015
"""Least distance (m) of true links without pads from object, table and obstacles."""

MARGIN_IN_VIEW = 0.0015
"""A pair gets a row if its distance is less than this (m) above the least one: the next steps may
close the rest."""

ROUNDING = 1e-8
"""A shortfall below this (m) counts as zero: steps end on linear constraints up to rounding, which
must not decide whether a row counts."""

LINKS = Term(
    name="links",
    meaning="true distances, linear about where they were measured; rows for pairs found near",
    role=Role.INEQUALITY,
    unit="m",
    weight=PER_METRE,
    wording="true distance of {}",
    elsewhere="palm or wrist",
    judged="penetration of the true links",
    lacking=(
        "links would touch each other, the object or the table; fewer fingers, another pose or size"
    ),
)


@dataclass(frozen=True, kw_only=True)
class LinkDistances:
    """Linearised distances that are too small, or nearly.

    Attributes:
        x: Unknowns (n,) at which they were measured.
        values: Distance less the least one, (k,), m.
        rows: Their derivatives by the unknowns (k, n).
        joints: Pinocchio joints (k, 2) that the two links move with; 0 for fixed geometry.
        urgent: Whether any distance is less than half of the least one.
    """

    x: FloatArray
    values: FloatArray
    rows: FloatArray
    joints: IntArray
    urgent: bool


class TrueLinks(RowSource):
    """The linearised distances that are constrained at present."""

    def __init__(self, hand: Hand) -> None:
        """Begin with none."""
        self.outputs = {}
        self._hand = hand
        self._kept: LinkDistances | None = None

    @property
    def rows(self) -> dict[Term, tuple[Row, ...]]:
        """See ``RowSource``."""
        joint_id = self._hand.pin_model.getJointId
        finger = {joint_id(j): f.name for f in self._hand.fingers.values() for j in f.joints}
        joints = self._kept.joints.tolist() if self._kept is not None else []
        about = [tuple(dict.fromkeys(finger[j] for j in pair if j in finger)) for pair in joints]
        return {LINKS: tuple(LINKS.row(names, k) for k, names in enumerate(about))}

    def set_parameters(self, values: dict[str, FloatArray], field: Field | None) -> None:
        """See ``RowSource``."""
        self._kept = None

    def keep(self, distances: LinkDistances | None) -> None:
        """Constrain these distances from now on, in place of those before."""
        self._kept = distances

    def __call__(self, x: FloatArray) -> list[ActiveRows]:
        """See ``RowSource``."""
        kept = self._kept
        if kept is None:
            return []
        values = kept.values + kept.rows @ (x - kept.x)
        short = np.flatnonzero(values < -ROUNDING)
        if not len(short):
            return []
        return [ActiveRows(LINKS, values[short], kept.rows[short], short)]


def find_link_distances(
    world: CollisionWorld,
    unknowns: Unknowns,
    x: FloatArray,
    T_object_base: SE3,
    *,
    clear_tip: float,
    clear_fingers: float,
) -> LinkDistances | None:
    """Which pairs are too near, or nearly, at the unknowns x (n,); None if there are none.

    On an arm only fingers are measured: s and t do not place the base there. Distances from a mesh
    are left out: measuring them takes as much time as the saved attempts.

    Args:
        world: True geometry of the task.
        unknowns: Layout of x.
        x: Where to measure.
        T_object_base: Pose of the hand's base there.
        clear_tip: Distance asked of links that carry pads, m.
        clear_fingers: Distance asked between fingers, m.
    """
    task, q = world.task, unknowns.q(x)
    hand = task.hand
    farthest = max(LEAST_DISTANCE, clear_tip, clear_fingers) + MARGIN_IN_VIEW
    near = world.near(
        task.T_world_object * T_object_base,
        q,
        farthest,
        may_touch=pad_contact_queries(task).names,
        meshes=False,
    )
    pads = np.isin(near.joints[:, 0], [f.pad.joint_id for f in task.fingers])
    outward = np.where(pads, clear_tip, LEAST_DISTANCE)
    asked = np.where(near.hand_environment, outward, clear_fingers)
    values = near.distances - asked
    short = values < MARGIN_IN_VIEW
    if hand.arm is not None:
        short &= ~near.hand_environment
    if not short.any():
        return None
    joints, normals = near.joints[short], near.normals[short]
    points, out = near.points_a[short], near.hand_environment[short][:, None]
    state = world.moving.move(q)
    rows = np.zeros((len(joints), unknowns.size))
    unknowns.q(rows.T)[:] = (
        state.point_rates(joints[:, 1], near.points_b[short], normals)
        - state.point_rates(joints[:, 0], points, normals)
    ).T
    rows[:, :3] = np.where(out, -np.cross(points, normals) @ mrp_rates(x[:3]), 0.0)
    rows[:, 3:6] = np.where(out, -normals @ T_object_base.rotation.T, 0.0)
    return LinkDistances(
        x=x.copy(),
        values=values[short],
        rows=rows,
        joints=joints,
        urgent=bool((values[short] < -asked[short] / 2).any()),
    )


class LinkRun(NamedTuple):
    """Distances that are kept at present, for compiled loops.

    Attributes:
        values: Less those asked for (k,), m.
        rates: Their derivatives by the unknowns (k, n).
        x: Where they were measured (n,).
        place: Of the term, see ``Rows``.
    """

    values: FloatArray
    rates: FloatArray
    x: FloatArray
    place: int


def link_run(distances: LinkDistances | None, size: int, place: int) -> LinkRun:
    """The distances, or none, of ``size`` unknowns."""
    if distances is None:
        return LinkRun(np.zeros(0), np.zeros((0, size)), np.zeros(size), place)
    rates = np.ascontiguousarray(distances.rows)
    return LinkRun(distances.values, rates, distances.x, place)


@loops_of_kernels
def link_rows(run: LinkRun, x: FloatArray, rows: Rows) -> None:
    """Append the linearised distances of true links that are too small."""
    weight, place = rows.weights[run.place], run.place
    rows.least[place] = 0.0
    for k in range(len(run.values)):
        value = run.values[k]
        for j in range(len(x)):
            value += run.rates[k, j] * (x[j] - run.x[j])
        if value < -ROUNDING:
            rows.least[place] = min(rows.least[place], value)
            at = rows.filled[1]
            for j in range(len(x)):
                if run.rates[k, j] != 0.0:
                    rows.columns[at], rows.entries[at] = j, weight * run.rates[k, j]
                    at += 1
            end_row(rows, weight * value, at)
