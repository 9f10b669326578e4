"""What drives a hand: couplings that cannot hold, and stops that carry a contact.

A stop is a tendon limit, or the end of a joint's range, that takes up what no actuator can: the
side is the one that resists a contact pressing on the pad.

Joints that nothing holds get servos, and passive properties with which they work. A servo's damping
is sized for the inertia that is simulated: links, the model's own rotors, and those that are added
where the model has none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planner.bridge.structure import ModelStructure, TendonPart
from planner.describe.proposal import Notes
from planner.joints.couplings import Coupling, coupled_extreme
from planner.joints.description import ActuatorDescription, CouplingDescription, JointDefaults
from planner.spatial import FloatArray

LEAST_TRAVEL = 0.05
"""A coupling that leaves every joint that it ties less than this share of its range is wrong."""

AGREED = 0.8
"""Share of contacts that run a joint to one end of its range, less the share that run it to the
other, below which the stop becomes an open question: nine of ten agree."""

NARROW = 0.25
"""A tendon ties its joints if its limits span less than this share of the joints' ranges (-)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PadContact:
    """Joint torque (nq,) with which a contact presses with unit force at q."""

    q: FloatArray
    torque: FloatArray


def impossible_couplings(
    couplings: Sequence[Coupling], lower: FloatArray, upper: FloatArray
) -> tuple[str, ...]:
    """Names of equalities that the joint ranges forbid, or that freeze every joint they tie."""
    span = np.maximum(upper - lower, 1e-12)
    out = []
    kept: list[Coupling] = []
    for coupling in couplings:
        trial = [*kept, coupling]
        joints = np.flatnonzero(coupling.row)
        travel = 0.0
        for k in joints:
            ends = []
            for sign in (1.0, -1.0):
                cost = np.zeros(len(lower))
                cost[k] = sign
                found = coupled_extreme(cost, trial, lower, upper)
                ends.append(np.nan if found is None else float(found[k]))
            travel = max(travel, np.nan_to_num((ends[1] - ends[0]) / span[k]))
        if travel >= LEAST_TRAVEL:
            kept.append(coupling)
        else:
            out.append(coupling.name)
    return tuple(out)


def stops_and_springs(
    structure: ModelStructure,
    equalities: Sequence[Coupling],
    lower: FloatArray,
    upper: FloatArray,
    contacts: Sequence[PadContact],
    notes: Notes,
) -> tuple[CouplingDescription, ...]:
    """Couplings for limited and for elastic tendons that hold joints which nothing else holds."""
    names = [j.name for j in structure.joints]
    held = [a.row for a in structure.actuators] + [c.row for c in equalities]
    out = []
    for tendon in structure.tendons:
        tied = np.flatnonzero(tendon.row)
        settled = _is_driven(structure, tendon) or in_span(tendon.row, [c.row for c in equalities])
        if len(tied) < 2 or settled:
            continue
        low, high = _reach(tendon.row, lower, upper)
        loose = not in_span(tendon.row, held)
        scale = float(np.abs(tendon.row).max())
        limits = tendon.limits
        narrow = limits is not None and limits[1] - limits[0] < NARROW * (high - low)
        joints = {names[k]: _tidy(tendon.row[k] / scale) for k in tied}
        if limits is not None and (loose or narrow):
            sign = _resisting_side(tendon.row, held, contacts)
            bound = limits[0] if sign > 0 else limits[1]
            if low + 1e-6 < bound < high - 1e-6:
                coupling = CouplingDescription(
                    name=tendon.name,
                    joints={j: sign * c for j, c in joints.items()},
                    value=_tidy(sign * bound / scale),
                    kind="stop",
                )
                out.append(coupling)
                held.append(tendon.row)
                notes.because(
                    f"couplings.{coupling.name}",
                    f"{'lower' if sign > 0 else 'upper'} limit of tendon {tendon.name}",
                    "a contact that presses on the pad runs the tendon to this limit"
                    + (
                        ", and no actuator holds what it ties"
                        if loose
                        else "; its limits leave the joints hardly any freedom"
                    ),
                )
                continue
        if loose and tendon.stiffness > 0:
            rest = (tendon.rest[0] + tendon.rest[1]) / 2
            coupling = CouplingDescription(
                name=tendon.name,
                joints=joints,
                value=_tidy(rest / scale),
                kind="equality",
            )
            out.append(coupling)
            held.append(tendon.row)
            notes.because(
                f"couplings.{coupling.name}",
                "the spring of the tendon at rest, as if it were stiff",
                f"only the spring of tendon {tendon.name} ({tendon.stiffness:g} N/m) holds "
                "what it ties; give the real coupling if you know it",
            )
    return tuple(out)


