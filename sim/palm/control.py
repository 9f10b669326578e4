"""``PalmController``: model-predictive control of an object that lies in the palm.

Over a horizon of steps of ``ContactStep`` it minimises, in the increments of the servos' commands,

    sum_k s_k (c_p |p_k - p*|^2 + c_r |r_k - r*|^2) + c_t sum_tips |tip_k - p_k|^2 + c_u |du_k|^2

with s_k = 1 at the end and less before, increments and commands in their ranges. All terms are
squares of what is linear in the state, and only the forces bend: so Gauss-Newton steps with exact
derivatives, each a QP in horizon x servos unknowns (DAQP), warm-started from the last solve and
halved until the cost falls, do it (a real-time iteration; Diehl, Bock and Schloeder 2005).
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from planner.numerics.qp import solve_qp
from planner.spatial import FloatArray
from sim.palm.model import FREE, ContactStep, PalmModel, Plant
from sim.palm.settings import PalmSettings

HALVINGS = 4
"""How often a step is halved before the solve ends where it is."""

RIDGE = 1e-6
"""Added to the diagonal of the QP (1/rad^2): far below the effort's cost."""


class PalmController:
    """Commands for an object that is to have a rotation.

    Attributes:
        model: What reads contacts.
        predicted: Where the last solve expects the state at the end, (n,).
    """

    def __init__(self, plant: Plant, settings: PalmSettings) -> None:
        """Begin without a plan of commands."""
        self.plant, self.settings = plant, settings
        self.model = PalmModel(plant, settings)
        nu, steps = len(plant.ctrl), settings.horizon
        self._range = plant.model.actuator_ctrlrange[plant.ctrl].T
        limited = plant.model.actuator_ctrllimited[plant.ctrl].astype(bool)
        self._range = np.where(limited, self._range, [[-np.inf], [np.inf]])
        force = plant.model.actuator_forcerange[plant.ctrl, 1]
        bounded = plant.model.actuator_forcelimited[plant.ctrl].astype(bool)
        lead = np.where(bounded, force / self.model.kp, np.inf)
        self._lead = np.minimum(lead, settings.lead_rad)
        self._sums = np.asarray(
            np.kron(np.tril(np.ones((steps, steps))), np.eye(nu)), dtype=np.float64
        )
        self.predicted = np.zeros(FREE + len(plant.qpos))
        self.forget()

    def forget(self) -> None:
        """Begin anew: commands are no longer those of the last solve."""
        self._increments = np.zeros((self.settings.horizon, len(self.plant.ctrl)))

    def adopt(self, other: PalmController) -> None:
        """Begin where another controller of the plant is."""
        self._increments = other._increments

    def command(
        self, qpos: FloatArray, ctrl: FloatArray, goal: FloatArray, place: FloatArray
    ) -> FloatArray:
        """Commands (nu,) for a step from now.

        Args:
            qpos: State of the plant.
            ctrl: Commands (nu,) now.
            goal: Rotation (3, 3) that the object is to have, world.
            place: Where its centre is to be (3,), m, world.
        """
        asked = self.settings
        step = self.model.read(qpos)
        rotation, center = self.model.pose()
        turn = pin.log3(goal @ rotation.T)
        angle = float(np.linalg.norm(turn))
        turn *= min(1.0, asked.goal_rad / max(angle, asked.goal_rad))
        share = float(np.clip(np.degrees(angle) / asked.slow_deg, asked.slowest, 1.0))
        target = np.concatenate([place - center, turn])
        problem = _Problem(step, asked, ctrl, target, self.model.tips())
        most = np.full(len(ctrl), share * asked.command_rad)
        most[self.plant.idle] = 0.0
        limit = np.tile(most, asked.horizon)
        x = np.clip(self._increments.ravel(), -limit, limit)
        residuals, jacobian = problem.linearised(x)
        for _ in range(asked.sweeps):
            change = self._qp(x, residuals, jacobian, limit, ctrl)
            cost = residuals @ residuals
            for halved in range(HALVINGS):
                trial = x + change / 2**halved
                new = problem.residuals(trial)
                if new @ new < cost:
                    break
            else:
                break
            x = trial
            residuals, jacobian = problem.linearised(x)
        self._increments = x.reshape(asked.horizon, -1)
        self.predicted = problem.end
        return np.asarray(ctrl + self._increments[0])

    def held_back(self, command: FloatArray, q_servo: FloatArray) -> FloatArray:
        """Commands (nu,) within reach of where the servos are (nu,), and of their ranges."""
        near = np.clip(command, q_servo - self._lead, q_servo + self._lead)
        return np.asarray(np.clip(near, *self._range))

    def _qp(
        self,
        x: FloatArray,
        residuals: FloatArray,
        jacobian: FloatArray,
        limit: FloatArray,
        ctrl: FloatArray,
    ) -> FloatArray:
        """Change (N,) of the increments that minimises the linearised cost within their ranges."""
        hessian = jacobian.T @ jacobian
        hessian[np.diag_indices(len(x))] += RIDGE
        summed = np.tile(ctrl, self.settings.horizon) + self._sums @ x
        low, high = (np.tile(side, self.settings.horizon) - summed for side in self._range)
        change = solve_qp(
            hessian,
            jacobian.T @ residuals,
            self._sums,
            np.minimum(low, 0.0),  # a command that is out of range may come back slowly
            np.maximum(high, 0.0),
            -limit - x,
            limit - x,
        )
        return np.zeros(len(x)) if change is None else change


