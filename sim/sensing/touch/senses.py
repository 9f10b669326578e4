"""Senses of touch by name: what turns the truth of a step into what pads say.

Each has a file and one registration. All give the same ``PadReading``, so that a controller or an
estimator runs with any of them; ``ErrorModel.touch`` names the one of a trial.

    exact     MuJoCo's own contacts: force, place, normal and sliding without error
    taxels    arrays of taxels (``sim.sensing.touch.taxels``)
    effort    the torques of the motors (``sim.sensing.touch.effort``)
    binary    whether a pad touches, and nothing else (``sim.sensing.touch.effort``)

``PadBodies`` and ``PlannedPads``: where the pads are, how they move, and sliding from joints.

Shared by the senses that have no sense of sliding: what slides is seen in the joints, where one
fingertip moves otherwise than the rigid body that the others hold.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from planner.kinematics import HandState
from planner.plan import GraspPlan
from planner.registry import Registry
from planner.spatial import SE3, FloatArray, cross, skew
from sim.contacts.reading import body_twist
from sim.controllers import Observation, PadReading, TouchReading
from sim.controllers.base import EXACT
from sim.scene.build import HAND_PREFIX, Scene
from sim.sensing.touch.exact import layouts_of
from sim.sensing.touch.layout import TaxelLayout


class TouchSense(Protocol):
    """A sense of touch during one trial."""

    def read(self, truth: Observation) -> Observation:
        """The observation with what this sense feels; called once a time step, in order."""
        ...


@dataclass(frozen=True, kw_only=True, eq=False)
class TouchContext:
    """What a sense is made from.

    Attributes:
        scene: The scene.
        data: ``mujoco.MjData``, as it is at every step.
        plan: What is executed: where contacts were planned.
        seed: Of all noise.
        dry_friction: Of every joint beside what the hand's model has, N m (N for slides): a
            laboratory knows about how stiff its hand turns.
    """

    scene: Scene
    data: Any
    plan: GraspPlan
    seed: int
    dry_friction: float = 0.0


MakeSense: TypeAlias = Callable[[TouchContext], TouchSense]
"""What makes a sense for a trial."""

TOUCH_SENSES: Registry[MakeSense] = Registry("sense of touch", group="senses")
"""Senses by their names."""

register_touch = TOUCH_SENSES.add


def check_touch(name: str) -> str:
    """The name of a sense, checked.

    Raises:
        NotFoundError: There is none of that name.
    """
    TOUCH_SENSES.named(name)
    return name


def make_sense(name: str, context: TouchContext) -> TouchSense:
    """The sense of a name, for a trial.

    Raises:
        NotFoundError: There is none of that name.
    """
    return TOUCH_SENSES.named(name)(context)


class ExactSense:
    """Leaves an observation as it is."""

    def __init__(self, context: TouchContext) -> None:
        """Nothing to prepare."""
        del context

    def read(self, truth: Observation) -> Observation:
        """The truth."""
        return truth


register_touch(EXACT, ExactSense)


RANK = 1e-8
"""Added to the normal equations (m2): two contacts leave a turn about their line open."""

NOT_HOLDING = 1e-3
"""Weight (-) of a finger that slips beside that of one that sticks."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PadBodies:
    """The bodies that carry the pads of n fingers.

    Attributes:
        scene: The scene.
        data: ``mujoco.MjData``, as it is at every step.
        bodies: n body ids.
    """

    scene: Scene
    data: Any
    bodies: tuple[int, ...]

    @classmethod
    def of(cls, scene: Scene, data: Any, layouts: Sequence[TaxelLayout]) -> PadBodies:
        """Those that some layouts belong to."""
        geoms = [int(scene.model.geom(HAND_PREFIX + one.geom).id) for one in layouts]
        return cls(scene=scene, data=data, bodies=tuple(scene.body_of_geom[g] for g in geoms))

    def turns(self) -> FloatArray:
        """Rotations (n, 3, 3) of the bodies in the world."""
        return np.asarray(self.data.xmat[list(self.bodies)].reshape(-1, 3, 3))

    def places(self) -> FloatArray:
        """Origins (n, 3) of the bodies in the world, m."""
        return np.array(self.data.xpos[list(self.bodies)])

    def sliding(
        self,
        points: FloatArray,
        normals: FloatArray,
        touching: NDArray[np.bool_],
        stick: FloatArray,
    ) -> FloatArray:
        """Velocity of the object over the pads as the joints tell it, (n, 3), m/s, world.

        The object moves like the rigid body that fits the fingertips best; where all slip alike,
        or fewer than three touch, it is not seen.

        Args:
            points: (n, 3), contacts, m, world; NaN without contact.
            normals: (n, 3), unit.
            touching: (n,).
            stick: (n,), how sure it is that a pad sticks, 0 to 1: its weight.
        """
        out = np.full((len(points), 3), np.nan)
        rows = np.flatnonzero(touching)
        if not len(rows):
            return out
        out[rows] = 0.0
        if len(rows) < 3:
            return out
        at = points[rows] - points[rows].mean(axis=0)
        twists = np.array([body_twist(self.scene, self.data, self.bodies[k]) for k in rows])
        velocity = twists[:, 3:] - cross(points[rows], twists[:, :3])
        weight = np.maximum(stick[rows], NOT_HOLDING)
        motion = np.concatenate([np.tile(np.eye(3), (len(rows), 1, 1)), -skew(at)], axis=2)
        weighted = motion * weight[:, None, None]
        gram = np.einsum("kij,kil->jl", weighted, motion) + RANK * np.eye(6)
        twist = np.linalg.solve(gram, np.einsum("kij,ki->j", weighted, velocity))
        slid = motion @ twist - velocity
        along = (slid * normals[rows]).sum(axis=1, keepdims=True)
        out[rows] = slid - along * normals[rows]
        return out


