"""Fingers, pads and couplings: the names of a description resolved in its model and checked.

Called once per hand, when it is built.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from planner.bridge import LinkGeometry, couplings_from_mujoco
from planner.bridge.pinocchio_model import body_name
from planner.errors import HandError, NotFoundError
from planner.joints.couplings import Coupling, check_couplings, independent_couplings
from planner.joints.description import FingerDescription, HandDescription
from planner.shapes.convex_pairs import DistancePair
from planner.spatial import SE3, FloatArray, IntArray

__all__ = ["Finger", "Pad", "Resolver", "Side"]

PAD_TOL = 5e-4
"""How far (m) a pad's sphere may be from the surface of its geometry: the tolerance of touch."""

_POINT = 1e-6
"""Radius (m) of the ball that stands for a point."""


@dataclass(frozen=True, kw_only=True)
class Pad:
    """Spherical contact pad, fixed in a joint's frame.

    Attributes:
        geom: Collision geometry whose surface it is part of.
        joint_id: Pinocchio joint it moves with.
        center: (3,), m, in the joint's frame.
        axis: (3,), unit, in the joint's frame: where the pad faces.
        radius: m.
        half_angle: rad; contact points lie within this cone about the axis.
        rolling_axis: (3,), unit: middle of the cone within which contacts may roll.
        rolling_half_angle: rad; of that cone. Without a description, both equal ``axis`` and
            ``half_angle``.
        reach: (k, 3), m, orthogonal, in the joint's frame: the sphere stands for all that have
            their centre at most these away from ``center``, along a link or in a face; none
            (0, 3) at a fingertip.
    """

    geom: str
    joint_id: int
    center: FloatArray
    axis: FloatArray
    radius: float
    half_angle: float
    rolling_axis: FloatArray
    rolling_half_angle: float
    reach: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))

    def beyond_reach(self, off: FloatArray, turn: FloatArray, most: float = 1.0) -> FloatArray:
        """What is left of an offset (3,) from the pad's centre that its reach does not take up.

        Args:
            off: m, in any axes.
            turn: Rotation (3, 3) of the pad's joint in those axes.
            most: How many times its reach may be taken up (-).
        """
        for along in self.reach @ turn.T:
            off = off - np.clip(off @ along / (along @ along), -most, most) * along
        return off

    @property
    def rolling(self) -> Pad:
        """The same pad with the cone within which contacts may roll."""
        return replace(self, axis=self.rolling_axis, half_angle=self.rolling_half_angle)


@dataclass(frozen=True, kw_only=True)
class Finger:
    """One finger.

    Attributes:
        name: Its name in the description.
        joints: Joint names from the palm outwards.
        q_index: (n,), where those joints stand in q.
        tip_frame: Name of the tip frame (a site), also in ``pin_model``.
        tip_frame_id: Its number in ``pin_model.frames``.
        pad: Where it touches.
        bodies: Names of the bodies that belong to the finger.
        is_link: Whether it is no finger but a link that can touch, or the palm: a finger that ends
            early (``planner.hands.link_pads``).
    """

    name: str
    joints: tuple[str, ...]
    q_index: IntArray
    tip_frame: str
    tip_frame_id: int
    pad: Pad
    bodies: frozenset[str]
    is_link: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class Side:
    """One hand of two, or the only one.

    Attributes:
        name: Its name in the description of the pair; "" of the only one.
        palm_body: Body of its palm.
        palm_normal: Direction the palm faces (3,), unit, in that body's frame.
        carriage: Where the joints of its carriage stand in q (6,); empty for the only one.
        fingers: Names of its fingers.
        alone: The ``Hand`` alone, of two; None of the only one.
    """

    name: str
    palm_body: str
    palm_normal: FloatArray
    carriage: IntArray
    fingers: tuple[str, ...]
    alone: Any = None

    def called(self, name: str) -> str:
        """What a body, joint or geometry of the hand alone is called in the whole."""
        return f"{self.name}/{name}" if self.name else name


