"""``GraspTask``: what is to be grasped, by which hand, where, and in which surroundings.

The task is stored in the plan, and the simulated scene is built from it, so that planning and
execution cannot disagree about the world.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from numbers import Real
from pathlib import Path
from types import MappingProxyType

import numpy as np

from planner.arrays import checked_kind, checked_number
from planner.contacts import CONTACT_DIM, MOST_FRICTION, ContactModel
from planner.contacts.friction import LEAST_MU, ExpectedLoad, grip_for_load
from planner.errors import TaskError, shown
from planner.hand_loading import load_hand
from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.immutable import fixed_pose, is_pose
from planner.objects import GraspObject, NeededWrench, parse_object
from planner.spatial import SE3, FloatArray, fixed_array
from planner.tolerances import DEFAULT_MU

__all__ = ["DEFAULT_MU", "GRAVITY", "GraspTask", "Obstacle"]

GRAVITY = (0.0, 0.0, -9.81)
"""Default gravity, m/s2, world axes."""

GRIP_SAFETY = 2.0
"""Default grip: each finger presses with this many times the weight it would have to carry by
friction alone if all fingers shared the load, never less than ``MIN_GRIP``."""

MIN_GRIP = 1.5
"""Smallest default normal force per finger, N: well above the joint friction of a real finger."""

ANY = "any"
"""Grasp type of two hands for which a task names none; of one it begins with the default fingers,
of which some may be spared as where no type is named."""

NEEDED_MARGIN = 1.25
"""Default margin of needed wrenches (-): planning's friction has a reserve of its own beside it."""

MOST_MARGIN = 100.0
"""Largest margin of needed wrenches (-): more asks for another wrench."""

MOST_JOINT_ERROR = 0.2
"""Largest ``joint_error``, rad: 11 degrees, with which no finger finds what it is sent to."""

FINGERS_NEEDED = {"frictionless": 7, "point": 3, "soft": 2}
"""Fewest contacts that can close a grasp of a solid body: rank 6 of the grasp map with forces that
can balance each other (Murray, Li, Sastry 1994, section 5.3)."""


@dataclass(frozen=True, kw_only=True)
class Obstacle:
    """A fixed box that hand and object must not touch.

    Attributes:
        name: What to call it in messages.
        size: Full extents (3,), m.
        T_world_obstacle: Pose of its centre.
    """

    name: str
    size: FloatArray
    T_world_obstacle: SE3

    def __post_init__(self) -> None:
        """Check size and pose, and keep copies that nobody changes."""
        what = f"obstacle {self.name!r}"
        size = _numbers(f"{what}: size", self.size, "three lengths > 0 in m")
        if size.shape != (3,) or not np.isfinite(size).all() or (size <= 0).any():
            raise TaskError(f"{what}: size {self.size} must be three lengths > 0 m")
        object.__setattr__(self, "size", size)
        pose = _checked_pose(f"{what}: its pose", self.T_world_obstacle)
        object.__setattr__(self, "T_world_obstacle", pose)

    def moved(self, by: FloatArray) -> Obstacle:
        """The same obstacle elsewhere; ``by`` is how far (3,), m, world."""
        pose = self.T_world_obstacle
        return replace(self, T_world_obstacle=SE3(pose.rotation, pose.translation + by))


