"""``LoopProblem``: a grasp problem as tapes and tables, for the loops of least squares."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from planner.hands.hand import Hand
from planner.numerics.tape import Tape, tape_of
from planner.spatial import IntArray
from planner.synthesis.link_capsules import finger_capsules
from planner.synthesis.link_spheres import LinkSphere
from planner.synthesis.loops.tables import (
    Capsules,
    Clearance,
    Contacts,
    Joints,
    Points,
    ProblemTables,
    Written,
)
from planner.synthesis.residuals import Residuals
from planner.synthesis.terms.clearance import box_clearance_of, clearance_of


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopProblem:
    """What all runs of a problem share.

    Attributes:
        residuals: The rows and their names.
        tables: For the loops.
        tape: Written terms and kinematics; of unknowns, parameters and Taylor rows.
        clearance: Clearance from the object; of its size and a point. Of a mesh it is not used.
        box: Clearance from an obstacle; of its numbers and a point.
    """

    residuals: Residuals
    tables: ProblemTables
    tape: Tape
    clearance: Tape
    box: Tape


def loop_problem(residuals: Residuals) -> LoopProblem | None:
    """Tapes and tables of a problem; None where a term has instructions that loops do not know."""
    g, clearances = residuals.formulation.symbols, residuals.clearances
    symbolic, hand = g.symbolic, g.hand
    frames = [symbolic.joint(j) for j in range(hand.nq + 1)]
    jacobian = residuals.jacobian
    contacts = residuals.resistance.outputs
    results = [
        residuals.residual,
        jacobian,
        symbolic.joint_columns(),
        g.rotation.T,
        ca.horzcat(*[ca.vertcat(ca.vec(r.T), t) for r, t in frames]),
        contacts["normals"],
        contacts["normal_jacobians"],
    ]
    dense = [r if r is jacobian else ca.densify(r) for r in results]
    on_mesh = g.surface.field is not None
    tape = tape_of(ca.Function("residuals", residuals.inputs, dense))
    box = tape_of(box_clearance_of())
    clearance = box if on_mesh else tape_of(clearance_of(g.surface.clearance))
    if tape is None or clearance is None or box is None:
        return None
    values, entries, twists, rotation, joints, normals, slopes = tape.results
    row, column = (np.array(v, dtype=np.int64) for v in jacobian.sparsity().get_triplet())
    by_rows = np.lexsort((column, row))
    capsules, n = finger_capsules(hand), len(g.fingers)
    tables = ProblemTables(
        program=tape.program,
        written=Written(
            values_at=values,
            entries_at=entries[by_rows],
            entry_columns=column[by_rows],
            entry_ends=np.cumsum(np.bincount(row, minlength=len(values))),
            both=residuals.both,
            n_required=residuals.n_required,
        ),
        joints=_joints(hand, twists.reshape(-1, 6), rotation.reshape(3, 3), joints.reshape(-1, 12)),
        contacts=Contacts(
            normals_at=normals.reshape(n, 3),
            slopes_at=slopes.reshape(n, 9),
            first=residuals.formulation.unknowns.point_columns.start,
            taylor=tape.arguments[2] if on_mesh else -1,
        ),
        spheres=_points(clearances.spheres),
        hull=_points(clearances.hull),
        capsules=Capsules(
            joint=np.array([c.joint_id for c in capsules], dtype=np.int64),
            inner=np.array([c.inner for c in capsules]).reshape(-1, 3),
            outer=np.array([c.outer for c in capsules]).reshape(-1, 3),
            pairs=clearances.pairs,
        ),
        object=_clearance(clearance),
        obstacle=_clearance(box),
    )
    return LoopProblem(residuals=residuals, tables=tables, tape=tape, clearance=clearance, box=box)


def _joints(hand: Hand, twists: IntArray, rotation: IntArray, joints: IntArray) -> Joints:
    """What moves what.

    What the arm carries is placed by the unknowns s and t, its other links by its joints.
    """
    moved = hand.moved_by.copy()
    carried = np.ones(len(moved), dtype=bool)
    if hand.arm is not None:
        carried = moved[:, hand.arm.chain[-1]].copy()
        moved[np.ix_(carried, hand.arm.chain)] = False
    return Joints(
        twists_at=twists,
        rotation_at=rotation,
        joints_at=joints,
        chains=np.nonzero(moved)[1],
        chain_ends=np.append(0, np.cumsum(moved.sum(axis=1))),
        carried=carried.astype(np.int64),
    )


def _points(spheres: tuple[LinkSphere, ...]) -> Points:
    return Points(
        joint=np.array([b.joint_id for b in spheres], dtype=np.int64),
        at=np.array([b.center for b in spheres], dtype=np.float64).reshape(-1, 3),
    )


def _clearance(tape: Tape) -> Clearance:
    return Clearance(
        program=tape.program, results=np.concatenate(tape.results), point=tape.arguments[1]
    )