class Resolver:
    """Resolves the names of a description in its model; ``where`` is what messages call it."""

    def __init__(
        self,
        where: str,
        description: HandDescription,
        mj_model: Any,
        pin_model: Any,
        geometries: tuple[LinkGeometry, ...],
    ) -> None:
        """Check what the description says of the hand as a whole."""
        self.where, self.description = where, description
        self.geometries = {g.name: g for g in geometries}
        self.mj_model, self.pin_model = mj_model, pin_model
        self.joints = tuple(pin_model.names)[1:]
        self.bodies = {body_name(mj_model, i): i for i in range(1, mj_model.nbody)}
        self.sites = {mj_model.site(i).name: i for i in range(mj_model.nsite)}
        endless = [
            name
            for name, low, high in zip(
                self.joints,
                pin_model.lowerPositionLimit,
                pin_model.upperPositionLimit,
                strict=True,
            )
            if not np.isfinite([low, high]).all()
        ]
        if endless:
            raise HandError(
                f"joints {endless} of {description.model} have no range; give them one in the "
                "model (range in MJCF, a <limit> and type revolute in URDF)"
            )
        for name in ("base_body", "palm_body"):
            self._need("body", getattr(description, name), self.bodies)
        for joint in description.wrist_joints:
            self._need("joint", joint, self.joints)
        for pair in description.allowed_contacts:
            for geom in pair:
                self._need("colliding geom", geom, self.geometries)

    def _need(self, kind: str, name: str, available: Any) -> None:
        if name not in available:
            hint = f"Correct it in {self.where}."
            raise NotFoundError(f"{kind} of {self.description.model}", name, available, hint)

    def fingers(self) -> Mapping[str, Finger]:
        """The fingers by name, in the description's order.

        Raises:
            HandError: No finger, a name or a joint used twice, or a pad or tip that does not fit.
            NotFoundError: A name that the model does not have.
        """
        if not self.description.fingers:
            raise HandError(f"{self.where} describes no finger; add at least one [[fingers]] table")
        out = {f.name: self._finger(f) for f in self.description.fingers}
        if len(out) != len(self.description.fingers):
            raise HandError(f"{self.where} describes two fingers of one name; rename one")
        used = Counter(joint for f in self.description.fingers for joint in f.joints)
        shared = sorted(joint for joint, count in used.items() if count > 1)
        if shared:
            raise HandError(f"{self.where}: joints {shared} are named twice among the fingers")
        for name in self.description.default_fingers:
            self._need("finger", name, out)
        return MappingProxyType(out)

    def _finger(self, finger: FingerDescription) -> Finger:
        for joint in finger.joints:
            self._need("joint", joint, self.joints)
        self._need("site", finger.tip_frame, self.sites)
        tip = self.pin_model.getFrameId(finger.tip_frame, pin.FrameType.OP_FRAME)
        if self.pin_model.names[self.pin_model.frames[tip].parentJoint] not in finger.joints:
            raise HandError(
                f"{self.where}: the tip site {finger.tip_frame!r} of finger {finger.name!r} does "
                f"not move with one of its joints {list(finger.joints)}; name a site of its last "
                "link"
            )
        ids = {self.pin_model.getJointId(j) for j in finger.joints}
        return Finger(
            name=finger.name,
            joints=finger.joints,
            q_index=np.array([self.joints.index(j) for j in finger.joints]),
            tip_frame=finger.tip_frame,
            tip_frame_id=int(tip),
            pad=self._pad(finger),
            bodies=frozenset(
                name
                for name in self.bodies
                if self.pin_model.frames[self.pin_model.getBodyId(name)].parentJoint in ids
            ),
        )

    def _pad(self, finger: FingerDescription) -> Pad:
        self._need("colliding geom", finger.pad.geom, self.geometries)
        geometry = self.geometries[finger.pad.geom]
        frame = self.pin_model.frames[self.pin_model.getBodyId(geometry.body)]
        if self.pin_model.names[frame.parentJoint] not in finger.joints:
            raise HandError(
                f"{self.where}: the pad geom {finger.pad.geom!r} of finger {finger.name!r} does "
                f"not move with one of its joints {list(finger.joints)}; name a geom of its last "
                "link"
            )
        center = np.array(frame.placement.act(np.array(finger.pad.center)))
        point = DistancePair(geometry.geometry, coal.Sphere(_POINT))
        depth = -point.distance(geometry.T_joint_geometry, SE3(np.eye(3), center)) - _POINT
        if abs(depth - finger.pad.radius) > PAD_TOL:
            raise HandError(
                f"{self.where}: the pad of finger {finger.name!r} has radius "
                f"{1e3 * finger.pad.radius:.2f} mm, but its center lies {1e3 * depth:.2f} mm below "
                f"the surface of {finger.pad.geom!r}; the pad is a sphere that touches it inside"
            )
        pad, turn = finger.pad, frame.placement.rotation
        rolling_axis = pad.axis if pad.rolling_axis is None else pad.rolling_axis
        return Pad(
            geom=pad.geom,
            joint_id=int(frame.parentJoint),
            center=center,
            axis=np.array(turn @ np.array(pad.axis)),
            radius=pad.radius,
            half_angle=float(np.deg2rad(pad.half_angle_deg)),
            rolling_axis=np.array(turn @ np.array(rolling_axis)),
            rolling_half_angle=float(np.deg2rad(pad.rolling_half_angle_deg or pad.half_angle_deg)),
        )

    def couplings(self) -> tuple[Coupling, ...]:
        """The couplings of the model, then the stops of the description, none of them twice.

        Raises:
            NotFoundError: A joint that the model does not have.
            HandError: Couplings contradict each other or the joint ranges.
            ModelError: An equality of the model is not linear in the joints.
        """
        out = list(couplings_from_mujoco(self.mj_model))
        for c in self.description.couplings:
            if c.kind == "equality":
                continue  # the loader has added it to the model
            row = np.zeros(len(self.joints))
            for joint, coefficient in c.joints.items():
                self._need("joint", joint, self.joints)
                row[self.joints.index(joint)] = coefficient
            out.append(Coupling(name=c.name, row=row, value=c.value, one_sided=True))
        kept = independent_couplings(out, self.where)
        lower, upper = self.pin_model.lowerPositionLimit, self.pin_model.upperPositionLimit
        check_couplings(kept, np.array(lower), np.array(upper), self.where)
        return kept