@dataclass(frozen=True, kw_only=True, eq=False)
class GraspTask:
    """One grasp to be planned; make one with ``GraspTask.create``.

    A task never changes: it holds copies of the poses and arrays that it is given, and they are
    read-only. ``dataclasses.replace`` makes another task. Threads may share one.

    Attributes:
        hand: The hand.
        object: Shape and mass.
        T_world_object: Pose of the object (its centre of mass) at the grasp.
        table_height: Height z of the table's top, m; None for no table.
        obstacles: Fixed boxes.
        gravity: (3,), m/s2, world.
        mu: Sliding friction that planning may rely on (-).
        mu_torsion: Torsional friction (m); matters with ``contact_model="soft"``.
        contact_model: Friction law of the planned contacts.
        finger_names: Fingers that take part.
        may_spare_fingers: Whether the search may go on with fewer fingers where all of these find
            nothing.
        alternatives: Other sets of contacts that the search may use, in turns with
            ``finger_names``.
        grip_force: Smallest normal force per finger in the planned grasp, N; a link or a palm that
            touches need not press.
        expected_load: What ``grip_force`` was sized for beside the weight. Fewer fingers then grip
            harder. A plan file keeps the grip alone.
        joint_error: Standard deviation of the constant error of each joint's encoder, rad: the
            search leaves room for it where there is room (``planner.synthesis.options``). A plan
            file keeps the plan alone.
        needed: Wrenches each of which the hand must be able to produce on the object while it bears
            the weight as at the grasp.
        needed_margin: How many times each of them the planned grasp must be able to produce (-).
        T_world_base: Pose of the hand's base if it is fixed; None if it is free. The base of a hand
            on an arm is the arm's root, which is fixed.
        wrist_free: Whether the wrist joints may move; they stay at ``wrist_q`` otherwise.
        wrist_q: Wrist joints where they are held, rad.
    """

    hand: Hand
    object: GraspObject
    T_world_object: SE3
    table_height: float | None = 0.0
    obstacles: tuple[Obstacle, ...] = ()
    gravity: FloatArray = field(default_factory=lambda: np.array(GRAVITY))
    mu: float = DEFAULT_MU
    mu_torsion: float = 0.0
    contact_model: ContactModel = "point"
    finger_names: tuple[str, ...]
    may_spare_fingers: bool = False
    alternatives: tuple[tuple[str, ...], ...] = ()
    grip_force: float
    expected_load: ExpectedLoad = field(default_factory=ExpectedLoad)
    joint_error: float = 0.0
    needed: tuple[NeededWrench, ...] = ()
    needed_margin: float = NEEDED_MARGIN
    T_world_base: SE3 | None = None
    wrist_free: bool = False
    wrist_q: FloatArray

    @classmethod
    def create(
        cls,
        hand: Hand | str | Path,
        object: GraspObject | str,
        *,
        T_world_object: SE3 | None = None,
        table_height: float | None = 0.0,
        obstacles: Sequence[Obstacle] = (),
        gravity: Sequence[float] | FloatArray = GRAVITY,
        mu: float = DEFAULT_MU,
        mu_torsion: float = 0.0,
        contact_model: ContactModel = "point",
        fingers: Sequence[str] | None = None,
        grasp_type: str | None = None,
        grip_force: float | None = None,
        expected_load: ExpectedLoad | None = None,
        joint_error: float = 0.0,
        needed: Sequence[NeededWrench] = (),
        needed_margin: float = NEEDED_MARGIN,
        T_world_base: SE3 | None = None,
        wrist_free: bool = False,
        wrist_q: Sequence[float] | FloatArray | None = None,
    ) -> GraspTask:
        """A task with defaults filled in; arguments not told here are those of the class.

        Args:
            hand: A hand, its name, or the path of its description.
            object: An object, or a specification such as "box:0.05x0.05x0.08".
            T_world_object: Where the object is; at rest on the table by default.
            table_height: Height of the table's top, m; None for no table.
            obstacles: Fixed boxes.
            gravity: (3,), m/s2, world.
            mu: Sliding friction that planning may rely on (-).
            mu_torsion: Torsional friction (m).
            contact_model: Friction law of the planned contacts.
            fingers: Finger names; if None the hand's default set, of which the search may spare
                some where all of them find nothing. Inner links and the palm may be among them, by
                the names of their bodies.
            grasp_type: What touches, instead of ``fingers``: a name of
                ``planner.hands.grasp_types``. The search tries its sets of contacts in turns. Of
                two hands it is "any" if neither is given.
            grip_force: N per finger; from weight, friction (``GRIP_SAFETY``) and ``expected_load``
                if None.
            expected_load: The largest disturbance that the object is to bear in the hand; none if
                None. It sizes the grip (``planner.forces.grip_for_load``), so it goes without
                ``grip_force``.
            joint_error: Standard deviation of each joint's encoder error, rad.
            needed: Wrenches that the hand must be able to produce.
            needed_margin: How many times each of them (-).
            T_world_base: Pose of the hand's base if it is fixed. A hand on an arm has its arm stand
                where its description says, seen from the object, if None; two hands have their
                middle at the object's, two arms theirs on the table below it.
            wrist_free: Whether the wrist joints may move; those of two hands always may, since
                forearms are in the way of palms that lie on something large.
            wrist_q: Wrist joints, rad; zero if None.

        Raises:
            PlannerError: An unknown name, a number out of range, or a task that cannot work.
        """
        hand = hand if isinstance(hand, Hand) else load_hand(hand)
        item = parse_object(object) if isinstance(object, str) else object
        _check_number("mu", mu)
        if table_height is not None:
            _check_number("table_height", table_height)
        if isinstance(fingers, str):
            raise TaskError(f"fingers is the text {shown(fingers)}; give a list of names")
        if T_world_object is None:
            T_world_object = item.resting_pose(0.0 if table_height is None else table_height)
        if T_world_base is None and hand.on_arm:
            spot = np.array(T_world_object.translation)
            spot[2] = 0.0 if table_height is None else table_height
            T_world_base = SE3(np.eye(3), spot)
            if hand.arm is not None:
                T_world_base = T_world_base * hand.arm.T_spot_base
        elif T_world_base is None and hand.pair:
            T_world_base = SE3(np.eye(3), np.array(T_world_object.translation))
        if grasp_type is not None and fingers is not None:
            raise TaskError(
                f"grasp_type is {shown(grasp_type)}, and fingers are named too; give one of them"
            )
        if hand.pair and fingers is None and grasp_type is None:
            grasp_type = ANY
        sets = () if grasp_type is None else _sets_of(hand, grasp_type)
        chosen = hand.choose_fingers(sets[0] if sets else fingers)
        pull = _numbers("gravity", gravity, "three finite numbers in m/s2")
        load = expected_load or ExpectedLoad()
        if grip_force is None:
            grip_force = _default_grip(item, pull, mu, _pressing(hand, chosen), load)
        elif load:
            raise TaskError(
                f"grip_force is {grip_force:g} N, and expected_load would size it; give one of them"
            )
        n_wrist = len(hand.wrist_index)
        return cls(
            hand=hand,
            object=item,
            T_world_object=T_world_object,
            table_height=table_height,
            obstacles=tuple(obstacles),
            gravity=pull,
            mu=mu,
            mu_torsion=mu_torsion,
            contact_model=contact_model,
            finger_names=tuple(f.name for f in chosen),
            may_spare_fingers=fingers is None and (not sets or grasp_type == ANY) and not hand.pair,
            alternatives=tuple(sets[1:]),
            grip_force=grip_force,
            expected_load=load,
            joint_error=joint_error,
            needed=tuple(needed),
            needed_margin=needed_margin,
            T_world_base=T_world_base,
            wrist_free=wrist_free or bool(hand.pair),
            wrist_q=_numbers(
                "wrist_q", np.zeros(n_wrist) if wrist_q is None else wrist_q, JOINTS_WANTED
            ),
        )

    @cached_property
    def all_names(self) -> tuple[str, ...]:
        """Names of all fingers and links that a grasp of the task may have."""
        return tuple(dict.fromkeys(chain(self.finger_names, *self.alternatives)))

    @cached_property
    def choices(self) -> tuple[GraspTask, ...]:
        """The task itself, and the same with each of its alternatives."""
        if not self.alternatives:
            return (self,)
        out = [replace(self, alternatives=())]
        for names in self.alternatives:
            try:
                out.append(self.with_fingers(names))
            except TaskError:  # a region is required of a finger that this set has not
                continue
        return tuple(out)

    def with_fingers(self, names: Sequence[str]) -> GraspTask:
        """The same task for these fingers and no others, each gripping no less than before.

        Raises:
            TaskError, NotFoundError: They are not fingers of the hand, or too few.
        """
        n = _pressing(self.hand, self.hand.choose_fingers(names))
        least = _default_grip(self.object, self.gravity, self.mu, n, self.expected_load)
        return replace(
            self,
            finger_names=tuple(names),
            may_spare_fingers=False,
            alternatives=(),
            grip_force=max(self.grip_force, least),
        )

    @cached_property
    def on_carriages(self) -> GraspTask:
        """The task itself; that of two arms with their hands on carriages, about the object."""
        hand, base = self.hand.on_carriages, self.T_world_base
        if hand is None or base is None:
            return self
        return replace(
            self, hand=hand, T_world_base=SE3(base.rotation, self.T_world_object.translation)
        )

    @cached_property
    def sharing_palm(self) -> GraspTask | None:
        """The same with half the default grip: where a palm of one hand touches, or two hands hold.

        A palm is pressed as hard as the fingers press onto it, and its friction carries as much: so
        the weight is carried with the same reserve. Of two hands it is the reserve that is halved,
        to what friction needs; the force programme then presses as hard as its share of it asks.
        """
        alone = not self.hand.pair and all(f.joints for f in self.fingers)
        if self.expected_load or alone:
            return None
        n = _pressing(self.hand, self.fingers)
        usual, least = (
            _default_grip(self.object, self.gravity, self.mu, m, self.expected_load)
            for m in (n, 2 * n)
        )
        return replace(self, grip_force=least) if self.grip_force == usual > least else None

    def __repr__(self) -> str:
        """One line; the attributes hold the rest."""
        return (
            f"<GraspTask: {self.hand.name} ({', '.join(self.finger_names)}), "
            f"{self.object.shape.spec}, {self.object.mass:g} kg, mu {self.mu:g}>"
        )

    def __post_init__(self) -> None:
        """Check every number and whether the fingers can close a grasp at all.

        Poses and arrays are copied, and the copies are read-only: a task never changes, so that
        what is prepared for it may be kept for as long as it is there.
        """
        for name in ("mu", "mu_torsion", "grip_force"):
            value = getattr(self, name)
            _check_number(name, value)
            most = np.inf if name == "grip_force" else MOST_FRICTION
            checked_number(name, value, least=0.0, most=most, error=TaskError)
        _check_number("joint_error", self.joint_error)
        checked_number(
            "joint_error", self.joint_error, least=0.0, most=MOST_JOINT_ERROR, error=TaskError
        )
        _check_number("needed_margin", self.needed_margin)
        checked_number(
            "needed_margin", self.needed_margin, least=1.0, most=MOST_MARGIN, error=TaskError
        )
        object.__setattr__(self, "needed", tuple(self.needed))
        for one in self.needed:
            checked_kind("a needed wrench", one, NeededWrench)
        names = [one.name for one in self.needed]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise TaskError(
                f"needed wrenches {', '.join(map(shown, twice))} are there more than once; give "
                "each a name of its own"
            )
        gravity = _numbers("gravity", self.gravity, "three finite numbers in m/s2")
        if gravity.shape != (3,) or not np.isfinite(gravity).all():
            raise TaskError(f"gravity is {self.gravity}; give three finite numbers in m/s2")
        object.__setattr__(self, "gravity", gravity)
        if self.table_height is not None:
            _check_number("table_height", self.table_height)
            if not np.isfinite(self.table_height):
                raise TaskError(
                    f"table_height is {self.table_height}; give metres, or None for none"
                )
        for name in ("T_world_object", "T_world_base"):
            if name != "T_world_base" or self.T_world_base is not None:
                object.__setattr__(self, name, _checked_pose(name, getattr(self, name)))
        object.__setattr__(self, "finger_names", tuple(self.finger_names))
        object.__setattr__(self, "obstacles", tuple(self.obstacles))
        wrist_q = _numbers("wrist_q", self.wrist_q, JOINTS_WANTED)
        object.__setattr__(self, "wrist_q", wrist_q)
        for finger in self.object.touch.required if self.object.touch is not None else ():
            if finger not in self.finger_names:
                raise TaskError(
                    f"a region is required of {finger!r}, which does not take part; there are "
                    f"{', '.join(self.finger_names)}"
                )
        if self.contact_model not in CONTACT_DIM:
            allowed = list(CONTACT_DIM)
            raise TaskError(f"contact_model is {shown(self.contact_model)}; use one of {allowed}")
        if len(self.finger_names) < self.fingers_needed:
            raise TaskError(
                f"{len(self.finger_names)} finger(s) {list(self.finger_names)} cannot close a "
                f"grasp with {self.contact_model} contacts, which needs at least "
                f"{self.fingers_needed}; name more of {list(self.hand.fingers)}"
                + self._hint_of_torsion
            )
        self.hand.choose_fingers(self.finger_names)
        if self.mu == 0 and self.contact_model != "frictionless":
            raise TaskError(
                "mu is 0: fingertips cannot close a grasp without friction; give mu > 0"
            )
        self._check_wrist()
        if self.hand.on_arm and self.T_world_base is None:
            raise TaskError(
                f"{self.hand.name} is on an arm, which stands somewhere; give T_world_base, the "
                "pose of the arm's root"
            )
        if self.table_height is not None:
            self._check_object_above_table(self.table_height)

    def needed_load(self, needed: NeededWrench) -> FloatArray:
        """The wrench (6,), N and N m, world, against which the hand produces a needed one."""
        turn = self.T_world_object.rotation
        return -np.concatenate([turn @ needed.force, turn @ needed.torque])

    @property
    def _is_without_torsion(self) -> bool:
        """Whether soft fingers are point contacts, having no torsional friction."""
        return self.contact_model == "soft" and self.mu_torsion == 0

    @property
    def _hint_of_torsion(self) -> str:
        """What would make so few contacts enough; "" where nothing would."""
        if self._is_without_torsion:
            return ", or give mu_torsion > 0"
        if self.contact_model == "point" and len(self.finger_names) >= FINGERS_NEEDED["soft"]:
            return ", or take soft contacts with mu_torsion > 0 (--mu-torsion)"
        return ""

    @property
    def fingers_needed(self) -> int:
        """Fewest fingers that can close a grasp with these contacts."""
        return FINGERS_NEEDED["point" if self._is_without_torsion else self.contact_model]

    @cached_property
    def fingers(self) -> tuple[Finger, ...]:
        """The fingers that take part."""
        return self.hand.choose_fingers(self.finger_names)

    @cached_property
    def least_normals(self) -> FloatArray:
        """Smallest normal force (n,), N, of each contact: the grip of the outermost on a finger.

        Inner links and the palm may touch without pressing: others press the object onto them.
        Where the palms of two hands press with the grip, fingertips need no more than touch.
        """
        out = np.zeros(len(self.fingers))
        out[list(self.outermost)] = self.grip_force
        if palms := _carried_palms(self.hand, self.fingers):
            out[list(self.outermost)] = min(MIN_GRIP, self.grip_force)
            out[list(palms)] = self.grip_force
        return fixed_array(out)

    @cached_property
    def outermost(self) -> tuple[int, ...]:
        """Numbers of the contacts beyond which no other is on their finger; the palm's is none."""
        return outermost(self.fingers)

    def require_fingertips(self, what: str) -> None:
        """Refuse what nobody has worked out for inner links and the palm, or for two hands.

        Args:
            what: Begin of the message: what takes fingertips.

        Raises:
            TaskError: Others than fingertips touch, or these are two hands.
        """
        self.hand.require_one(what)
        if not self.is_of_fingertips:
            links = ", ".join(f.name for f in self.fingers if f.is_link)
            raise TaskError(
                f"{what} takes fingertips alone, and {links} touch too; plan with "
                "grasp_type='fingertip' (--type fingertip), or do without"
            )

    @property
    def is_of_fingertips(self) -> bool:
        """Whether fingertips alone touch, and neither palm nor inner links."""
        return not any(finger.is_link for finger in self.fingers)

    @cached_property
    def part_of_body(self) -> Mapping[str, str]:
        """Body of the hand -> name of the finger or link whose contacts count as the body's.

        Other links of a finger, and fingers that take no part, have the finger's name; the palm has
        a name only where it takes part.
        """
        links = (f for f in self.fingers if f.is_link)
        own = {body: link.name for link in links for body in link.bodies}
        return MappingProxyType({**self.hand.finger_of_body, **own})

    @cached_property
    def carried_geometries(self) -> frozenset[str]:
        """Geometries that touch the object and that no finger moves: a palm's that takes part.

        They are at the object before the fingers close.
        """
        joints = {f.pad.joint_id for f in self.fingers if not f.joints}
        return frozenset(g.name for g in self.hand.geometries if g.joint_id in joints)

    def lowest_point(self, T_world_object: SE3) -> float:
        """Height z (m, world) of the object's lowest point at a pose."""
        support = self.object.shape.support(-T_world_object.rotation[2])
        return float(T_world_object.translation[2] - support)

    @property
    def carrying(self) -> tuple[Obstacle, ...]:
        """The obstacles if the object stands on them and not on the table, else none."""
        if self.table_height is None:
            return ()
        above = self.lowest_point(self.T_world_object) - self.table_height
        return self.obstacles if above > FLOATING_TOL else ()

    def _check_wrist(self) -> None:
        index = self.hand.wrist_index
        if self.wrist_q.shape != index.shape:
            raise TaskError(f"wrist_q has shape {self.wrist_q.shape}, the hand needs {index.shape}")
        q = np.clip(np.zeros(self.hand.nq), self.hand.q_lower, self.hand.q_upper)
        q[index] = self.wrist_q
        self.hand.checked_q(q, "wrist_q")

    def _check_object_above_table(self, height: float) -> None:
        lowest = self.lowest_point(self.T_world_object)
        if lowest < height - OBJECT_TABLE_TOL:
            raise TaskError(
                f"the object reaches down to z = {lowest:.4f} m, below the table's top at "
                f"{height:.4f} m; raise T_world_object by {height - lowest:.4f} m "
                "(--at)"
            )
        if lowest > height + FLOATING_TOL and not self.obstacles:
            raise TaskError(
                f"the object floats {lowest - height:.4f} m above the table's top, so it would "
                "fall before it is grasped; lower T_world_object (--at), or give table_height=None "
                "(--table none) for an object that is held until it is lifted"
            )


