"""Why a held object creeps in MuJoCo, how fast, and what to set against it.

**Friction in MuJoCo is a damper, not a lock.** A contact far inside its friction cone does not
stick. Its tangential force f_t and the tangential acceleration a_t of the two bodies obey

    a_t + R_t f_t = -b v_t        (friction has a damper b, and no spring)

so that at constant speed a contact that bears f_t slides with

    v_t = R_t f_t / b

    b   = 2 / (d_max tau)                       tau = solref[0], d_max = solimp[1]
    R_t = c (1 - d)/d (1/m_object + 1/m_tip) / impratio
    c   = 1 with elliptic cones, 1 + mu^2 with pyramidal ones
    d   = impedance at the present depth: from solimp[0] at touch to d_max at the depth solimp[2]
    1/m = the body's ``body_invweight0``: how easily it is moved in the model's first posture

n contacts that carry the weight by friction act as dampers side by side, so an object sinks with

    v = m g / sum_i b_i / R_ti  =  (g / n) (1 + m/m_tip) c (1 - d)/d d_max tau / (2 impratio)

(the second form for n like contacts). With MuJoCo's defaults, four fingers, 0.1 kg and tips of 70 g
that is 3 mm/s with elliptic cones and 6 mm/s with pyramidal ones of mu 1.

**What follows.** Friction's coefficient is not in it (but for c), mass hardly, and the normal force
only by d: once the pads are as deep as solimp[2], pressing harder changes nothing. Forces by which
fingers only press on each other have tangential parts too: they grow with the grip and let pads
creep over the surface, so that *more* grip ends sooner. A controller that keeps the object in place
makes the pads creep upwards instead. What helps is a smaller R_t, a larger b, or no R at all:

    noslip_iterations   a second pass of the solver leaves R out of friction: no creep remains once
                        it has converged
    impratio, elliptic  creep is inversely proportional to impratio
    solimp, solref      of the object's geoms with a priority above the hand's: d near 1 (0.999, not
                        0.9999: contacts then chatter), tau of some 2.5 time steps

A pyramid of condim 3 loses its linear law at f_t = mu f_n / 2 (condim 4: / 3), where its opposite
facet goes out; from there on it creeps up to twice as fast per force. ``python -m benchmarks
physics`` measures creep beside this formula.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from planner.contacts import ContactModel, ContactSet
from planner.errors import TaskError
from planner.forces import GraspCompliance, build_force_problem
from planner.plan import GraspPlan
from planner.spatial import FloatArray
from planner.verification import force_arguments
from sim.contacts import contacts_from_mujoco
from sim.scene.build import Scene
from sim.scene.physics import PhysicsOptions

__all__ = [
    "CREEP_BUDGET",
    "Remedy",
    "compliance_of",
    "contact_compliance",
    "contact_drag",
    "impedance",
    "least_creep",
    "predicted_creep",
    "remedies",
    "with_friction_of",
]

HIGHEST_IMPEDANCE = 0.999
"""Highest impedance (-) that a remedy asks for. At 0.9999 contacts chatter, and grasps that hold
with 0.999 are lost (two of two)."""

HIGHEST_IMPRATIO = 1000.0
"""Highest impratio (-) that a remedy asks for: beyond it the solver's problem is conditioned badly,
and noslip iterations do better."""

NOSLIP = 10
"""Noslip iterations (-) of a remedy: as in ``ours``."""

STEPS = 2.5
"""Time constant of contacts in a remedy, in time steps: as in ``ours``."""

DEEPEST = 0.01
"""Depth (m) beyond which no contact is: ten times what any preset reaches."""

LEAST_PRESSING = 2.0
"""Force (N) at which the compliance of contacts is taken that press less: they may press later."""

NEAR = 0.001
"""Gap (m) within which a link may come to bear: fingers that press move by less."""

CREEP_BUDGET = 1e-4
"""Creep (m/s) that remedies are sized for unless told otherwise: 5 mm in 50 s."""


def impedance(solimp: tuple[float, float, float, float, float], depth: float) -> float:
    """Impedance d (-) of a contact at a depth (m, > 0 in penetration): MuJoCo's curve."""
    low, high, width, middle, power = solimp
    x = min(abs(depth) / width, 1.0)
    if power == 1.0 or x in (0.0, 1.0):
        y = x
    elif x <= middle:
        y = x**power / middle ** (power - 1.0)
    else:
        y = 1.0 - (1.0 - x) ** power / (1.0 - middle) ** (power - 1.0)
    return low + y * (high - low)


def contact_drag(physics: PhysicsOptions, *, inverse_mass: float, depth: float) -> float:
    """How much tangential force a contact bears per speed at which it creeps: b / R_t, N s/m.

    Args:
        physics: Gives everything but the bodies. Noslip iterations are left out of account.
        inverse_mass: Sum of the two bodies' inverse masses, 1/kg.
        depth: Penetration, m; infinite for the deepest contact there can be.

    Raises:
        TaskError: An inverse mass that is not positive.
    """
    if not (math.isfinite(inverse_mass) and inverse_mass > 0):
        raise TaskError(f"inverse_mass is {inverse_mass}; give a finite number > 0 in 1/kg")
    d = impedance(physics.solimp, depth)
    shape = 1.0 if physics.cone == "elliptic" else 1.0 + physics.mu**2
    regularisation = shape * (1.0 - d) / d * inverse_mass / physics.impratio
    return 2.0 / (physics.solimp[1] * physics.time_constant) / regularisation


