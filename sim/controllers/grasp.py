"""``GraspController``: opens, closes until every finger touches, then presses as planned.

Closing is guarded (``sim.controllers.closing``), and done again where joints were off.

Pressing is force control with a spring around the posture in which all fingers touched:

    torque = sum_i J_i(q)^T f_i + gravity(q),   f_i the planned forces, turned with the object
    ctrl   = the actuators' affine law solved for that torque at (q_ref, v = 0)

Solving the law at the latched posture q_ref instead of the measured one leaves every servo its own
stiffness and damping: at q = q_ref it gives exactly the torque that is wanted, elsewhere a spring
adds kp (q_ref - q). That spring is what keeps the object still, since planned forces alone are in
neutral equilibrium. Joints whose actuators have no stiffness (motors) get one here.

Of an object that cameras saw in part (``GraspObject.belief``) forces are planned again, when the
squeeze begins, over the contacts that pads feel, by the programme of the plan; ``refused`` says why
those do not close or bear the weight, then and before the lift.

``Reclosing``: closes until felt; if the contacts contradict the joints, opens and closes anew.

Called by ``GraspController`` in the phase "close". The first closing finds out where the joints
are (``sim.controllers.calibration``), with light touches that move nothing. If they are off, the
fingers open again, at the joints that were found, and come down where the plan wants them. Exact
joints touch once.

The phase must not end while that goes on: ``closing_ended`` tells a simulation when it may.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from planner.contacts import ContactSet
from planner.forces import ForceArguments, distribute_forces
from planner.hands.hand import Hand
from planner.joints.actuation import Actuation
from planner.plan import GraspPlan
from planner.quality import force_closure
from planner.spatial import SE3, FloatArray, contact_frames, cross, minimum_jerk
from planner.tolerances import CLOSURE_EDGES, FRICTION_SHARE
from planner.verification import force_arguments, no_forces
from sim.controllers.base import TOUCH_FORCE, Observation, Recloses, Sense
from sim.controllers.calibration import Calibration, StopCorrection, servo_commands
from sim.controllers.closing import GuardedClosing
from sim.controllers.hand_dynamics import (
    ContactForceLimit,
    FrictionEstimate,
    HandLoads,
    MotorServo,
)

OPEN_TIME, CLOSE_TIME = 0.3, 0.5
"""Time (s) to open after the first touch, and to close again: as a trial's own closing."""

LONGEST = 1.0
"""Longest time (s) for fingers that do not touch, once the way of a closing is over."""

RECLOSING_TIME = OPEN_TIME + CLOSE_TIME + LONGEST
"""Longest time (s) that a second closing takes."""

LEAST_TOUCHING = 2
"""Fewest fingers whose contacts are worth opening the hand for, if the others do not come."""


class Reclosing:
    """Reference posture while the fingers close, once or twice.

    Attributes:
        again: Whether it opened and closes a second time.
        busy: Whether the second closing goes on, though all fingers may touch.
    """

    def __init__(self, plan: GraspPlan, calibration: Calibration) -> None:
        """Prepare the first closing; the calibration is written."""
        self._plan, self._calibration = plan, calibration
        self._closing = self._first = GuardedClosing(plan)
        self._time, self._arrived = 0.0, 0.0
        self._from = plan.q
        self._compared = False
        self.again = self.busy = False

    @property
    def careful(self) -> bool:
        """Whether a touch came too early for exact joints."""
        return self._closing.careful

    def make_way(self, elapsed: float, observation: Observation) -> FloatArray:
        """Reference posture (nq,) on the way in."""
        return self._closing.make_way(elapsed, observation)

    def step(self, elapsed: float, observation: Observation) -> FloatArray:
        """Reference posture (nq,)."""
        if self.again:
            return self._second(elapsed, observation)
        arrived = observation.progress >= 1.0
        self._arrived += elapsed * arrived
        touching = int((observation.normal_forces >= TOUCH_FORCE).sum())
        late = self._arrived > LONGEST - OPEN_TIME and touching >= LEAST_TOUCHING
        if not self._compared and ((arrived and observation.all_touch) or late):
            self._compared = True
            if self._calibration.learn(observation):
                self.again = self.busy = True
                self._from = observation.q.copy()
        return self._closing.step(elapsed, observation)

    def _second(self, elapsed: float, observation: Observation) -> FloatArray:
        """Open, then close at the joints that were found."""
        self._time += elapsed
        since, offset = self._time - OPEN_TIME, self._calibration.offset
        if since < 0.0:
            share = float(minimum_jerk(np.asarray(self._time / OPEN_TIME)))
            return np.asarray(self._from + share * (self._plan.q_pregrasp + offset - self._from))
        if self._closing is self._first:
            self._closing = GuardedClosing(self._plan)
        seen = replace(observation, q=observation.q - offset, progress=min(1.0, since / CLOSE_TIME))
        if observation.all_touch or since > CLOSE_TIME + LONGEST:
            self.busy = False
        return np.asarray(self._closing.step(elapsed, seen) + offset)