def _sets_of(hand: Hand, grasp_type: str) -> tuple[tuple[str, ...], ...]:
    """Sets of contacts of a grasp type; none for the fingertips that are the default."""
    from planner.hands.grasp_types import FINGERTIP, contact_sets  # here: most tasks name no type

    return () if grasp_type == FINGERTIP else contact_sets(hand, grasp_type)


def outermost(fingers: Sequence[Finger]) -> tuple[int, ...]:
    """Numbers of the contacts beyond which no other is on their finger."""
    ends: dict[int, int] = {}
    for i, finger in enumerate(fingers):
        if finger.joints:
            root = int(finger.q_index[0])
            if root not in ends or len(finger.joints) > len(fingers[ends[root]].joints):
                ends[root] = i
    return tuple(sorted(ends.values()))


def _carried_palms(hand: Hand, fingers: Sequence[Finger]) -> tuple[int, ...]:
    """Numbers of the contacts that are palms of two hands, which their carriages press."""
    palms = {side.palm_body for side in hand.pair}
    return tuple(i for i, finger in enumerate(fingers) if finger.name in palms)


def _pressing(hand: Hand, fingers: Sequence[Finger]) -> int:
    """How many contacts press with the grip: the palms of two hands, or one on each finger."""
    return max(len(_carried_palms(hand, fingers) or outermost(fingers)), 1)


