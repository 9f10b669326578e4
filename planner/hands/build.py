"""From a model and a description to a ``Hand``: its parts, built once and checked.

MuJoCo compiles the model; Pinocchio's model, coal's geometries and the actuation are built from the
compiled model by ``planner.bridge``; the names of the description are resolved in them and checked.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from planner.bridge import (
    LinkGeometry,
    actuation_from_mujoco,
    add_described_parts,
    compile_spec,
    couplings_from_mujoco,
    hand_geometries,
    pinocchio_from_mujoco,
    prepare_spec,
)
from planner.bridge.geometry import allowed_pairs
from planner.bridge.load import model_bytes, model_files
from planner.bridge.numbers import check_numbers
from planner.bridge.pinocchio_model import body_name
from planner.errors import HandError, NotFoundError
from planner.hands.arm import Mount
from planner.hands.description_toml import MirrorAxis, reflection_signs
from planner.hands.fingers import Finger, Pad, Side
from planner.hands.hand import Hand
from planner.joints.couplings import (
    Coupling,
    check_couplings,
    check_held,
    independent_couplings,
)
from planner.joints.description import FingerDescription, HandDescription
from planner.shapes.convex_pairs import DistancePair
from planner.spatial import SE3

__all__ = ["build_from_spec", "build_hand", "hand_of_model", "hand_on_arm"]

PAD_TOL = 5e-4
"""How far (m) a pad's sphere may be from the surface of its geometry: the tolerance of touch."""

_POINT = 1e-6
"""Radius (m) of the ball that stands for a point."""


def build_from_spec(spec: Any, description: HandDescription) -> Hand:
    """A hand from a ``mujoco.MjSpec`` made in Python; the spec itself is left as it is.

    Args:
        spec: The model; bodies outside the base's subtree are dropped.
        description: What names its palm, base, fingers and pads.

    Raises:
        NotFoundError: The description names what the model does not have.
        ModelError: The model is not usable.
        HandError: Description and model do not fit.
    """
    from planner.bridge.structure import read_spec  # here: models in memory alone

    what = f"the model {spec.modelname!r}"
    return build_hand(
        read_spec(spec),
        description,
        mirror_axis=None,
        path=None,
        where=f"the description of {what}",
        model=what,
        reference=None,
        digest=None,
    )


def build_hand(
    spec: Any,
    description: HandDescription,
    *,
    mirror_axis: MirrorAxis | None,
    path: Path | None,
    where: str,
    model: str,
    reference: str | None,
    digest: str | None,
) -> Hand:
    """A hand from a spec, which is changed, and a description.

    Args:
        spec: ``mujoco.MjSpec`` of the hand.
        description: What names its palm, base, fingers and pads.
        mirror_axis: Axis along which the hand is mirrored, or None.
        path: The file that describes the hand, or None.
        where: What errors call the description.
        model: What errors call the model.
        reference: What ``load_hand`` takes to get the same hand again, or None.
        digest: SHA-256 of what determines the hand; computed from the model if None.

    Raises:
        NotFoundError: The description names what the model does not have.
        ModelError: The model is not usable.
        HandError: Description and model do not fit.
    """
    spec = prepare_spec(spec, description, model)
    if mirror_axis is not None:
        from planner.bridge import mirror_spec

        mirror_spec(spec, reflection_signs(mirror_axis), model)
    add_described_parts(spec, description, model)
    if description.motors:
        from planner.bridge import motorise_spec

        motorise_spec(spec, model)
    mj_model = compile_spec(spec, model)
    if mj_model.nq != mj_model.nv or mj_model.nq != mj_model.njnt:
        raise HandError(
            f"{model} has free or ball joints below {description.base_body!r}; a hand has "
            "hinges and slides: replace a ball joint by hinges, or name another base_body"
        )
    if mj_model.nq == 0:
        raise HandError(
            f"{model} has no joint below {description.base_body!r}; name another base_body"
        )
    check_numbers(mj_model, model)
    if digest is None:
        content = description.model_dump_json().encode() + model_bytes(mj_model)
        digest = hashlib.sha256(content).hexdigest()
    hand = hand_of_model(
        spec,
        mj_model,
        description,
        where=where,
        path=path,
        reference=reference,
        digest=digest,
    )
    for posture in description.postures:
        hand.posture(posture)
    return hand


def hand_on_arm(hand: Hand, mount: Mount, reference: str) -> Hand:
    """A hand that an arm carries.

    Args:
        hand: The hand alone.
        mount: The description of arm and flange.
        reference: What ``load_hand`` takes to get the same again.

    Raises:
        ModelError: The arm's model is missing or not usable.
        HandError: Arm and hand do not fit.
    """
    where = str(mount.path)
    spec, root = mount.attach(hand.new_spec())
    mj_model = compile_spec(spec, where)
    check_numbers(mj_model, where)
    if mj_model.nq != mj_model.njnt:
        raise HandError(f"{mount.arm_path} has free or ball joints; use hinges and slides")
    described = mount.description
    description = hand.description.model_copy(
        update={"name": described.name, "summary": described.summary, "base_body": root}
    )
    files = (mount.path, *model_files(mount.arm_path))
    content = hand.digest.encode() + b"".join(f.read_bytes() for f in files)
    return hand_of_model(
        spec,
        mj_model,
        description,
        where=where,
        path=mount.path,
        reference=reference,
        digest=hashlib.sha256(content).hexdigest(),
        mount=mount,
    )


def hand_of_model(
    spec: Any,
    mj_model: Any,
    description: HandDescription,
    *,
    where: str,
    path: Path | None,
    reference: str | None,
    digest: str,
    mount: Mount | None = None,
    sides: Callable[[Sequence[str]], tuple[Side, ...]] | None = None,
) -> Hand:
    """The hand of a compiled model: everything that follows from model and description.

    Args:
        spec: ``mujoco.MjSpec`` of the hand, prepared.
        mj_model: The same, compiled.
        description: What names its palm, base, fingers and pads.
        where: What errors call the description.
        path: Its file, or None.
        reference: What ``load_hand`` takes to get the same hand again, or None.
        digest: SHA-256 of what determines the hand.
        mount: The arm that carries it, or None.
        sides: The two hands that this is, by the names of all joints; None for one hand.

    Raises:
        NotFoundError: The description names what the model does not have.
        HandError: Description and model do not fit.
    """
    pin_model = pinocchio_from_mujoco(mj_model)
    geometries = hand_geometries(mj_model, pin_model)
    resolver = Resolver(where, description, mj_model, pin_model, geometries)
    arm = None
    if mount is not None:
        palm = int(pin_model.getBodyId(description.palm_body))
        arm = mount.arm(pin_model, palm, geometries)
    hand = Hand(
        name=description.name,
        description=description,
        path=path,
        reference=reference,
        digest=digest,
        spec=spec,
        mj_model=mj_model,
        pin_model=pin_model,
        fingers=resolver.fingers(),
        geometries=geometries,
        allowed_pairs=allowed_pairs(mj_model, description.allowed_contacts),
        actuation=actuation_from_mujoco(mj_model),
        couplings=resolver.couplings(),
        arm=arm,
        pair=() if sides is None else sides(tuple(pin_model.names)[1:]),
    )
    drive = hand.actuation
    check_held(hand.joint_names, drive.moment, hand.couplings, where, drive.names)
    return hand


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