def closing_ended(
    controller: object, wait: float, timestep: float
) -> Callable[[Observation], bool]:
    """Whether the phase "close" may end; asked after every step once its duration is over.

    Args:
        controller: Who closes; one that is no ``Recloses`` closes once.
        wait: Longest time (s) for fingers that do not touch; a second closing may take
            ``RECLOSING_TIME`` more.
        timestep: s.
    """
    most, steps = round(wait / timestep), 0

    def over(seen: Observation) -> bool:
        nonlocal steps
        steps += 1
        if isinstance(controller, Recloses) and controller.closing:
            return False
        return seen.all_touch or steps > most

    return over


FIRST_SHARE = 0.1
"""Share of the planned forces at which the squeeze begins: about the force of first touch."""

LIMIT_TOL = 1e-6
"""How far (N, N m) a wanted force may lie beyond its limit: rounding."""


LIGHT_PERIOD = 0.005
"""Longest time between steps (s) at which the contact force is limited before the squeeze. The
limit turns servos into sources of torque with what was just read; at 100 Hz over a network with
late packets that swings, and the object was dropped (examples/20_hand_over_udp.py)."""


SHARES = (0.5, 0.7, FRICTION_SHARE)
"""Shares of the friction (-) within which felt forces are looked for, one after the other: normals
that are felt by joints off by a degree are off by two or three."""

LOOKED = 0.8
"""Share of the phase "settle" (-) after which contacts, now under full forces, are looked at again.
"""

MOST_FELT, MOST_FREE = 100.0, 3.0
"""Normal force (N) without limit: beyond that of any actuator; times 0 for a finger that feels
nothing. Without torque limits the largest planned one times this (-): within less of the friction
programmes answered with 97 N where 4 were planned, and fingers swung past the object."""