def _default_grip(
    item: GraspObject,
    gravity: FloatArray,
    mu: float,
    n_fingers: int,
    load: ExpectedLoad,
) -> float:
    """Normal force per finger (N) that carries the weight with a reserve, and a load if one is."""
    weight = item.mass * float(np.linalg.norm(gravity))
    grip = max(MIN_GRIP, GRIP_SAFETY * weight / (max(mu, LEAST_MU) * n_fingers))
    if load:
        lever = item.shape.bounding_radius
        needed = grip_for_load(load, weight=weight, lever=lever, mu=mu, n_contacts=n_fingers)
        grip = max(grip, needed)
    return float(grip)


def _numbers(name: str, values: object, wanted: str) -> FloatArray:
    """Numbers as a read-only copy."""
    try:
        return fixed_array(values)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        raise TaskError(f"{name} is {shown(values)}; give {wanted}") from None


def _checked_pose(name: str, pose: SE3) -> SE3:
    """A pose as a copy that nobody changes."""
    if not is_pose(pose):
        raise TaskError(f"{name} is a {type(pose).__name__}; give a pinocchio.SE3")
    if not np.isfinite(pose.homogeneous).all():
        raise TaskError(f"{name} holds NaN or infinity; give finite numbers")
    return fixed_pose(pose)


def _check_number(name: str, value: object) -> None:
    if isinstance(value, bool) or not isinstance(value, Real):
        raise TaskError(f"{name} is {shown(value)}; give a number")
    try:
        float(value)
    except OverflowError:
        raise TaskError(f"{name} has more digits than a number here; give less") from None


JOINTS_WANTED = "the wrist's joints in rad"
"""What ``wrist_q`` is to be, in messages."""

FLOATING_TOL = 1e-3
"""Height (m) above the table from which an object counts as floating; obstacles may carry it."""

OBJECT_TABLE_TOL = 1e-6
"""How far (m) an object may be given below the table's top: rounding of its resting pose."""
