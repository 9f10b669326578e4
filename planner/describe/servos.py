"""Servos for the joints of a hand that nothing holds, and passive properties with which they work.

A servo's damping is sized for the inertia that is simulated: links, the model's own rotors, and
those that are added where the model has none.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planner.bridge.structure import ModelStructure
from planner.describe.drive import in_span
from planner.describe.proposal import Notes
from planner.joints.description import ActuatorDescription, JointDefaults
from planner.spatial import FloatArray

LARGEST_EFFORT = {"hinge": 5.0, "slide": 500.0}
"""Efforts (N m, N) above these are not those of a finger's joint: URDF files often hold fillers."""

USUAL_EFFORT = {"hinge": 0.7, "slide": 20.0}
"""Effort (N m, N) where the model names no credible one: 7 N at a fingertip 0.1 m from the joint,
as in servo-driven hands of human size."""

SERVO_TRAVEL = {"hinge": 0.25, "slide": 0.005}
"""Error (rad, m) at which a proposed servo pushes with its whole force."""

SLOWEST_JOINT = 0.3
"""Time constant damping/kp (s) above which a joint's own damping slows the closing of a hand to
seconds."""

STICKIEST_JOINT = 0.3
"""Largest share (-) of a servo's force that dry friction may take."""

USUAL_ARMATURE = 2e-4
"""Inertia (kg m2) of a small geared motor seen from the joint."""


def missing_servos(
    structure: ModelStructure,
    held: Sequence[FloatArray],
    joints: Sequence[int],
    inertia: FloatArray,
    notes: Notes,
) -> tuple[ActuatorDescription, ...]:
    """Servos for joints that neither actuators nor couplings hold, nearest to the palm first.

    Args:
        structure: The hand.
        held: Rows (nv,) of actuators and couplings.
        joints: Every joint, in the order in which servos are preferred.
        inertia: (nv,), what each joint moves in the model, its rotor included, kg m2 (kg).
        notes: Gets reasons and open questions.
    """
    rows = list(held)
    inertia = inertia + _missing_armature(structure)
    groups: dict[tuple[float, float], list[str]] = {}
    unsaid, unbelieved = [], []
    for j in joints:
        unit = np.eye(len(structure.joints))[j]
        if in_span(unit, rows):
            continue
        rows.append(unit)
        part = structure.joints[j]
        effort = part.effort
        if not np.isfinite(effort):
            unsaid.append(part.name)
            effort = USUAL_EFFORT[part.kind]
        elif not 0 < effort <= LARGEST_EFFORT[part.kind]:
            unbelieved.append(part.name)
            effort = USUAL_EFFORT[part.kind]
        kp = _two_digits(effort / SERVO_TRAVEL[part.kind])
        groups.setdefault((kp, effort), []).append(part.name)
    index = {j.name: k for k, j in enumerate(structure.joints)}
    actuators = []
    for (kp, effort), names in groups.items():
        critical = [2 * np.sqrt(kp * inertia[index[n]]) for n in names]
        own = [structure.joints[index[n]].damping for n in names]
        # a joint's own damping does its part; one that is too large is replaced (joint_defaults)
        missing = [
            c - d if d <= SLOWEST_JOINT * kp else c / 2 for c, d in zip(critical, own, strict=True)
        ]
        actuators.append(
            ActuatorDescription(
                joints=tuple(names),
                kp=kp,
                damping=_two_digits(max(*missing, 0.0)),
                force_limit=effort,
            )
        )
    if actuators:
        notes.because(
            "actuators",
            f"position servos for {sum(len(a.joints) for a in actuators)} joints",
            "neither an actuator nor a coupling of the model holds them; kp brings the "
            f"whole force at {SERVO_TRAVEL['hinge']} rad ({1e3 * SERVO_TRAVEL['slide']:g} mm), "
            "damping makes that of the joint critical for the inertia that the heaviest of "
            "them moves, rotor and all",
        )
    if unbelieved:
        worst = max(structure.joints[index[n]].effort for n in unbelieved)
        notes.ask(
            f"the model allows up to {worst:g} N m on {_listed(unbelieved)}, more than most "
            f"fingers have: {USUAL_EFFORT['hinge']} N m is proposed; set force_limit to the file's "
            "where that is your hand's"
        )
    if unsaid:
        notes.ask(
            f"the model does not say how strong {_listed(unsaid)} are: {USUAL_EFFORT['hinge']} N m "
            f"({USUAL_EFFORT['slide']} N) is proposed; set force_limit to your hand's"
        )
    return tuple(actuators)