class GraspController:
    """Executes the fingers' part of a plan.

    Attributes:
        needs: Senses without which it cannot work.
        uses: What it corrects its joints by, where there is a sense for it.
        plan: What is executed.
        q_ref: Posture (nq,) around which the hand is held at present, as encoders read it.
        calibration: Encoder offsets that the first touch found.
        friction: Dry friction of the joints that was felt before the first touch.
        share: Share (-) of the planned forces that it presses with at present; may be set.
        refused: Why the contacts that are felt of a believed object are not to be lifted by; "" if
            they are, or the object is known.
    """

    needs: tuple[Sense, ...] = ("touch", "object_pose")
    uses: tuple[Sense, ...] = ("pads",)

    def __init__(self, plan: GraspPlan) -> None:
        """Prepare forces in the object's frame, search directions and gains."""
        self.plan = plan
        task = plan.task
        self._hand: Hand = task.hand
        self._fingers = task.fingers
        self._gravity = task.gravity
        self._take(plan.contacts_in_object)
        self.calibration = Calibration(plan)
        self._closing = Reclosing(plan, self.calibration)
        self._light = ContactForceLimit(self._hand)
        self.friction = FrictionEstimate(self._hand)
        self._stops = StopCorrection(self._hand.actuation, plan.q)
        self._servo = MotorServo(self._hand, plan.q)
        self._loads = HandLoads(self._hand, self._fingers)
        self._still = np.zeros(self._hand.nq)
        self._torque = np.zeros(self._hand.nq)
        self._latched = False
        self._time = 0.0
        self.share = 1.0
        self.refused = ""
        self._feels = task.object.belief is not None and task.is_of_fingertips
        self.q_ref = plan.q_pregrasp.copy()
        self._law_q = self.q_ref

    def step(self, observation: Observation) -> FloatArray:
        """Commands (nu,) for the hand's actuators."""
        elapsed, self._time = observation.time - self._time, observation.time
        gravity = observation.T_world_base.rotation.T @ self._gravity
        offset = self.calibration.offset
        weight = self._loads.move(observation.q - offset, gravity)
        torque = weight.copy()
        if observation.phase == "close":
            self.q_ref = self._closing.step(elapsed, observation)
        elif observation.phase == "approach":
            self._come(elapsed, observation)
            if self._feels and observation.normal_forces.any():
                self.refused = "a finger felt the object on the way in"
        else:
            if not self._latched:
                self._latched = True
                self._servo.rest()
                self.q_ref = observation.q.copy()
                self._feels = self._feels and observation.reads_pads
                if self._feels:
                    self._feel(observation)
            if self._feels and observation.phase == "settle" and observation.progress > LOOKED:
                self._feels = False
                self.refused = not_closed(*felt_contacts(self.plan, observation))
            pressing = self.share * self._pressing_torque(observation)
            if observation.phase == "squeeze":
                ramp = float(minimum_jerk(np.asarray(observation.progress)))
                pressing *= FIRST_SHARE + (1.0 - FIRST_SHARE) * ramp
            torque += pressing
        torque += self._servo.torque(observation.time, self.q_ref, observation.q, observation.v)
        self._torque = torque
        self._law_q = self.q_ref
        if self._latched:
            true = self.q_ref - offset if offset.any() else self.q_ref
            self._law_q = self._stops.corrected(true)
        ctrl = servo_commands(self._hand.actuation, self.q_ref, self._law_q, self._still, torque)
        if self._latched:
            return ctrl
        if elapsed <= LIGHT_PERIOD:
            ctrl = self._light.commands(ctrl, observation.q, observation.v, weight)
        if not observation.normal_forces.any():
            self.friction.update(elapsed, ctrl, observation.q, observation.v, weight)
        return ctrl

    @property
    def closing(self) -> bool:
        """Whether the closing goes on though all fingers touch."""
        return self._closing.busy

    def _come(self, elapsed: float, observation: Observation) -> None:
        """On the way in: fingers that touch make way; else it holds what it was given to hold."""
        opened = self._closing.make_way(elapsed, observation)
        if (opened != self.plan.q_pregrasp).any():
            self.q_ref = opened

    def _take(self, contacts: ContactSet) -> None:
        """Press by contacts in the object's frame, with their forces, from now on."""
        self._points = contacts.positions
        self._forces = contacts.forces_in_axes()
        soft = np.array([m == "soft" for m in contacts.models])
        torsion = np.where(soft, np.nan_to_num(contacts.forces[:, 3]), 0.0)
        self._moments = torsion[:, None] * contacts.normals
        self._twists = bool(torsion.any())

    def _feel(self, observation: Observation) -> None:
        """Plan the forces again over the contacts that are felt; or say why they are none."""
        felt, contacts = felt_contacts(self.plan, observation)
        self.refused = not_closed(felt, contacts)
        if self.refused:
            return
        task, base = self.plan.task, observation.T_world_base
        limited = force_arguments(task, contacts, base, observation.q)
        free: ForceArguments = {"wrench": limited["wrench"]}
        # fingers with fewer drives than joints press in one direction alone, and the surface is
        # elsewhere: what no drive gives is then left to the finger's own bones
        most = MOST_FREE * float(self.plan.contacts.forces[:, 0].max())
        limited["max_normal"], free["max_normal"] = MOST_FELT * felt, most * felt
        for given, share in product((limited, free), SHARES):
            given["min_normal"] = task.grip_force * felt
            given["friction_scale"] = share
            forces = distribute_forces(contacts, **given)
            if forces.found:
                break
        if forces.found:
            self._take(forces.contacts.transformed(observation.T_world_object.inverse()))
        else:
            self.refused = f"over the contacts that are felt, {no_forces(task, forces).text}"

    def saturated_actuators(self) -> tuple[str, ...]:
        """Names of the actuators that could not give what the last step wanted."""
        return saturated(self._hand.actuation, self._law_q, self._torque)

    def _pressing_torque(self, observation: Observation) -> FloatArray:
        """Joint torques (nq,) of the full planned forces at the object's present pose.

        The hand must have been moved to the joints of now.
        """
        T_base_object: SE3 = observation.T_world_base.inverse() * observation.T_world_object
        turn = T_base_object.rotation.T
        points = self._points @ turn + T_base_object.translation
        forces = self._forces @ turn
        # wrenches on the object about the base's origin
        moments = cross(points, forces)
        if self._twists:
            moments += self._moments @ turn
        return self._loads.torque(forces, moments)


