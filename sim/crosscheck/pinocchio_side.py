"""A ``pinocchio.Model`` as a side of a cross-check, in the conventions of a MuJoCo reference.

With q and v in MuJoCo's order and axes, Pinocchio's velocity is v_pin = T(q) v, and its
acceleration a_pin = T qacc + a0, where a0 = dT/dt v. T permutes joints and turns the linear
velocity of a free joint from world axes (MuJoCo) into body axes (Pinocchio); so forces go by T^T,
the mass matrix is T^T M T, and the bias T^T (rnea(q, v, a0) - armature a0): rotor inertia acts on
MuJoCo's acceleration, not on a0. Quaternions run w, x, y, z here and x, y, z, w there.

``match`` finds which joint, body and site is which of the reference: by name, with a map of names
where they differ. Pinocchio's MJCF reader renames what has no name and drops the names of joints
that share a body: what is left over is matched by order, joint by joint inside the same body, and
body by body below the same parent.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from planner.spatial import SE3, FloatArray, pose_from_wxyz, skew
from sim.crosscheck.parts import (
    BALL,
    FREE,
    HINGE,
    SLIDE,
    BoolArray,
    JointFacts,
    Layout,
    LinkInertia,
    Observation,
    Parts,
    Slot,
    State,
)


@dataclass(frozen=True, kw_only=True)
class PinJoint:
    """A joint of a Pinocchio model; each part of a composite joint counts as one.

    Attributes:
        name: Its name; None for a part of a composite joint, whose name is lost.
        kind: "hinge", "slide", "ball", "free", or Pinocchio's own word for any other.
        id: Number of the joint, of the composite for a part.
        q: First index in q.
        nq: Positions: 2 for a hinge without limits that is stored as cosine and sine.
        v: Slice of v.
    """

    name: str | None
    kind: str
    id: int
    q: int
    nq: int
    v: slice


def joints_of(model: Any) -> tuple[PinJoint, ...]:
    """All joints in order, composites taken apart."""
    out = []
    for i in range(1, model.njoints):
        joint = model.joints[i]
        parts = [joint]
        if joint.shortname() == "JointModelComposite":
            parts = list(joint.extract().joints)
        q, v = joint.idx_q, joint.idx_v
        for part in parts:
            word = part.shortname().removeprefix("JointModel")
            name = None if len(parts) > 1 else model.names[i]
            dofs = slice(v, v + part.nv)
            out.append(PinJoint(name=name, kind=_kind(word), id=i, q=q, nq=part.nq, v=dofs))
            q, v = q + part.nq, v + part.nv
    return tuple(out)


def _kind(word: str) -> str:
    if word.startswith(("RX", "RY", "RZ", "RUB", "RevoluteUnaligned", "RevoluteUnbounded")):
        return HINGE
    if word.startswith(("PX", "PY", "PZ", "PrismaticUnaligned")):
        return SLIDE
    return {"Spherical": BALL, "FreeFlyer": FREE}.get(word, word)


class PinocchioSide:
    """A Pinocchio model, seen in the names and the order of a MuJoCo reference."""

    def __init__(
        self,
        model: Any,
        name: str,
        layout: Layout,
        *,
        joints: Mapping[str, PinJoint],
        bodies: Mapping[str, int],
        sites: Mapping[str, int],
        others: tuple[str, ...] = (),
    ) -> None:
        """Keep what belongs together; ``sim.crosscheck.pinocchio_side`` finds it.

        Args:
            model: ``pinocchio.Model``.
            name: What the side is called in tables.
            layout: The reference's.
            joints: Joint of the reference -> joint of this model, of whatever kind.
            bodies: Body of the reference -> frame number.
            sites: Site of the reference -> frame number.
            others: What the model has and the reference has not.
        """
        self.name, self.model, self.layout = name, model, layout
        self._data = model.createData()
        self._joints, self._bodies, self._sites = dict(joints), dict(bodies), dict(sites)
        self._others = others
        self._pairs = [
            (slot, joints[slot.name])
            for slot in layout.joints
            if slot.name in joints and joints[slot.name].kind == slot.kind
        ]

    @property
    def moving(self) -> BoolArray:
        """Which degrees of freedom (nv,) of the reference it has, as booleans."""
        out = np.zeros(self.layout.nv, dtype=bool)
        for slot, _ in self._pairs:
            out[slot.v] = True
        return out

    def parts(self) -> Parts:
        """What does not depend on the configuration."""
        links = {}
        for name, frame in self._bodies.items():
            at = self.model.frames[frame]
            own = self.model.inertias[at.parentJoint]
            if self.layout.roots[name] == name and (own.mass > 0 or np.any(own.inertia)):
                local = at.placement.actInv(own)
                links[name] = LinkInertia(
                    mass=local.mass, center=np.array(local.lever), inertia=np.array(local.inertia)
                )
        slots = {slot.name: slot for slot in self.layout.joints}
        return Parts(
            joints={name: self._facts(slots[name], j) for name, j in self._joints.items()},
            links=links,
            inertias={},
            bodies=frozenset(self._bodies),
            sites=frozenset(self._sites),
            gravity=np.array(self.model.gravity.linear),
            others=self._others,
        )

    def observe(self, state: State) -> Observation:
        """What Pinocchio computes at a state."""
        m, d = self.model, self._data
        q = self._configuration(state)
        turn, rate = self._velocity_map(state)
        v = turn @ state.qvel
        pin.computeJointJacobians(m, d, q)
        pin.updateFramePlacements(m, d)
        body_jacobians = {n: self._jacobian(f, turn) for n, f in self._bodies.items()}
        site_jacobians = {n: self._jacobian(f, turn) for n, f in self._sites.items()}
        bodies = {n: SE3(d.oMf[f]) for n, f in self._bodies.items()}
        sites = {n: SE3(d.oMf[f]) for n, f in self._sites.items()}
        pin.centerOfMass(m, d, q, True)
        centers = {}
        for name, frame in self._bodies.items():
            joint = int(m.frames[frame].parentJoint)
            if self.layout.roots[name] == name and joint > 0 and d.mass[joint] > 0:
                centers[name] = d.oMi[joint].act(d.com[joint])
        upper = np.triu(np.asarray(pin.crba(m, d, q)).reshape(m.nv, m.nv))
        inertia = upper + np.triu(upper, 1).T
        still = pin.rnea(m, d, q, v, rate) - m.armature * rate
        gravity = pin.computeGeneralizedGravity(m, d, q)
        mass_matrix = turn.T @ inertia @ turn
        bias = turn.T @ still
        return Observation(
            bodies=bodies,
            sites=sites,
            body_jacobians=body_jacobians,
            site_jacobians=site_jacobians,
            mass_matrix=mass_matrix,
            coriolis=bias - turn.T @ gravity,
            gravity=turn.T @ gravity,
            acceleration=self._accelerate(q, v, turn, rate, state, mass_matrix, bias),
            centers=centers,
        )

    def _accelerate(
        self,
        q: FloatArray,
        v: FloatArray,
        turn: FloatArray,
        rate: FloatArray,
        state: State,
        mass_matrix: FloatArray,
        bias: FloatArray,
    ) -> FloatArray:
        """Qacc (nv,), by the articulated-body algorithm where the joints are the same.

        Where the model has other joints besides, these do not move: then from the mass matrix.
        """
        m, on = self.model, self.moving & state.moving
        if not on.any():
            return np.zeros(self.layout.nv)
        if turn.shape[0] == int(on.sum()):
            square = turn[:, on]
            torque = np.linalg.solve(square.T, state.torque[on])
            torque += m.armature * rate - m.damping * v
            found = pin.aba(m, self._data, q, v, torque)
            solved = np.linalg.solve(square, found - rate)
        else:
            damped = bias + turn.T @ (m.damping * v)
            block = mass_matrix[np.ix_(on, on)]
            if np.linalg.matrix_rank(block) < len(block):  # a joint that moves no mass
                return np.full(self.layout.nv, np.nan)
            solved = np.linalg.solve(block, (state.torque - damped)[on])
        out = np.zeros(self.layout.nv)
        out[on] = solved
        return out

    def _configuration(self, state: State) -> FloatArray:
        """Pinocchio's q (nq,); joints that the reference has not are at zero."""
        q = pin.neutral(self.model)
        for slot, joint in self._pairs:
            values = state.qpos[slot.q]
            if slot.kind in (FREE, BALL):
                w, x, y, z = values[-4:]
                values = np.array([*values[:-4], x, y, z, w])
            elif joint.nq == 2:
                values = np.array([np.cos(values[0]), np.sin(values[0])])
            q[joint.q : joint.q + joint.nq] = values
        return np.asarray(q)

    def _velocity_map(self, state: State) -> tuple[FloatArray, FloatArray]:
        """T (nv of the model, nv) and a0 (nv of the model,)."""
        turn, rate = np.zeros((self.model.nv, self.layout.nv)), np.zeros(self.model.nv)
        for slot, joint in self._pairs:
            block = np.eye(slot.v.stop - slot.v.start)
            if slot.kind == FREE:
                quaternion = state.qpos[slot.q][3:]
                block[:3, :3] = pose_from_wxyz(np.zeros(3), quaternion).rotation.T
                speed, spin = state.qvel[slot.v][:3], state.qvel[slot.v][3:]
                rate[joint.v.start : joint.v.start + 3] = -skew(spin) @ block[:3, :3] @ speed
            turn[joint.v, slot.v] = block
        return turn, rate

    def _jacobian(self, frame: int, turn: FloatArray) -> FloatArray:
        if self.model.nv == 0:  # where Pinocchio 4.1 crashes
            return np.zeros((6, self.layout.nv))
        own = pin.getFrameJacobian(self.model, self._data, frame, pin.LOCAL_WORLD_ALIGNED)
        return np.asarray(own).reshape(6, -1) @ turn  # one column comes back as a vector

    def _facts(self, slot: Slot, joint: PinJoint) -> JointFacts:
        m, v = self.model, joint.v
        bounds = None
        if slot.kind in (HINGE, SLIDE) and joint.kind in (HINGE, SLIDE):
            bounds = np.array([-np.inf, np.inf])
            if joint.nq == 1:
                bounds = np.array([m.lowerPositionLimit[joint.q], m.upperPositionLimit[joint.q]])
        effort = np.stack([m.lowerEffortLimit[v], m.upperEffortLimit[v]], axis=1)
        return JointFacts(
            kind=joint.kind,
            range=bounds,
            armature=np.array(m.armature[v]),
            damping=np.array(m.damping[v]),
            friction=np.array(m.upperDryFrictionLimit[v]),
            effort=effort,
            velocity=np.array(self.model.velocityLimit[joint.v]),
        )