def joint_stops(
    structure: ModelStructure,
    held: Sequence[FloatArray],
    lower: FloatArray,
    upper: FloatArray,
    contacts: Sequence[PadContact],
    notes: Notes,
) -> tuple[CouplingDescription, ...]:
    """Stops for joints that one actuator drives together: it holds their sum and nothing else.

    The rest is left to contact. A contact that presses on the pad runs one of the joints to an end
    of its range, and there the other ones are driven alone. Of the ends that the contacts run to,
    the one nearest to zero is taken, so that the finger is as stretched as it can be.

    Args:
        structure: The hand.
        held: Rows (nv,) of actuators and couplings.
        lower: Joint limits (nv,).
        upper: Joint limits (nv,).
        contacts: What contacts ask of the joints.
        notes: Gets reasons and open questions.
    """
    names = [j.name for j in structure.joints]
    rows, out = list(held), []
    for actuator in structure.actuators:
        together = [int(k) for k in np.flatnonzero(actuator.row)]
        listed = " and ".join(names[k] for k in together)
        while len(together) > 1:
            ends = []
            for k in together:
                unit = np.eye(len(names))[k]
                if in_span(unit, rows):
                    continue
                balance = _balance(unit, rows, contacts)
                at_lower = balance >= 0 if balance else abs(lower[k]) <= abs(upper[k])
                end = lower[k] if at_lower else upper[k]
                ends.append((abs(end), k, 1.0 if at_lower else -1.0, float(end), balance))
            if not ends:
                break
            _, k, sign, end, balance = min(ends)
            rows.append(np.eye(len(names))[k])
            name = f"{names[k]}_stop"
            out.append(
                CouplingDescription(
                    name=name, joints={names[k]: sign}, value=_tidy(sign * end), kind="stop"
                )
            )
            notes.because(
                f"couplings.{name}",
                f"{'lower' if sign > 0 else 'upper'} end of the range of {names[k]}",
                f"actuator {actuator.name} drives {listed} together and holds their sum "
                f"alone: a contact that presses on the pad runs {names[k]} to this end of its "
                "range. No motor and no tie is added; if a gear of your hand ties the joints, "
                'describe it instead with kind = "equality"',
            )
            if abs(balance) < AGREED:
                notes.ask(
                    f"{listed} share the actuator {actuator.name}, and contacts on the pad run "
                    f"{names[k]} to either end of its range, as the finger stands: the stop at "
                    f"{end:.3g} holds in {50 * (1 + abs(balance)):.0f} % of the configurations"
                )
    return tuple(out)


def _is_driven(structure: ModelStructure, tendon: TendonPart) -> bool:
    """Whether an actuator pulls along the tendon itself: its limits are that actuator's range."""
    return any(in_span(tendon.row, [a.row]) for a in structure.actuators)


def _resisting_side(
    row: FloatArray, held: Sequence[FloatArray], contacts: Sequence[PadContact]
) -> float:
    """+1 if the contacts need a push towards larger row @ q, -1 if towards smaller."""
    return 1.0 if _balance(row, held, contacts) >= 0 else -1.0


def _balance(row: FloatArray, held: Sequence[FloatArray], contacts: Sequence[PadContact]) -> float:
    """Share of the contacts that need a push towards larger row @ q, less that of the others.

    Only torque that nothing holds counts: wanted torque and row are projected out of the span of
    the rows that hold, unless everything is held. Contacts without torque along the row do not
    count; 0 if none counts.
    """
    basis = np.array(held).reshape(-1, len(row))
    free = np.eye(len(row)) - np.linalg.pinv(basis) @ basis if len(basis) else np.eye(len(row))
    part = free @ row
    if np.linalg.norm(part) < 1e-6 * np.linalg.norm(row):
        part = row
    votes = [float(np.sign(part @ c.torque)) for c in contacts if (c.torque * row).any()]
    return sum(votes) / len(votes) if votes else 0.0


def in_span(row: FloatArray, rows: Sequence[FloatArray]) -> bool:
    """Whether a row is a sum of multiples of others."""
    if not len(rows):
        return False
    basis = np.array([r / max(float(np.linalg.norm(r)), 1e-12) for r in rows])
    rest = row - basis.T @ np.linalg.lstsq(basis.T, row, rcond=1e-9)[0]
    return bool(np.linalg.norm(rest) < 1e-6 * np.linalg.norm(row))


def _reach(row: FloatArray, lower: FloatArray, upper: FloatArray) -> tuple[float, float]:
    ends = np.stack([row * lower, row * upper])
    return float(ends.min(axis=0).sum()), float(ends.max(axis=0).sum())


def _tidy(value: float) -> float:
    """Rounded: without the noise of the last digits."""
    return float(f"{value:.9g}") + 0.0


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
