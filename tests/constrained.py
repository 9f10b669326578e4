"""A grasp problem as the constrained programme that it is: a second witness of its least squares.

CasADi evaluates, differentiates and solves (IPOPT) the expressions of the terms here; nothing of
``planner.synthesis.residuals`` takes part.
"""

from __future__ import annotations

import time
from typing import Any

import casadi as ca
import numpy as np

from planner.kinematics import HandState
from planner.spatial import SE3, FloatArray
from planner.synthesis.link_spheres import link_spheres, margin_of
from planner.synthesis.problem import Candidate, GraspProblem, Start
from planner.synthesis.terms.term import Role
from planner.task import GraspTask

IPOPT_OPTIONS: dict[str, Any] = {
    "print_time": False,
    "error_on_fail": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.max_iter": 60,
    "ipopt.tol": 1e-4,
    "ipopt.constr_viol_tol": 1e-7,
    "ipopt.acceptable_tol": 1e-2,
    "ipopt.acceptable_constr_viol_tol": 1e-6,
    "ipopt.acceptable_iter": 3,
    "ipopt.mu_strategy": "adaptive",
    "ipopt.adaptive_mu_globalization": "never-monotone-mode",
}


class Constrained:
    """The terms that must hold as constraints, the costs as the cost."""

    def __init__(self, problem: GraspProblem) -> None:
        """Collect the expressions."""
        f, points = problem.formulation, problem.surface.field
        self.problem, self.x, self.p = problem, f.x, f.p
        self.tau = ca.SX(0, 1) if points is None else points.symbols
        required = [w for w in problem.terms if not w.term.role.is_cost]
        self.terms = [w for w in required if w.expression is not None and w.rows]
        self.g = ca.vertcat(*[w.expression for w in self.terms])
        costs = [w.expression for w in problem.terms if w.term.role is Role.COST]
        self.cost = ca.sumsqr(ca.vertcat(*costs))
        self._values = ca.Function(
            "values", [self.x, self.p, self.tau], [w.expression for w in self.terms]
        )

    def values(self, x: FloatArray, p: FloatArray, task: GraspTask) -> dict[str, FloatArray]:
        """Value of every term at x; of clearances from a mesh by Pinocchio and the mesh's field."""
        f, field = self.problem.formulation, self.problem.surface.field_of(task.object.shape)
        tau: Any = []
        if field is not None:
            points = f.unknowns.points(x)
            tau = np.hstack([points, field.taylor(points, 2)]).ravel()
        found = self._values(x, p, tau)
        out = {w.term.name: np.array(v).ravel() for w, v in zip(self.terms, found, strict=True)}
        if field is not None:
            out["object"] = self._from_mesh(x, f.unpack(p), task)
        return out

    def _from_mesh(self, x: FloatArray, p: dict[str, FloatArray], task: GraspTask) -> FloatArray:
        u, surface = self.problem.formulation.unknowns, self.problem.surface
        pose = u.pose(x, SE3(p["reference"].reshape(3, 3, order="F"), np.zeros(3)))
        state = HandState(task.hand, u.q(x))
        spheres = [(s, margin_of(s, task.fingers)) for s in link_spheres(task.hand)]
        kept = [(s, margin) for s, margin in spheres if margin is not None]
        centers = [pose.act(state.joint_pose(s.joint_id).act(s.center)) for s, _ in kept]
        reach = [s.radius + p[margin][0] + surface.distance_error for s, margin in kept]
        field = surface.field_of(task.object.shape)
        out: FloatArray = field.taylor(np.array(centers), 0)[:, 0] - reach
        return out

    def violations(self, x: FloatArray, p: FloatArray, task: GraspTask) -> dict[str, float]:
        """Largest violation of every term, in its unit."""
        role = {w.term.name: w.term.role for w in self.problem.terms}
        return {
            name: float((-v if role[name].one_sided else np.abs(v)).max(initial=0.0))
            for name, v in self.values(x, p, task).items()
        }

    def solve(self, task: GraspTask, start: Start, parameters: FloatArray) -> Candidate:
        """Run IPOPT from a start, on a primitive."""
        lower, upper = self.problem.bounds(start)
        ubg = [
            0.0 if row.term.role is Role.EQUALITY else np.inf for w in self.terms for row in w.rows
        ]
        programme = {"x": self.x, "p": self.p, "f": self.cost, "g": self.g}
        solver = ca.nlpsol("grasp", "ipopt", programme, IPOPT_OPTIONS)
        begin = time.process_time()
        found = solver(
            x0=np.clip(self.problem.first(start), lower, upper),
            p=parameters,
            lbx=lower,
            ubx=upper,
            lbg=0.0,
            ubg=ubg,
        )
        x = np.clip(np.array(found["x"]).ravel(), lower, upper)  # IPOPT goes 1e-8 beyond bounds
        stats = solver.stats()
        status, iterations = str(stats["return_status"]), int(stats["iter_count"])
        violation = self.violations(x, parameters, task)
        return self.problem.candidate(start, x, violation, status, iterations, begin)