class _Problem:
    """Residuals of a horizon as a function of all increments x (steps x nu,)."""

    def __init__(
        self,
        step: ContactStep,
        asked: PalmSettings,
        ctrl: FloatArray,
        target: FloatArray,
        tips: tuple[FloatArray, FloatArray],
    ) -> None:
        self._step, self._asked, self._ctrl, self._target = step, asked, ctrl, target
        places, jacobians = tips
        # rows of what is wanted of a state: pose, tips; the running pose is a share of it
        n = step.keep.shape[0]
        costs = np.sqrt([asked.position_cost] * 3 + [asked.rotation_cost] * 3)
        self._pose = np.hstack([np.diag(costs), np.zeros((FREE, n - FREE))])
        self._pose_at = -costs * target
        to_center = -np.tile(np.eye(3, FREE), (len(places), 1))
        tip = np.hstack([to_center, jacobians.reshape(-1, n - FREE)])
        self._tip = np.sqrt(asked.tip_cost) * tip
        self._tip_at = np.sqrt(asked.tip_cost) * places.ravel()
        self._effort = np.sqrt(asked.effort_cost)
        self.end = np.zeros(n)

    def residuals(self, x: FloatArray) -> FloatArray:
        """All residuals, whose sum of squares is the cost."""
        state, found, command = np.zeros(len(self.end)), [self._effort * x], self._ctrl
        for k, change in enumerate(x.reshape(self._asked.horizon, -1)):
            command = command + change
            state = self._step.step(state, command)
            found += self._of(state, k)
        self.end = state
        return np.concatenate(found)

    def linearised(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residuals, and their exact derivative along x."""
        nu, steps = len(self._ctrl), self._asked.horizon
        state, dx, du = (
            np.zeros(s) for s in (len(self.end), (len(self.end), len(x)), (nu, len(x)))
        )
        found, rows, command = [self._effort * x], [self._effort * np.eye(len(x))], self._ctrl
        for k, change in enumerate(x.reshape(steps, -1)):
            command = command + change
            du[:, k * nu : (k + 1) * nu] = np.eye(nu)
            state, dx = self._step.differential(state, command, dx, du)
            found += self._of(state, k)
            rows += [self._weight(k) * self._pose @ dx, self._tip @ dx]
        self.end = state
        return np.concatenate(found), np.vstack(rows)

    def _of(self, state: FloatArray, k: int) -> list[FloatArray]:
        pose = self._weight(k) * (self._pose @ state + self._pose_at)
        return [pose, self._tip @ state + self._tip_at]

    def _weight(self, k: int) -> float:
        last = k == self._asked.horizon - 1
        return 1.0 if last else float(np.sqrt(self._asked.running_share))