_WORLD = "world"
"""Link of a URDF that is MuJoCo's world, which is no body of its own."""


def match(
    model: Any, name: str, layout: Layout, names: Mapping[str, str] | None = None
) -> PinocchioSide:
    """A Pinocchio model as a side of a cross-check.

    Args:
        model: ``pinocchio.Model``.
        name: What the side is called in tables.
        layout: The reference's.
        names: Reference's name -> the model's name, where they differ.
    """
    renamed = names or {}
    bodies = _frames(model, pin.FrameType.BODY)
    sites = _frames(model, pin.FrameType.OP_FRAME)
    found_bodies: dict[str, int] = {}
    for body, parent in layout.parents.items():
        wanted = renamed.get(body, body)
        if wanted not in bodies and parent in found_bodies:  # Pinocchio's word for "no name"
            wanted = f"{model.frames[found_bodies[parent]].name}Bis"
        if wanted in bodies and bodies[wanted] not in found_bodies.values():
            found_bodies[body] = bodies[wanted]
    found_sites = {
        site: sites[renamed.get(site, site)]
        for site in layout.sites
        if renamed.get(site, site) in sites
    }
    found_joints = _joints(model, layout, renamed, found_bodies)
    used = {*found_bodies.values(), *found_sites.values()}
    taken = [*found_joints.values()]
    others = [f"joint {j.name}" for j in joints_of(model) if j not in taken and j.name]
    others += [f"body {n}" for n, f in bodies.items() if f not in used and n != _WORLD]
    others += [f"site {n}" for n, f in sites.items() if f not in used]
    return PinocchioSide(
        model,
        name,
        layout,
        joints=found_joints,
        bodies=found_bodies,
        sites=found_sites,
        others=tuple(others),
    )


def _frames(model: Any, kind: Any) -> dict[str, int]:
    return {f.name: i for i, f in enumerate(model.frames) if f.type == kind}


def _joints(
    model: Any, layout: Layout, names: Mapping[str, str], bodies: Mapping[str, int]
) -> dict[str, PinJoint]:
    present = joints_of(model)
    by_name = {joint.name: joint for joint in present if joint.name}
    out = {
        slot.name: by_name[names.get(slot.name, slot.name)]
        for slot in layout.joints
        if names.get(slot.name, slot.name) in by_name
    }
    taken = list(out.values())
    for body, frame in bodies.items():  # what has lost its name: by its body, in order
        wanted = [s for s in layout.joints if s.body == body and s.name not in out]
        carrier = int(model.frames[frame].parentJoint)
        left = [j for j in present if j.id == carrier and j not in taken and _nameless(j)]
        if layout.roots[body] == body and len(wanted) == len(left):
            out.update(zip((s.name for s in wanted), left, strict=True))
            taken += left
    return out


def _nameless(joint: PinJoint) -> bool:
    """Part of a composite, or named by Pinocchio's reader: ``<body>Joint_<i>``, ``<body>_free``."""
    return joint.name is None or "Joint_" in joint.name or joint.name.endswith("_free")