class Opening(GraspController):
    """Opens fingers from where they are to their pre-grasp, and keeps them there."""

    _closed: FloatArray | None = None

    def _come(self, elapsed: float, observation: Observation) -> None:
        """Nothing: the fingers open whether they touch or not."""

    def step(self, observation: Observation) -> FloatArray:
        """Commands (nu,) for the hand's actuators."""
        if self._closed is None:
            self._closed = observation.q.copy()
        share = observation.progress if observation.phase == "open" else 1.0
        way = self.plan.q_pregrasp - self._closed
        self.q_ref = self._closed + float(minimum_jerk(np.asarray(share))) * way
        return super().step(replace(observation, phase="approach"))


def felt_contacts(plan: GraspPlan, seen: Observation) -> tuple[NDArray[np.bool_], ContactSet]:
    """Which fingers (n,) feel the object, and their contacts, world; planned ones of the others."""
    pads = seen.pads
    felt = (pads.normal_force > 0.0) & np.isfinite(pads.position).all(axis=1)
    there = plan.contacts_in_object.transformed(seen.T_world_object)
    normals = np.where(felt[:, None], pads.normal, there.normals)
    positions = np.where(felt[:, None], pads.position, there.positions)
    return felt, replace(there, positions=positions, frames=contact_frames(normals))


def not_closed(felt: NDArray[np.bool_], contacts: ContactSet) -> str:
    """Why the contacts that are felt do not close, "" if they do."""
    names = [name for name, feels in zip(contacts.fingers, felt, strict=True) if feels]
    if not names:
        return "no finger feels the object"
    there = ContactSet.from_arrays(
        contacts.positions[felt],
        contacts.normals[felt],
        mu=contacts.mu[felt],
        mu_torsion=contacts.mu_torsion[felt],
        model=[contacts.models[i] for i in np.flatnonzero(felt)],
        center=contacts.center,
    )
    found = force_closure(there, CLOSURE_EDGES)
    return "" if found.closed else f"the contacts felt by {', '.join(names)} do not close"


def saturated(actuation: Actuation, q: FloatArray, torque: FloatArray) -> tuple[str, ...]:
    """Names of the actuators whose limits at q (nq,) are below what a joint torque (nq,) takes."""
    beyond = actuation.short_of(q, torque, LIMIT_TOL)
    return tuple(actuation.names[i] for i in np.flatnonzero(beyond)) if beyond.any() else ()
