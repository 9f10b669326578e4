"""``ObjectImpedance``: holds the object at its target pose against disturbances.

Approach and closing are those of ``GraspController``. From the squeeze on, at every step (in the
phases ``REFERENCE_PHASES`` a ``Reference`` may move the targets of object and fingers):

    wrench   impedance of the object's pose in the hand (``sim.controllers.impedance``), and its
             believed weight; its velocity comes from the joints, as the contacts stick
    forces   the least contact forces that give that wrench within friction, normal forces and
             actuators (``planner.forces.ForceLoop``), at the contacts that the pads feel
    ctrl     joint torques for these forces (``sim.controllers.torques``), through motors, servos
             or tendons, and for the joints' dry friction (``sim.controllers.hand_dynamics``)

Between two hands the object follows its planned path in the world, and palms that touch are
commanded through their carriages (``sim.controllers.two_hands``).

What it notices and what it does then:
    contact lost    the forces are planned over the others at once; the finger searches along its
                    last normal, and takes its share again when it feels the object
    slip            beyond what spinning explains: all press harder by ``GRIP_STEP``; where the pad
                    slipped at less friction than was believed, what it felt minus a margin is
                    believed of that finger from now on
    infeasible      the forces that come nearest within all limits are given, and fingers that only
                    press on each other ease off: the wrench comes before the grip, unless it comes
                    of an estimate and the object is only held
    gave up         fewer fingers than can hold the object, or infeasible, for too long
                    (``InfeasibilityMonitor``): nothing is learned or tightened any more, and
                    the reason is kept, until it is over
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from planner.errors import NotFoundError, TaskError
from planner.forces import ForceLoop, QuadraticCost, turned_frames
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray, minimum_jerk
from sim.controllers.base import (
    TOUCH_FORCE,
    Event,
    EventKind,
    Observation,
    PadReading,
    Phase,
    Reference,
    Sense,
)
from sim.controllers.calibration import StopCorrection
from sim.controllers.grasp import FIRST_SHARE, GraspController
from sim.controllers.impedance import (
    EstimateCorrection,
    ImpedanceGains,
    ImpedanceLaw,
    effective_inertia,
)
from sim.controllers.monitors import ContactSchedule, InfeasibilityMonitor, SlipDetector
from sim.controllers.torques import HoldingTorques, twist_of
from sim.controllers.two_hands import ObjectPath, check_two_hands, with_soft_palms

MAX_NORMAL = 40.0
"""Largest normal force (N) that a pad is asked for; the actuators usually end far below."""

MOST_OF_PLANNED = 2.0
"""Times (-) its planned force that a contact of two hands is asked for at most, if that is more
than ``MAX_NORMAL``: palms press with what carries kilograms."""

CHANGE_COST = 2.0
"""Cost of a squared change of force relative to a squared force (-): smooths internal forces, which
do not change the wrench."""

FRICTION_EDGES = 16
"""Sides of the inscribed friction pyramids (-): 98 % of the friction, cos(pi / 16), instead of 92 %
with 8 sides. The load promised by the certificate of the round cone shrinks by as much."""

RESERVE_COST = 10.0
"""Cost of the squared normal force that a contact lacks for a friction reserve of 20 %, relative to
a squared force (-). Least forces lie on the cone's edge, where the first jolt of a load makes pads
slip; with this cost the reserve is kept unless the load needs all of the friction."""

GRIP_STEP, MAX_GRIP = 1.3, 3.0
"""Factor on the least normal forces per slip, and the largest that comes of it (-)."""

LEAST_GRIP = 0.3
"""Share of the grip (-) that is kept whatever is missed of a wrench: a finger that presses less
loses the object at every jolt. Contacts lost in one turn: 5 instead of 33 with a share of 0.1
(``opposable manipulate allegro_hand cylinder:0.03x0.08 --rotate z:90 --seed 1``)."""

FRICTION_MARGIN, LEAST_MU = 0.85, 0.1
"""After a slip at less friction than was believed, friction is believed to be this share of what
was felt, and never less than this (-)."""

SWAYED = 1.0 + 2.0 * math.cos(math.radians(3.0))
"""Trace (-) of a rotation by 3 degrees: a palm that turns less stands still. A gantry that is
pushed with 7 N sways by more than one degree."""

CONFIRMED = 0.95
"""A slip at this share of the believed friction or more confirms it (-)."""

CARRYING: frozenset[Phase] = frozenset({"lift", "hold", "turn", "carry"})
"""Phases in which nothing but the hand holds the object: then loads and friction are learned."""

REFERENCE_PHASES: frozenset[Phase] = frozenset({"turn", "hold"})
"""Phases in which a reference sets the targets: after a turn too, to correct creep."""


class ObjectImpedance:
    """Closed-loop execution of a plan.

    Attributes:
        needs: Senses without which it cannot work.
        plan: What is executed.
        law: The impedance, with its gains and the learned load.
        schedule: Which fingers hold, from the squeeze on.
        T_palm_wanted: Where the object is to be kept, in the palm, or in the planned base of two
            hands; None before the squeeze. May be set.
        turning_time: Time (s) for which the palm counts as turning after a turn by ``SWAYED``:
            nothing is learned meanwhile.
        reference: Targets of object and fingers in ``REFERENCE_PHASES``; None keeps them.
        grip: Least normal force (N) of a finger that holds, at the end of the squeeze and before
            any slip; the task's at first. May be set.
        forces: (n, 4), contact forces of the last step in the contact frames, N and N m.
        calibration: Encoder offsets found by the first touch and when the squeeze was over.
    """

    needs: tuple[Sense, ...] = ("touch", "object_pose", "pads")
    turning_time: ClassVar[float] = 0.1

    def __init__(
        self,
        plan: GraspPlan,
        *,
        gains: ImpedanceGains | None = None,
        mass: float | None = None,
        mu: float | None = None,
        max_normal: float | None = None,
        costs: Sequence[QuadraticCost] = (),
    ) -> None:
        """Prepare for a plan.

        Args:
            plan: What to execute.
            gains: Of the impedance; from what moves with the object if None.
            mass: Mass that the object is believed to have, kg; the task's if None.
            mu: Friction that the contacts are believed to have (-); the task's if None.
            max_normal: Largest normal force that a pad is asked for, N; ``MAX_NORMAL`` if None, of
                two hands at least ``MOST_OF_PLANNED`` times the planned one.
            costs: Costs of your own of the contact forces, in every step.

        Raises:
            ContactError: A cost of another number of force components.
            TaskError: A mass, a friction or a largest force that is not positive.
        """
        task = plan.task
        self.plan = plan
        self._mass = task.object.mass if mass is None else mass
        first_mu = task.mu if mu is None else mu
        for name, value, unit in (
            ("believed mass", self._mass, " in kg"),
            ("believed mu", first_mu, ""),
            ("largest normal force", MAX_NORMAL if max_normal is None else max_normal, " in N"),
        ):
            if not (np.isfinite(value) and value > 0):
                raise TaskError(f"the {name} is {value}; give a number > 0{unit}")
        most = np.full(len(task.fingers), MAX_NORMAL if max_normal is None else max_normal)
        if task.hand.pair and max_normal is None:
            most = np.maximum(most, MOST_OF_PLANNED * plan.contacts.forces[:, 0])
        self._max_normal = most
        self._costs = tuple(costs)
        if task.hand.pair:
            check_two_hands(task)
        else:
            task.require_fingertips("the closed loop")
        n = len(task.fingers)
        if gains is None:
            felt_mass, inertia = effective_inertia(plan, self._mass)
            gains = ImpedanceGains.of_body(mass=felt_mass, inertia=inertia)
        self.law = ImpedanceLaw(gains)
        self.schedule = ContactSchedule(np.zeros(n, dtype=bool))
        self.T_palm_wanted: SE3 | None = None
        self.reference: Reference | None = None
        self.grip = task.grip_force
        self.forces = np.zeros((n, 4))
        self._events: list[Event] = []
        self._opening = GraspController(plan)
        self.calibration = self._opening.calibration
        self._slips = SlipDetector(n)
        self._torques = HoldingTorques(plan)
        self._stops = StopCorrection(task.hand.actuation, plan.q)
        self._correction = EstimateCorrection()
        self._calibrated = self._moved = False
        self._loaded: FloatArray = plan.T_world_base.rotation.T
        self._turned = self._loaded if task.hand.pair else plan.T_world_palm.rotation.T
        self._turning_until = 0.0
        self._first_mu = first_mu
        self._mu = np.full(n, first_mu)
        self._grip = 1.0
        self._path = ObjectPath(task, self._mass) if task.hand.pair else None
        self._grip_share = np.ones(n)
        if task.hand.pair and task.grip_force > 0:
            self._grip_share = task.least_normals / task.grip_force
        self._faces = np.array([finger.is_link for finger in task.fingers])
        self._planned = plan.contacts_in_object
        self._contacts = with_soft_palms(
            task, plan.contacts.transformed(plan.T_world_base.inverse())
        )
        self._soft = "soft" in self._contacts.models
        self._points = np.array(self._contacts.positions)
        self._frames = np.array(self._contacts.frames)
        self._loop = self._make_loop()
        self._time = 0.0
        self._infeasibility = InfeasibilityMonitor(
            task.fingers_needed, task.finger_names, task.object.name
        )

    @property
    def events(self) -> tuple[Event, ...]:
        """What it noticed, in order."""
        return tuple(self._events)

    @property
    def closing(self) -> bool:
        """Whether the closing goes on though all fingers touch."""
        return self._opening.closing

    @property
    def gave_up(self) -> str:
        """Why it gave up, "" while it has not."""
        return self._infeasibility.gave_up

    def saturated_actuators(self) -> tuple[str, ...]:
        """Names of the actuators that could not give what the last step wanted."""
        if self.T_palm_wanted is None:
            return self._opening.saturated_actuators()
        return self._torques.saturated_actuators()

    def leave(self, finger: str) -> None:
        """Command a finger to give its force to the others and to go off the object.

        Raises:
            NotFoundError: No finger of that name takes part.
        """
        self._set_wanted(finger, False)

    def join(self, finger: str) -> None:
        """Command a finger to come back.

        Raises:
            NotFoundError: No finger of that name takes part.
        """
        self._set_wanted(finger, True)

    def keep(self) -> None:
        """Keep fingertips and posture where they are now; at rest they then press on nothing.

        Before fingers hold elsewhere: friction and grip learned from slips are reset, and the
        reference is dropped.
        """
        self.reference = None
        self._torques.latch(wrist=False)
        if self._grip > 1.0:
            self._grip = 1.0
            self._mu[:] = self._first_mu
            self._loop = self._make_loop()

    def step(self, observation: Observation) -> FloatArray:
        """Commands (nu,) for the hand's actuators."""
        elapsed, self._time = observation.time - self._time, observation.time
        if observation.phase in ("approach", "close"):
            return self._opening.step(observation)
        if not self._calibrated and observation.phase != "squeeze":
            self._calibrate(observation)
        read = observation.q
        observation = self.calibration.correct(observation)
        pads = observation.pads
        T_base_world = observation.T_world_base.inverse()
        gravity = T_base_world.rotation @ self.plan.task.gravity
        felt_gravity = gravity if self._path is None else gravity - self._path.acceleration
        self._torques.move(observation.q, observation.v, felt_gravity)
        T_base_palm = self._torques.T_base_palm
        in_palm = T_base_palm.actInv(T_base_world * observation.T_world_object)
        if self._moved:
            self._moved, self.T_palm_wanted = False, in_palm
            self._torques.latch()
            self._correction.forget()
        if self.T_palm_wanted is None:
            self.T_palm_wanted = in_palm
            self.schedule = ContactSchedule(pads.normal_force > TOUCH_FORCE)
            self._torques.latch()
            self._torques.compensate(self._opening.friction.extra)
        wanted_twist = np.zeros(6)
        follows = observation.phase in REFERENCE_PHASES and self.reference is not None
        if self.reference is not None and follows:
            wanted_twist = self._follow(self.reference, elapsed, in_palm, observation.q)
        if self._path is not None:
            self._path.follow(
                elapsed,
                self.T_palm_wanted,
                observation.T_world_base,
                observation.T_world_base_planned,
            )
            wanted_twist = wanted_twist + self._path.twist
        self._feel(elapsed, pads, T_base_world, in_palm)
        corrected = self._stops.corrected(observation.q)
        carries = observation.phase in CARRYING
        if carries and not self.gave_up:
            self._tighten(elapsed, pads)
        ramp = 1.0
        if observation.phase in ("squeeze", "release"):
            begins = observation.phase == "squeeze"
            ramp = observation.progress if begins else 1.0 - observation.progress
        scale = FIRST_SHARE + (1.0 - FIRST_SHARE) * float(minimum_jerk(np.asarray(ramp)))
        holding = self.schedule.holding
        pose = T_base_palm * in_palm
        moving = self._torques.touch(self._points, pose.translation, holding)
        held_back = self._torques.held_back(self._frames[:, :, 0])
        if follows:
            self._correction.forget()
        elif observation.uncertainty is not None:
            self.T_palm_wanted = self._correction.follow(
                self.T_palm_wanted,
                in_palm,
                self._carried(moving, pads, pose.translation, T_base_world, carries=carries),
                elapsed,
                observation.uncertainty,
            )
        twist = moving - wanted_twist
        if self._stops.acts:
            self._feel_stops(elapsed, observation, pads.force @ T_base_world.rotation.T)
        self._turn_load(T_base_world.rotation)
        wanted = T_base_palm * self.T_palm_wanted
        if self._path is not None:
            wanted = self._path.T_base_wanted
        wrench = self.law.wrench(wanted, pose, twist)
        wrench[:3] -= self._mass * gravity
        if self._path is not None:
            wrench += self._path.inertial + self.law.damped_by(self._torques.brake, twist)
        # where it only holds, a wrench that is in doubt is no reason to press less
        eases = follows or observation.uncertainty is None
        missed = self._distribute(
            scale * wrench, pose.translation, corrected, scale, held_back=held_back, eases=eases
        )
        further, missed = self._palm_moments(missed)
        if carries:
            self._judge(elapsed, wrench, missed)
        if carries and not self.gave_up and self._time >= self._turning_until:
            self.law.learn(elapsed, missed)
        forces = (self._frames @ self._given(pads)[:, :, None])[:, :, 0]
        normals = self._frames[:, :, 0]
        return self._torques.commands(
            *(forces, normals, holding, self.schedule.searching, corrected, read),
            moments=self.forces[:, 3] if self._soft else None,
            further=further,
        )

    def _given(self, pads: PadReading) -> FloatArray:
        """Contact forces (n, 3) that the fingers are to give, contact frames, N."""
        del pads
        return self.forces[:, :3]

    def _palm_moments(self, missed: FloatArray) -> tuple[FloatArray | None, FloatArray]:
        """Joint torques (nq,) by which palms give torque that is missing, and what still is (6,).

        Args:
            missed: Wrench of the forces beyond the wanted one (6,), N and N m.
        """
        springs = self._torques.springs
        if springs is None or not missed[3:].any():
            return None, missed
        torque, exerted = springs.moment(-missed[3:], self.forces[list(springs.palms), 0])
        return torque, missed + np.concatenate([np.zeros(3), exerted])

    def _turn_load(self, turn: FloatArray) -> None:
        """Keep the learned load where it is in the world while the wrist turns.

        Most of it is weight that was not believed. Kept in the base's axes it would count twice
        with the palm up. Meanwhile nothing is learned: the dry friction of joints that stand still
        takes the change of weight, and a load of 10 N was learned against it. On an arm the palm
        turns and the base stands.

        Args:
            turn: Rotation (3, 3) of the world in the base.
        """
        palm = self._torques.T_base_palm.rotation.T @ turn
        if np.trace(palm @ self._turned.T) < SWAYED:
            change = turn @ self._loaded.T
            self.law.load = (self.law.load.reshape(2, 3) @ change.T).ravel()
            self._loaded, self._turned = turn.copy(), palm
            self._turning_until = self._time + self.turning_time

    def _carried(
        self,
        tips: FloatArray,
        pads: PadReading,
        center: FloatArray,
        T_base_world: SE3,
        *,
        carries: bool,
    ) -> FloatArray:
        """Twist (6,) of the object about its centre as its contacts tell it, palm axes.

        Nothing while it stands on something: fingers that close around it do not move it.
        """
        if not carries:
            return np.zeros(6)
        holding = self.schedule.holding & (pads.normal_force > 0)
        sliding = np.nan_to_num(pads.sliding[holding] @ T_base_world.rotation.T)
        twist = tips + twist_of(sliding, self._points[holding] - center)
        turned: FloatArray = twist.reshape(2, 3) @ self._torques.T_base_palm.rotation
        return turned.ravel()

    def _follow(
        self, reference: Reference, elapsed: float, in_palm: SE3, q: FloatArray
    ) -> FloatArray:
        """Advance the reference and take over its targets; returns the wanted twist (6,)."""
        target = reference.advance(
            elapsed, in_palm, self._torques.tips_in_palm, q, missed=self._infeasibility.missed
        )
        self.T_palm_wanted = target.T_palm_object
        self._torques.aim(target.tips, target.q, target.v)
        self._stops.set_posture(target.q)
        turn = self._torques.T_base_palm.rotation
        return np.concatenate([turn @ target.twist[:3], turn @ target.twist[3:]])

    def _feel(
        self, elapsed: float, pads: PadReading, T_base_world: SE3, T_base_object: SE3
    ) -> None:
        """Take over where and how the fingers touch, and note what has changed.

        Of faces and lines only whether they touch: where the force acts on them moves with the
        moment that they exert, so a force that was aimed there would drive it on.
        """
        felt = ((pads.normal_force > 0) & ~self._faces)[:, None]
        turn = T_base_world.rotation
        points = pads.position @ turn.T + T_base_world.translation
        self._points = np.where(felt, points, self._torques.centers)
        normals = np.where(felt, pads.normal @ turn.T, self._frames[:, :, 0])
        if self._faces.any():
            there, face = self._planned.transformed(T_base_object), self._faces[:, None]
            self._points = np.where(face, there.positions, self._points)
            normals = np.where(face, there.normals, normals)
        self._frames = turned_frames(self._frames, normals)
        lost, found = self.schedule.step(elapsed, pads.normal_force)
        for i in np.flatnonzero(lost).tolist() if lost.any() else ():
            self._note("contact lost", i, "forces over the others; it searches")
        for i in np.flatnonzero(found).tolist() if found.any() else ():
            self._torques.latch(i)
            self._note("contact found", i, f"felt {pads.normal_force[i]:.2f} N")

    def _calibrate(self, observation: Observation) -> None:
        """Compare the joints with the contacts, once the squeeze is over."""
        self._calibrated = True
        if self._torques.springs is not None:
            self._torques.springs.latch()  # where they press as they should
        before = self.calibration.offset
        if self.calibration.learn(observation):
            self._stops.remove_offset(self.calibration.offset - before)
            self._moved = True  # hand and object are elsewhere than was believed: keep them there

    def _feel_stops(self, elapsed: float, observation: Observation, felt: FloatArray) -> None:
        """Tell the stops how the forces felt (n, 3), base axes, press on them."""
        q = observation.q
        torque = felt.ravel() @ self._torques.jacobians.reshape(-1, len(q))
        torque += self._torques.own_torque
        actuation = self.plan.task.hand.actuation
        _, pressing = actuation.split_torque(self._stops.corrected(q), torque)
        self._stops.update(elapsed, q, observation.v, pressing)

    def _tighten(self, elapsed: float, pads: PadReading) -> None:
        """Answer to slips: press harder, and believe less friction."""
        self._slips.update(elapsed, pads)
        begun = self._slips.begun_beyond_spin & self.schedule.holding
        if not begun.any():
            return
        self._grip = min(MAX_GRIP, self._grip * GRIP_STEP)
        felt = pads.friction_ratio()
        less = begun & (felt < CONFIRMED * self._mu)
        if less.any():
            self._mu[less] = np.maximum(FRICTION_MARGIN * felt[less], LEAST_MU)
            self._loop = self._make_loop()
        for i in np.flatnonzero(begun).tolist():
            did = f"grip x {self._grip:.2f}, friction believed {self._mu[i]:.2f}"
            self._note("slip", i, f"{1e3 * self._slips.speed[i]:.0f} mm/s; {did}")

    def _distribute(
        self,
        wrench: FloatArray,
        center: FloatArray,
        q: FloatArray,
        scale: float,
        *,
        held_back: FloatArray,
        eases: bool,
    ) -> FloatArray:
        """Find the contact forces for a wrench (6,); returns theirs minus it (6,).

        Args:
            wrench: (6,), about the object's centre, base axes.
            center: (3,), that centre, m.
            q: Joints, corrected by the stops (nq,).
            scale: How much of the grip is asked for (-).
            held_back: (n,), what joint friction may take from each finger's force, N.
            eases: Whether fingers press less while a wrench is missed.
        """
        share = np.where(self.schedule.holding, self.schedule.share, 0.0)
        eased = self._infeasibility.grip_share if eases else 1.0
        grip = self.grip * max(LEAST_GRIP, self._grip * eased)
        # actuators of a finger without force do not limit the others
        jacobians = self._torques.jacobians
        if self._soft:
            jacobians = np.concatenate([jacobians, self._torques.turning], axis=1)
        loaded = np.where((share > 0.0)[:, None, None], jacobians, 0.0)
        step = self._loop.step(
            -wrench,
            positions=self._points,
            frames=self._frames,
            center=center,
            jacobians=loaded,
            q=q,
            gravity_torque=self._torques.own_torque,
            min_normal=np.minimum(scale * (grip * self._grip_share + held_back), self._max_normal)
            * share,
            max_normal=self._max_normal * share,
            previous=self.forces,
        )
        if not step.allowed:
            # the least grip exceeds the actuators; without it zero forces are always allowed
            step = self._loop.step(-wrench, q=q, min_normal=0.0)
        if step.allowed:
            self.forces = step.forces.copy()
        if np.isnan(step.left_over).any():  # no solution: the last forces stay
            return self._exerted(center) - wrench
        return step.left_over.copy()

    def _exerted(self, center: FloatArray) -> FloatArray:
        """Wrench (6,) of the contact forces about a point, base axes."""
        forces = (self._frames @ self.forces[:, :3, None])[:, :, 0]
        torques = np.cross(self._points - center, forces)
        torques += self.forces[:, 3:] * self._frames[:, :, 0]
        return np.concatenate([forces.sum(axis=0), torques.sum(axis=0)])

    def _judge(self, elapsed: float, wrench: FloatArray, missed: FloatArray) -> None:
        """Note when a wrench is infeasible, and give up when that lasts."""
        weight = self._loop.problem.row_scale[:6]
        residual, wanted = (math.sqrt(w @ w) for w in (weight * missed, weight * wrench))
        for kind, detail in self._infeasibility.update(
            elapsed, residual=residual, wanted=wanted, holding=self.schedule.holding
        ):
            self._note(kind, None, detail)

    def _make_loop(self) -> ForceLoop:
        """The force programme under the friction that is believed now."""
        return ForceLoop(
            self._contacts.with_friction(self._mu),
            change_cost=CHANGE_COST,
            edges=FRICTION_EDGES,
            edge_cost=RESERVE_COST,
            costs=self._costs,
            actuation=self.plan.task.hand.actuation,
        )

    def _set_wanted(self, finger: str, wanted: bool) -> None:
        names = self.plan.task.finger_names
        if finger not in names:
            raise NotFoundError("finger that takes part", finger, names)
        i = names.index(finger)
        self.schedule.wanted[i] = wanted
        self._note("finger joins" if wanted else "finger leaves", i, "as told")

    def _note(self, kind: EventKind, finger: int | None, detail: str) -> None:
        name = "" if finger is None else self.plan.task.finger_names[finger]
        self._events.append(Event(time=self._time, kind=kind, finger=name, detail=detail))
