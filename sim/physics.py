"""How MuJoCo computes: solver, integrator, friction and contact stiffness, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from planner.errors import TaskError
from planner.spatial import FloatArray

__all__ = ["CONTACT_SOLIMP", "CONTACT_SOLREF", "MU_ROLLING", "PhysicsOptions"]

CONTACT_SOLREF = (0.005, 1.0)
"""Time constant (s) and damping ratio (-) of contacts: 2.5 time steps, about as stiff as the step
allows (MuJoCo needs at least two)."""

CONTACT_SOLIMP = (0.5, 0.99, 0.0001, 0.5, 2.0)
"""Impedance of contacts: from 0.5 at touch to 0.99 at 0.1 mm of penetration, as published for the
Shadow hand. Pads sink in by some hundredths of a millimetre under the usual forces."""

MU_ROLLING = 0.001
"""Rolling friction (m) of the object on table and obstacles: a ball of 35 mm radius starts to roll
at a push of 3 % of its weight. It resembles felt more than glass, and lets an object stand still
until the fingers have closed."""


@dataclass(frozen=True, kw_only=True)
class PhysicsOptions:
    """How MuJoCo computes. The defaults state their reason; a report repeats what was used.

    The constraint Jacobian is always dense and the cone always elliptic: mujoco 4.0.0 factorises
    sparse Hessians wrongly, and pyramidal cones creep some twenty times faster.

    Attributes:
        timestep: s. Twice as short as DexGraspBench's 4 ms; the servo loop runs at the same rate.
        mu: Sliding friction between hand, object, table and obstacles (-). 0.6 where planning
            relies on 0.5 is the margin that a plan has.
        mu_torsion: Torsional friction (m): MuJoCo's default, at every mu. It is generous: a patch
            of radius a under Hertz's pressure resists turning by 3 pi / 16 mu a per newton (2/3 mu
            a under an even pressure; Johnson, Contact Mechanics, 1985), so at mu 0.6 these 5 mm are
            a patch of 14 mm (12.5 mm), wider than a fingertip of 8 mm. Soft rubber (1.3 MPa) on a
            tip of 8 mm under 5 N has 2.8 mm, or 1.0 mm of torsional friction. Planning counts on
            none.
        impratio: Ratio of frictional to normal impedance (-): 10 makes friction hold instead of
            creep, and is what the peers use.
        noslip_iterations: Extra iterations that take the rest of the creep out of friction. A ball
            held by four fingers creeps 100 um/s with 0, 22 with 2, 6 with 5 or 10; the time is the
            same.
        iterations: Limit of solver iterations per step.
    """

    timestep: float = 0.002
    mu: float = 0.6
    mu_torsion: float = 0.005
    impratio: float = 10.0
    noslip_iterations: int = 10
    iterations: int = 100

    def __post_init__(self) -> None:
        """Check every number."""
        for name in ("timestep", "impratio"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise TaskError(f"{name} is {value}; give a finite number > 0")
        for name in ("mu", "mu_torsion"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise TaskError(f"{name} in simulation is {value}; give a finite number >= 0")
        if self.noslip_iterations < 0 or self.iterations < 1:
            raise TaskError("noslip_iterations must be >= 0 and iterations >= 1")

    @property
    def friction(self) -> tuple[float, float, float]:
        """Sliding, torsional and rolling friction as MuJoCo writes them: -, m, m."""
        return (self.mu, self.mu_torsion, MU_ROLLING)

    def apply(self, spec: Any, gravity: FloatArray) -> None:
        """Write the options into a ``mujoco.MjSpec``, with gravity (3,) in m/s2."""
        option = spec.option
        option.timestep = self.timestep
        option.gravity = gravity
        option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        option.solver = mujoco.mjtSolver.mjSOL_NEWTON
        option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        option.impratio = self.impratio
        option.noslip_iterations = self.noslip_iterations
        option.iterations = self.iterations
        option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
