"""``Hand``: the parts of a hand, checked against each other, and quantities that follow.

All joints are hinges or slides, so that Pinocchio's q and v, MuJoCo's qpos and qvel and
``joint_names`` share one order within the hand. The raw models stay reachable as ``pin_model`` and
``mj_model``; the frame of reference of ``pin_model`` is the base, the root body that the mount
carries. How a hand is made is in ``planner.hands.build``; ``planner.hand_loading`` finds one
by its name.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, Self

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planner.bridge import LinkGeometry
from planner.errors import HandError, NotFoundError, TaskError, shown
from planner.hands.arm import Arm
from planner.hands.fingers import Finger, Side
from planner.joints.actuation import Actuation
from planner.joints.couplings import Coupling, nearest_on_couplings
from planner.joints.description import PINCH, HandDescription
from planner.showing import in_notebook
from planner.spatial import FloatArray, IntArray, fixed_array

__all__ = ["Hand"]

POSTURE_TOL = 1e-9
"""How far (rad or m) a described posture may leave the joint range before it is an error."""

COUPLING_TOL = 1e-6
"""How far (rad) a posture may violate a coupling by rounding; beyond, it is moved onto it."""

PALM_BEYOND = 0.1
"""How far (m) before the roots of the fingers, along the palm's normal, an origin is no palm: twice
the height of a palm whose thumb starts at its far end."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Hand:
    """A hand that the planner can use; ``planner.hand_loading`` makes one.

    Attributes:
        name: Name from the description.
        description: The validated description.
        path: The description file, the model file if the hand is described by its structure, or
            None if it was made in Python.
        reference: What ``load_hand`` takes to get the same hand again, from any folder; None if
            the hand was made in Python.
        digest: SHA-256 over what determines the hand: its description, the one that this mirrors
            if it does, the model and what that includes. A plan keeps it.
        spec: ``mujoco.MjSpec`` of the hand alone, repaired; ``new_spec`` gives copies of it. If the
            hand mirrors another one, it is reflected, and keeps the other's names of joints, frames
            and geometries.
        mj_model: Compiled ``mujoco.MjModel`` of the hand alone, base fixed to the world.
        pin_model: ``pinocchio.Model`` of the same.
        fingers: Name -> Finger, in the description's order.
        geometries: Every colliding geometry.
        allowed_pairs: Pairs of geometry names that may touch.
        actuation: Transmission, actuator laws, ranges and stops.
        couplings: Kinematic couplings that hold in a grasp.
        arm: What carries the hand: its joints are part of q, and the base is its root, which stands
            fixed; None for a hand alone, and for two hands, whose ``pair`` have an arm each.
        pair: The two hands that this is (``planner.hands.two_hands``); empty for one hand.
        on_carriages: Of two hands on arms the same on carriages, with which grasps are searched
            for; None of all others.
        last_link: Names of the colliding geometries of an arm's last link, of a hand on a carriage
            that has it with it; none of others.
        rolls: Whether its pads have the cones within which contacts may roll (``rolling``).
    """

    name: str
    description: HandDescription
    path: Path | None
    reference: str | None
    digest: str
    spec: Any
    mj_model: Any
    pin_model: Any
    fingers: Mapping[str, Finger]
    geometries: tuple[LinkGeometry, ...]
    allowed_pairs: frozenset[frozenset[str]]
    actuation: Actuation
    couplings: tuple[Coupling, ...]
    arm: Arm | None = None
    pair: tuple[Side, ...] = ()
    on_carriages: Hand | None = None
    last_link: frozenset[str] = frozenset()
    rolls: bool = False

    @cached_property
    def rolling(self) -> Self:
        """The same hand with pads as wide as the tips are round, for objects that are turned.

        Faces turn with an object, so contacts wander over the tips during a turn; narrower pads
        limit its angle.
        """
        if self.rolls:
            return self
        fingers = {name: replace(f, pad=f.pad.rolling) for name, f in self.fingers.items()}
        digest = hashlib.sha256(f"{self.digest} rolling".encode()).hexdigest()
        return replace(self, fingers=MappingProxyType(fingers), digest=digest, rolls=True)

    def new_spec(self) -> Any:
        """A fresh ``mujoco.MjSpec`` of the hand, to be edited or attached to a scene."""
        return self.spec.copy()

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Joint names in the order of q."""
        return tuple(self.pin_model.names)[1:]

    @cached_property
    def nq(self) -> int:
        """Number of joints."""
        return int(self.pin_model.nq)

    @property
    def q_lower(self) -> FloatArray:
        """Lower joint limits (nq,), rad or m."""
        return np.array(self.pin_model.lowerPositionLimit)

    @property
    def q_upper(self) -> FloatArray:
        """Upper joint limits (nq,), rad or m."""
        return np.array(self.pin_model.upperPositionLimit)

    @property
    def neutral(self) -> FloatArray:
        """Joints (nq,) at zero, or at the end of their range that is nearest to it."""
        return np.clip(np.zeros(self.nq), self.q_lower, self.q_upper)

    @property
    def at_rest(self) -> FloatArray:
        """Joints (nq,) as ``neutral``, with arms at their ready posture."""
        q = self.neutral
        sides = ((side.joints, side.alone.arm) for side in self.pair)
        for joints, arm in ((np.arange(self.nq), self.arm), *sides):
            if arm is not None:
                q[joints[arm.index]] = arm.ready
        return q

    @cached_property
    def wrist_index(self) -> IntArray:
        """Where the wrist's joints stand in q."""
        return np.array([self.joint_index(j) for j in self.description.wrist_joints], dtype=int)

    @cached_property
    def finger_of_body(self) -> Mapping[str, str]:
        """Name of a body -> name of the finger that it belongs to; other bodies are left out."""
        return MappingProxyType(
            {body: finger.name for finger in self.fingers.values() for body in finger.bodies}
        )

    @cached_property
    def contact_parts(self) -> Mapping[str, Finger]:
        """What can touch an object, by name: fingers with their tips, then their links, the palm.

        A link is a finger that ends with it (``planner.hands.fingers``). Flanks look to the
        finger that opposes the others in the posture "pinch"; without it there are none.
        """
        from planner.hands.fingers import link_contacts  # here: most grasps are of fingertips

        links: dict[str, Finger] = {}
        pinch = self.posture(PINCH) if PINCH in self.description.postures else None
        for side in self.sides:
            fingers = tuple(self.fingers[name] for name in side.fingers)
            links |= link_contacts(
                self.pin_model, self.geometries, fingers, side, self.neutral, pinch
            )
        return MappingProxyType({**self.fingers, **links})

    @cached_property
    def sides(self) -> tuple[Side, ...]:
        """The hands that this is: two, or itself."""
        if self.pair:
            return self.pair
        only = Side(
            name="",
            palm_body=self.description.palm_body,
            palm_normal=self.palm_normal,
            carriage=np.zeros(0, dtype=int),
            fingers=tuple(self.fingers),
        )
        return (only,)

    def require_one(self, what: str) -> None:
        """Refuse two hands where nobody has worked out what they do.

        Args:
            what: Begin of the message: what takes one hand.

        Raises:
            TaskError: These are two hands.
        """
        if self.pair:
            raise TaskError(f"{what} takes one hand, and {self.name} is two; load one of them")

    @cached_property
    def carriage_index(self) -> IntArray:
        """Where the joints that move the palms of two hands stand in q; empty for one hand."""
        return np.concatenate([side.carriage for side in self.sides])

    @cached_property
    def on_arm(self) -> bool:
        """Whether an arm carries it, or an arm each of two hands: its base stands fixed."""
        return self.arm is not None or any(side.T_base_root is not None for side in self.pair)

    @cached_property
    def arm_index(self) -> IntArray:
        """Where the joints of the arm, or of both, stand in q; empty without one."""
        if self.arm is not None:
            return self.arm.index
        arms = [s.joints[s.alone.arm.index] for s in self.pair if s.T_base_root is not None]
        return np.concatenate([np.zeros(0, dtype=int), *arms])

    @cached_property
    def arm_geometries(self) -> frozenset[str]:
        """Names of the colliding geometries of the arm, of both arms, or of the last link."""
        if self.pair:
            return frozenset(s.called(name) for s in self.pair for name in s.alone.arm_geometries)
        return self.last_link if self.arm is None else self.arm.geometries

    @cached_property
    def moved_by(self) -> NDArray[np.bool_]:
        """Whether joint j moves what is fixed to Pinocchio joint i, (nq + 1, nq)."""
        model = self.pin_model
        table = np.zeros((model.njoints, self.nq), dtype=bool)
        for i in range(model.njoints):
            table[i, [int(j) - 1 for j in model.supports[i] if j > 0]] = True
        return table

    @cached_property
    def palm_frame_id(self) -> int:
        """Number of the palm's body frame in ``pin_model.frames``."""
        return int(self.pin_model.getBodyId(self.description.palm_body))

    @property
    def palm_normal(self) -> FloatArray:
        """Direction the palm faces (3,), unit, in the palm's frame."""
        return np.array(self.description.palm_normal)

    @cached_property
    def palm_point(self) -> FloatArray:
        """Where the palm is seen from the fingertips (3,), m, in the palm's frame; read-only.

        The frame's origin, unless that lies far before the roots of the fingers, as in stages whose
        base is the floor below the fingers: then the middle of the roots.
        """
        data = self.pin_model.createData()
        pin.framesForwardKinematics(self.pin_model, data, self.neutral)
        T_palm_base = data.oMf[self.palm_frame_id].inverse()
        first = [self.pin_model.getJointId(f.joints[0]) for f in self.fingers.values()]
        roots = np.mean([T_palm_base.act(data.oMi[k].translation) for k in first], axis=0)
        beyond = -roots @ self.palm_normal > PALM_BEYOND
        return fixed_array(roots if beyond else np.zeros(3))

    @cached_property
    def coupling_matrix(self) -> tuple[FloatArray, FloatArray]:
        """C (m, nq) and d (m,) of the kinematic couplings C q = d; read-only."""
        rows = np.array([c.row for c in self.couplings]).reshape(-1, self.nq)
        return fixed_array(rows), fixed_array([c.value for c in self.couplings])

    def joint_index(self, name: str) -> int:
        """Where a joint stands in q.

        Raises:
            NotFoundError: No such joint.
        """
        if name not in self.joint_names:
            raise NotFoundError(f"joint of {self.name}", name, self.joint_names)
        return self.joint_names.index(name)

    def posture(self, name: str) -> FloatArray:
        """A described posture as q (nq,); joints that it does not name are at 0 or their limit.

        Where it violates couplings by more than rounding, it is the nearest posture that keeps
        them, so that a new coupling needs no new postures. ``check_hand`` reports the distance and
        the corrected posture. The arm that carries a hand is at its ready posture.

        Raises:
            NotFoundError: No such posture, or it names a joint that does not exist.
            HandError: It leaves a joint's range, or nothing near it keeps the couplings.
        """
        q = self.described_posture(name)
        matrix, value = self.coupling_matrix
        if (np.abs(matrix @ q - value) <= COUPLING_TOL).all():
            return q
        kept = nearest_on_couplings(q, self.couplings, self.q_lower, self.q_upper)
        if kept is None:
            names = [c.name for c in self.couplings]
            raise HandError(
                f"posture {name!r} of {self.name}: no joints within their ranges keep the "
                f"couplings {names}; correct the couplings or the ranges"
            )
        return kept

    def described_posture(self, name: str) -> FloatArray:
        """A posture as q (nq,) exactly as described, even where it violates couplings.

        Raises:
            NotFoundError: No such posture, or it names a joint that does not exist.
            HandError: It leaves a joint's range.
        """
        postures = self.description.postures
        if name not in postures:
            raise NotFoundError(f"posture of {self.name}", name, postures)
        q = self.at_rest
        for joint, angle in postures[name].items():
            q[self.joint_index(joint)] = angle
        return self.checked_q(q, f"posture {name!r}")

    def checked_q(self, q: Any, what: str = "q") -> FloatArray:
        """Joints q as a float array (nq,) after checking its shape, finiteness and joint limits.

        Raises:
            HandError: Wrong shape, NaN, or a joint outside its range (named with the range).
        """
        try:
            joints: FloatArray = np.array(q, dtype=np.float64)
        except (TypeError, ValueError):
            raise HandError(f"{what} is {shown(q)}; give {self.nq} numbers") from None
        if joints.shape != (self.nq,):
            raise HandError(f"{what} has shape {joints.shape}; {self.name} needs ({self.nq},)")
        if not np.isfinite(joints).all():
            raise HandError(f"{what} holds NaN or infinity")
        outside = np.maximum(self.q_lower - joints, joints - self.q_upper)
        worst = int(np.argmax(outside))
        if outside[worst] > POSTURE_TOL:
            low, high = self.q_lower[worst], self.q_upper[worst]
            raise HandError(
                f"{what}: joint {self.joint_names[worst]} is at {joints[worst]:.4f}, outside its "
                f"range [{low:.4f}, {high:.4f}]; bring it inside"
            )
        return joints

    def choose_fingers(self, names: Sequence[str] | None = None) -> tuple[Finger, ...]:
        """Fingers by name; the description's default where none is given.

        Raises:
            NotFoundError: A name that the hand does not have.
            TaskError: No finger, or a finger named twice.
        """
        chosen = tuple(names if names is not None else self.description.default_fingers)
        if names is None and not chosen:
            chosen = tuple(self.fingers)
        if not chosen:
            raise TaskError(f"no finger is named; name some of {list(self.fingers)}")
        parts = self.fingers if set(chosen) <= set(self.fingers) else self.contact_parts
        for name in chosen:
            if name not in parts:
                hint = "Links and the palm may touch too, by the names in contact_parts."
                raise NotFoundError(f"finger of {self.name}", name, self.fingers, hint)
        if len(set(chosen)) != len(chosen):
            raise TaskError(f"a finger is named twice in {list(chosen)}; name each once")
        return tuple(parts[name] for name in chosen)

    def _repr_html_(self) -> str:
        """What a notebook shows of it: a table and a picture, made once."""
        return in_notebook(self)

    def __repr__(self) -> str:
        """One line; ``opposable hands`` prints the rest."""
        return f"<Hand: {self.name}, {self.nq} joints, fingers {', '.join(self.fingers)}>"