def contact_compliance(physics: PhysicsOptions, *, inverse_mass: float, force: float) -> float:
    """How far a contact gives way along its normal per force, at rest under a force, m/N.

    At rest R_n f = k d depth, with k = 1/(d_max tau damping)^2 and R_n = (1 - d)/d (1/m + 1/m).

    Args:
        physics: Gives solref and solimp.
        inverse_mass: Sum of the two bodies' inverse masses, 1/kg.
        force: Normal force, N, > 0.
    """
    k = (physics.solimp[1] * physics.time_constant * physics.solref[1]) ** -2 / inverse_mass
    low, high = 0.0, DEEPEST
    for _ in range(40):
        depth = (low + high) / 2.0
        d = impedance(physics.solimp, depth)
        low, high = (depth, high) if k * d * d / (1.0 - d) * depth < force else (low, depth)
    return (low + high) / 2.0 / force


def with_friction_of(plan: GraspPlan, physics: PhysicsOptions) -> ContactSet:
    """The planned contacts with the friction of a simulation, which has torsion."""
    soft: ContactModel = "soft"  # MuJoCo's condim 4
    return replace(
        plan.contacts.with_friction(physics.mu, physics.mu_torsion),
        models=(soft,) * len(plan.contacts),
    )


def compliance_of(
    plan: GraspPlan, scene: Scene, qpos: FloatArray | None = None
) -> tuple[GraspCompliance, ContactSet, FloatArray]:
    """The grasp of a plan with the servos and contacts of its simulation.

    Contacts are those that MuJoCo finds within ``NEAR``, several on a face or along a line, with
    the gaps that are left: some 0.1 mm between an inner link and the object is a contact less.
    Friction has no spring; across their normals contacts are taken to be ``impratio`` times as
    stiff as along them.

    Args:
        plan: Gives the torques.
        scene: Its simulation's.
        qpos: State whose joints are the servos' references and in which no torque of the plan is on
            yet, as when the fingers have closed; the planned one if None.

    Returns:
        It; its n contacts, by the names of fingers and links; and the forces (m,) with which they
        press when the planned torques are on and the object is let go, of those that do not touch
        as ``GraspCompliance.pressed`` gives them.
    """
    task, physics, model = plan.task, scene.physics, copy(scene.model)
    if qpos is None:
        qpos = scene.posed(plan.q, plan.T_world_base, task.T_world_object)
    model.geom_margin[list(scene.object_geoms)] = NEAR
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    contacts = contacts_from_mujoco(
        model,
        data,
        object_body=scene.object_body,
        finger_of_geom=scene.finger_of_geom,
        object_geoms=scene.object_geoms,
        with_unloaded=True,
    )
    pairs, weights = data.contact.geom, model.body_invweight0[:, 0]
    of_hand = np.isin(pairs, list(scene.finger_of_geom))
    met = np.isin(pairs, list(scene.object_geoms)).any(axis=1) & of_hand.any(axis=1)
    bodies = model.geom_bodyid[pairs[met][of_hand[met]]].tolist()
    jacobians = np.zeros((len(bodies), 6, model.nv))
    for own, point, body in zip(jacobians, contacts.positions, bodies, strict=True):
        mujoco.mj_jac(model, data, own[:3], own[3:], point, body)
    given = force_arguments(task, plan.contacts, plan.T_world_base, plan.q)
    problem = build_force_problem(
        contacts,
        wrench=given["wrench"],
        jacobians=jacobians[:, :, scene.hand_dof],
        actuation=task.hand.actuation,
        q=qpos[scene.hand_qpos],
        gravity_torque=given["gravity_torque"],
    )
    planned = dict(zip(task.finger_names, plan.contacts.forces[:, 0].tolist(), strict=True))
    each = Counter(contacts.fingers)
    compliance = []
    for body, finger, dim in zip(bodies, contacts.fingers, contacts.dims, strict=True):
        along = contact_compliance(
            physics,
            inverse_mass=float(weights[body] + weights[scene.object_body]),
            force=max(planned.get(finger, 0.0) / each[finger], LEAST_PRESSING),
        )
        compliance += [along, *[along / physics.impratio] * (dim - 1)]
    grasp = GraspCompliance.of(problem, compliance)
    known = plan.forces.problem
    torque = known.joint_map @ plan.forces.unknowns[: known.n_force]
    gaps = data.contact.dist[met]
    return grasp, contacts, grasp.pressed(contacts, torque, problem.wrench, gaps)[0]


