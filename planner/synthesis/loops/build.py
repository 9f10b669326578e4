"""``LoopProblem``: a grasp problem as tapes and tables, for the loops of least squares."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from planner.hands.hand import Hand
from planner.numerics.tape import Tape, tape_of
from planner.spatial import FloatArray, IntArray
from planner.synthesis.link_capsules import finger_capsules
from planner.synthesis.loops.tables import ProblemTables
from planner.synthesis.residuals import Residuals
from planner.synthesis.terms.clearance import box_clearance_of, clearance_of

__all__ = ["LoopProblem", "loop_problem"]


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
    tapes = (
        tape_of(ca.Function("residuals", residuals.inputs, dense)),
        tape_of(clearance_of(lambda _, p: p[0] if g.surface.field else g.surface.clearance(_, p))),
        tape_of(box_clearance_of()),
    )
    tape, clearance, box = tapes
    if tape is None or clearance is None or box is None:
        return None
    values, entries, twists, rotation, joints, normals, slopes = tape.results
    row, column = (np.array(v, dtype=np.int64) for v in jacobian.sparsity().get_triplet())
    by_rows = np.lexsort((column, row))
    chains, chain_ends, carried = _chains(hand)
    capsules, n = finger_capsules(hand), len(g.fingers)
    spheres, hull = clearances.spheres, clearances.hull
    tables = ProblemTables(
        program=tape.program,
        taylor_begin=tape.arguments[2] if g.surface.field else -1,
        values_at=values,
        entries_at=entries[by_rows],
        entry_columns=column[by_rows],
        entry_ends=np.cumsum(np.bincount(row, minlength=len(values))),
        both=residuals.both,
        n_required=residuals.n_required,
        twists_at=twists.reshape(-1, 6),
        rotation_at=rotation,
        joints_at=joints.reshape(-1, 12),
        normals_at=normals.reshape(n, 3),
        slopes_at=slopes.reshape(n, 3, 3),
        point_begin=residuals.formulation.unknowns.point_columns.start,
        chains=chains,
        chain_ends=chain_ends,
        carried=carried,
        sphere_joint=_numbers([b.joint_id for b in spheres]),
        sphere_point=_points([b.center for b in spheres]),
        hull_joint=_numbers([b.joint_id for b in hull]),
        hull_point=_points([b.center for b in hull]),
        capsule_joint=_numbers([c.joint_id for c in capsules]),
        capsule_inner=_points([c.inner for c in capsules]),
        capsule_outer=_points([c.outer for c in capsules]),
        pairs=clearances.pairs,
        clearance=clearance.program,
        clearance_at=np.concatenate(clearance.results),
        clearance_point=clearance.arguments[1],
        box=box.program,
        box_at=np.concatenate(box.results),
        box_point=box.arguments[1],
    )
    return LoopProblem(residuals=residuals, tables=tables, tape=tape, clearance=clearance, box=box)


def _chains(hand: Hand) -> tuple[IntArray, IntArray, FloatArray]:
    """Joints that move what is fixed to each joint, their ends, and whether s and t move it.

    What the arm carries is placed by the unknowns s and t, its other links by its joints.
    """
    moved = hand.moved_by.copy()
    carried = np.ones(len(moved), dtype=bool)
    if hand.arm is not None:
        carried = moved[:, hand.arm.chain[-1]].copy()
        moved[np.ix_(carried, hand.arm.chain)] = False
    return np.nonzero(moved)[1], np.cumsum(moved.sum(axis=1)), carried


def _numbers(values: list[int]) -> IntArray:
    return np.array(values, dtype=np.int64)


def _points(values: list[FloatArray]) -> FloatArray:
    return np.array(values, dtype=np.float64).reshape(-1, 3)