def joint_defaults(
    structure: ModelStructure,
    added: Sequence[ActuatorDescription],
    inertia: FloatArray,
    notes: Notes,
) -> JointDefaults:
    """Damping and friction with which servos work, and rotors for joints that have none.

    Args:
        structure: The hand.
        added: Proposed servos.
        inertia: (nv,), what each joint moves in the model, its rotor included, kg m2 (kg).
        notes: Gets reasons and open questions.
    """
    if added:
        inertia = inertia + _missing_armature(structure)
    n = len(structure.joints)
    index = {j.name: k for k, j in enumerate(structure.joints)}
    kp, force = np.full(n, np.nan), np.full(n, np.inf)
    for actuator in structure.actuators:
        for k in np.flatnonzero(actuator.row):
            kp[k] = np.nanmax([kp[k], actuator.stiffness * actuator.row[k] ** 2])
            force[k] = min(force[k], actuator.force_limit * abs(actuator.row[k]))
    for servo in added:
        for name in servo.joints:
            kp[index[name]], force[index[name]] = servo.kp, servo.force_limit
    damping = np.array([j.damping for j in structure.joints])
    friction = np.array([j.frictionloss for j in structure.joints])
    driven = kp > 0
    slow = driven & (damping > SLOWEST_JOINT * kp)
    sticky = driven & (friction > STICKIEST_JOINT * force)
    values = {}
    if slow.any():
        worst = int(np.argmax(np.where(slow, damping / np.where(driven, kp, 1.0), 0.0)))
        values["damping"] = _two_digits(float(np.nanmax(2 * np.sqrt(kp * inertia)[driven])) / 2)
        notes.because(
            "joint_defaults.damping",
            f"{values['damping']:g} N m s/rad, half the critical damping",
            f"the model says {damping[worst]:g} for {structure.joints[worst].name}, whose "
            f"servo has kp {kp[worst]:g}: it would take {damping[worst] / kp[worst]:.1f} s to "
            "close most of an error",
        )
    if sticky.any():
        worst = int(np.argmax(np.where(sticky, friction, 0.0)))
        values["frictionloss"] = 0.0
        notes.because(
            "joint_defaults.frictionloss",
            "0",
            f"the model says {friction[worst]:g} for {structure.joints[worst].name}, whose "
            f"servo gives {force[worst]:g} at most: it would hardly move",
        )
    if added and _missing_armature(structure).any():
        values["least_armature"] = USUAL_ARMATURE
        kept = [j.name for j in structure.joints if j.armature >= USUAL_ARMATURE]
        notes.because(
            "joint_defaults.least_armature",
            f"{USUAL_ARMATURE:g} kg m2",
            "the proposed servos have rotors, which the model does not know; light links "
            "would swing at rates that a time step of 2 ms does not resolve"
            + (f"; {_listed(kept)} keep the armature that the model gives" if kept else ""),
        )
    return JointDefaults(**values)


def _missing_armature(structure: ModelStructure) -> FloatArray:
    """Inertia (nv,) that brings each joint's rotor to a usual one, kg m2 (kg)."""
    return np.maximum(USUAL_ARMATURE - np.array([j.armature for j in structure.joints]), 0.0)


def _two_digits(value: float) -> float:
    return float(f"{value:.2g}")


def _listed(names: Sequence[str]) -> str:
    """The first names and how many there are."""
    few = ", ".join(names[:3])
    return few if len(names) <= 3 else f"{few} and {len(names) - 3} other joints"