def predicted_creep(scene: Scene, data: Any) -> float:
    """Speed (m/s) at which the object sinks through the fingers by this state's contacts.

    Contacts are taken to carry the weight by friction alone and side by side. Noslip iterations are
    left out of account: with enough of them nothing creeps.

    Args:
        scene: A scene.
        data: Its state, after ``mj_forward`` or a step.

    Returns:
        The speed; infinite without contacts.
    """
    model = scene.model
    drag = 0.0
    for contact in data.contact[: data.ncon]:
        geoms = contact.geom
        bodies = model.geom_bodyid[geoms]
        if scene.object_body not in bodies or not any(g in scene.finger_of_geom for g in geoms):
            continue
        if contact.dist < 0:
            drag += contact_drag(
                scene.physics,
                inverse_mass=float(model.body_invweight0[bodies, 0].sum()),
                depth=-float(contact.dist),
            )
    return _weight(scene) / drag if drag else math.inf


def least_creep(
    scene: Scene, fingers: Iterable[str], physics: PhysicsOptions | None = None
) -> float:
    """Speed (m/s) below which no grip brings the creep of the scene's object: d = d_max.

    Args:
        scene: Gives the bodies.
        fingers: Names of the fingers that hold the object, by the last link each.
        physics: Gives the contacts; that of the scene if None. Noslip iterations are left out of
            account.

    Returns:
        The speed; infinite without fingers.
    """
    physics = physics or scene.physics
    inverse = scene.model.body_invweight0[:, 0]
    drag = 0.0
    for finger in fingers:
        geoms = [geom for geom, name in scene.finger_of_geom.items() if name == finger]
        # the last link is the one that is moved most easily
        tip = max((float(inverse[scene.model.geom_bodyid[geom]]) for geom in geoms), default=None)
        if tip is not None:
            total = tip + float(inverse[scene.object_body])
            drag += contact_drag(physics, inverse_mass=total, depth=math.inf)
    return _weight(scene) / drag if drag else math.inf


@dataclass(frozen=True, kw_only=True)
class Remedy:
    """One change of a scene that brings creep below a budget.

    Attributes:
        kind: "noslip", "impratio" or "contacts".
        what: What to write into one's own MJCF.
        physics: The physics with it.
    """

    kind: str
    what: str
    physics: PhysicsOptions


def remedies(
    physics: PhysicsOptions, creep: Callable[[PhysicsOptions], float], budget: float
) -> tuple[Remedy, ...]:
    """Smallest changes of a scene's physics, each alone enough for a stated creep by the formula.

    Args:
        physics: As the scene has it.
        creep: Gives the creep (m/s) under a physics, such as ``least_creep`` of a scene.
        budget: Largest creep that is wanted, m/s.

    Returns:
        What to change; empty if the creep is within the budget as it is.

    Raises:
        TaskError: A budget that is not positive.
    """
    if not (math.isfinite(budget) and budget > 0):
        raise TaskError(f"the creep budget is {budget}; give a finite speed > 0 in m/s")
    if physics.noslip_iterations >= NOSLIP or creep(physics) <= budget:
        return ()
    found = [
        Remedy(
            kind="noslip",
            what=f'<option noslip_iterations="{NOSLIP}"/>',
            physics=replace(physics, noslip_iterations=NOSLIP),
        )
    ]
    elliptic = replace(physics, cone="elliptic")
    ratio = math.ceil(physics.impratio * max(1.0, creep(elliptic) / budget))
    if ratio <= HIGHEST_IMPRATIO:
        found.append(
            Remedy(
                kind="impratio",
                what=f'<option cone="elliptic" impratio="{ratio}"/>',
                physics=replace(elliptic, impratio=float(ratio)),
            )
        )
    if (d := _needed_impedance(physics, creep, budget)) is not None:
        stiff = _stiffened(physics, d)
        solref, solimp = (
            " ".join(f"{v:g}" for v in values) for values in (stiff.solref, stiff.solimp[:3])
        )
        found.append(
            Remedy(
                kind="contacts",
                what="every geom of the object: "
                f'priority="1" condim="{stiff.condim}" solref="{solref}" solimp="{solimp}"',
                physics=stiff,
            )
        )
    return tuple(found)


def _needed_impedance(
    physics: PhysicsOptions, creep: Callable[[PhysicsOptions], float], budget: float
) -> float | None:
    """Constant impedance that is just enough, in thousandths; None if the highest is not."""
    low, high = 500, round(1000 * HIGHEST_IMPEDANCE)
    if creep(_stiffened(physics, high / 1000)) > budget:
        return None
    while low < high:
        middle = (low + high) // 2
        if creep(_stiffened(physics, middle / 1000)) > budget:
            low = middle + 1
        else:
            high = middle
    return low / 1000


def _stiffened(physics: PhysicsOptions, d: float) -> PhysicsOptions:
    """The same with contacts of constant impedance, and as short a time constant as is usual."""
    tau = min(physics.solref[0], STEPS * physics.timestep)
    return replace(physics, solref=(tau, physics.solref[1]), solimp=(d, d, *physics.solimp[2:]))


def _weight(scene: Scene) -> float:
    return scene.task.object.mass * float(np.linalg.norm(scene.task.gravity))