class PlannedPads:
    """Where contacts are expected on pads that do not feel it: the plan, turned with the fingers.

    What the fingers hold turns about as the polygon of their pads' centres does: the turn that fits
    the centres best turns the planned normals. A contact is where the expected normal leaves the
    pad.
    """

    def __init__(self, context: TouchContext) -> None:
        """Take over centres and normals of a plan."""
        plan = context.plan
        layouts = layouts_of(context.scene, plan.task.finger_names)
        self._bodies = PadBodies.of(context.scene, context.data, layouts)
        self._in_body = np.array([one.center for one in layouts])
        self._radii = np.array([[one.radius] for one in layouts])
        state = HandState(plan.task.hand, plan.q)
        points = plan.contacts.transformed(plan.T_world_base.inverse()).positions
        self._centers = np.array([state.pad_center(finger) for finger in plan.task.fingers])
        away = points - self._centers
        self._normals = away / np.linalg.norm(away, axis=1, keepdims=True)

    def expected(self, T_world_base: SE3) -> tuple[FloatArray, FloatArray]:
        """Normals (n, 3), unit, into the object, and contacts (n, 3), m, of now; world.

        Args:
            T_world_base: Pose of the hand's base.
        """
        centers = (self._bodies.turns() @ self._in_body[:, :, None])[:, :, 0]
        centers += self._bodies.places()
        turn = T_world_base.rotation
        before, now = self._centers - self._centers.mean(axis=0), centers - centers.mean(axis=0)
        if len(centers) > 2:
            left, _, right = np.linalg.svd((before @ turn.T).T @ now)
            proper = np.diag([1.0, 1.0, float(np.sign(np.linalg.det(left @ right)))])
            turn = (left @ proper @ right).T @ turn
        normals = np.asarray(self._normals @ turn.T)
        return normals, centers + self._radii * normals

    def observation(
        self,
        truth: Observation,
        touching: NDArray[np.bool_],
        force: FloatArray,
        normal: FloatArray,
        position: FloatArray,
    ) -> Observation:
        """The truth with readings of n pads that have no taxels and see sliding in the joints.

        Args:
            truth: What there is.
            touching: (n,).
            force: (n, 3), on the object, N, world.
            normal: (n, 3), unit, of ``expected``.
            position: (n, 3), m, of ``expected``.
        """
        reading = pad_reading(
            touching=touching,
            force=force,
            normal=normal,
            position=position,
            sliding=self._bodies.sliding(position, normal, touching, np.ones(len(touching))),
        )
        return replace(
            truth,
            normal_forces=reading.normal_force,
            read_pads=lambda: reading,
            read_touch=TouchReading.nothing,
        )


def pad_reading(
    *,
    touching: NDArray[np.bool_],
    force: FloatArray,
    normal: FloatArray,
    position: FloatArray,
    sliding: FloatArray,
    slipping: NDArray[np.bool_] | None = None,
) -> PadReading:
    """A reading of n pads; what a pad without contact has is left out.

    Args:
        touching: (n,).
        force: (n, 3), on the object, N, world.
        normal: (n, 3), unit, into the object.
        position: (n, 3), m.
        sliding: (n, 3), m/s.
        slipping: (n,), or None.
    """
    there = touching[:, None]
    along = (force * normal).sum(axis=1)
    return PadReading(
        normal_force=np.where(touching, np.maximum(along, 0.0), 0.0),
        force=np.where(there, force, 0.0),
        position=np.where(there, position, np.nan),
        normal=np.where(there, normal, np.nan),
        sliding=np.where(there, sliding, np.nan),
        slipping=slipping,
    )
