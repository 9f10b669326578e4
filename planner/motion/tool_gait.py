"""``plan_tool_gait``: a tool that stands in its fixture is turned by strokes and regrasps.

The palm stands still. The tool is planned for as a cylinder about its centre of mass, as wide as
its round handle and as long as reaches the handle's end: what is left of a tool of revolution is
nearer to its axis. Every knot produces the needed wrenches with their margin and bears the weight
(``planner.motion.verify``). While a finger moves on, the others bear the weight alone, as in the
air; the fixture is not counted on, but to need no wrench from the hand then: its dry friction
stands still. At last all postures are checked against the true tool and what stands around, which a
gait in the air leaves below. Called by ``sim.tools.fingers``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations, cycle, islice, product

import numpy as np

from planner.collision.pad_contact import pad_contact_queries
from planner.collision.pregrasp_ik import idle_joints
from planner.collision.world import CollisionWorld
from planner.errors import NoGraspFoundError, ObjectError
from planner.failure import Failure
from planner.motion.ending import let_go
from planner.motion.gait import MAX_ATTEMPTS, STROKES, plan_gait
from planner.motion.phase import Phase, Relocation, Stroke
from planner.motion.plan import ManipulationPlan, MovementPlan
from planner.motion.regrasp import LOADED_ROOM
from planner.motion.search import MOTION_OPTIONS
from planner.motion.task import SEEDS_APART
from planner.shapes import Mesh
from planner.shapes.registry import shape_key
from planner.shapes.round import Cylinder
from planner.spatial import FloatArray
from planner.task import GraspTask
from planner.tolerances import PENETRATION_TOL
from planner.tools import ASKED_CLEARANCE, Tool
from planner.verification import verify_grasp

ROUND = 2e-4
"""Largest difference (m) of the distances of a handle's points from the axis: that of a polygon of
48 corners is 0.03 mm at a radius of 15 mm, and a contact is judged to 0.5 mm."""

UPRIGHT = 0.9999
"""Least cosine (-) between a tool's axis and z of its frame: an axis that is written with four
digits, 0.8 degrees."""

END = 0.7
"""Cosine (-) between the normal of a face and z from which on it is an end of the handle."""

FEWEST = 4
"""Fewest fingers of a gait of point contacts: three hold while one moves on."""

SEARCHES = 24
"""Searches before giving up: of the sets of fingers in turn, each of some 7 s of CPU."""

SHORT_STROKES = tuple(np.deg2rad([15.0, 12.0, 18.0, 20.0]))
"""Angles (rad) of a stroke in every other round of the sets. Around a handle of 28 mm fingers of
16 mm have room for no more: of two such screws six searches each with strokes of 20 to 36 degrees
found nothing, these the third and the fourth time."""


def handle_cylinder(tool: Tool) -> Tool:
    """The tool as a cylinder about its centre of mass, for planning how fingers turn it.

    Raises:
        ObjectError: Its axis is not along z of its frame, or its handle is not round about it.
    """
    shape = tool.shape
    if abs(tool.axis[2]) < UPRIGHT or np.hypot(*tool.tip[:2]) > ROUND:
        raise ObjectError(
            f"{tool.name} does not turn about the vertical through its centre of mass; fingers "
            "turn a tool whose axis and tip are on z: give a tool of revolution"
        )
    if isinstance(shape, Cylinder):
        return tool
    points = _side(shape) if isinstance(shape, Mesh) else np.zeros((0, 3))
    assert tool.touch is not None  # a tool for a use has a handle
    handle = points[replace(tool.touch, forbidden=()).permits(points)] if len(points) else points
    away = np.linalg.norm(handle[:, :2], axis=1)
    away = away[away > ROUND] if (away > ROUND).any() else np.zeros(1)  # without its end's middle
    if not np.ptp(away) <= ROUND or not away.max() > 0.0:
        raise ObjectError(
            f"the handle of {tool.name} is {1e3 * away.min():.1f} to {1e3 * away.max():.1f} mm "
            "from its axis; fingers repeat their postures after every stroke, so it must be round: "
            "take a tool with a round handle, or turn it by the wrist"
        )
    height = 2.0 * float(np.abs(handle[:, 2]).max())
    radius = round(float(away.max()), 9)  # as a file has it
    return replace(tool, shape=Cylinder(radius=radius, height=round(height, 9)))


def _side(shape: Mesh) -> FloatArray:
    """Corners and middles of edges (m, 3), m, of the faces of a mesh that are not ends of it.

    Between corners, since all corners of a square bar are equally far from its axis.
    """
    corners = shape.vertices[shape.faces]  # (n, 3, 3)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normals, axis=1)
    sides = corners[np.abs(normals[:, 2]) < END * size]
    middles = 0.5 * (sides + np.roll(sides, 1, axis=1))
    return np.concatenate([sides, middles]).reshape(-1, 3)


def plan_tool_gait(
    task: GraspTask, *, angle: float, seed: int = 0, max_attempts: int = MAX_ATTEMPTS
) -> ManipulationPlan:
    """A turn of a tool about the vertical by the fingers alone, where it stands in its fixture.

    Args:
        task: From ``planner.tools.use_task``, the tool with its tip in the fixture.
        angle: Turn, rad, with its sign about the world's z.
        seed: Same seed, same plan.
        max_attempts: Budget in attempts of each of ``SEARCHES`` searches.

    Returns:
        Strokes and regrasps of a cylinder (``handle_cylinder``), with the tool as it is; it ends
        where it stands.

    Raises:
        NoGraspFoundError: The budget ended; says what ended the last search.
        ObjectError: The tool is not round where it is held.
        TaskError: The task cannot work.
    """
    tool = task.object
    assert isinstance(tool, Tool)
    rounded = replace(task, object=handle_cylinder(tool))
    why: list[str] = []
    attempts, cpu_s = 0, 0.0
    for number, (one, strokes) in enumerate(_searches(rounded)):
        try:
            gait = plan_gait(
                one,
                angle=angle,
                seed=seed + number * SEEDS_APART,
                max_attempts=max_attempts,
                strokes=strokes,
                options=replace(MOTION_OPTIONS, clear_fingers=ASKED_CLEARANCE),
            )
        except NoGraspFoundError as error:
            why.append(str(error))
            attempts += len(error.attempts)
            cpu_s += sum(one.cpu_s for one in error.attempts)
            continue
        attempts, cpu_s = attempts + gait.record.attempts, cpu_s + gait.record.cpu_s
        true = replace(gait.task, object=tool)
        gait = idle_fingers_apart(gait, true)
        blocked = posture_blocked(gait, true)
        if blocked is not None:
            why.append(str(blocked))
            continue
        record = replace(gait.record, attempts=attempts, cpu_s=cpu_s)
        gait = replace(gait, record=record, tool=tool)
        ending = let_go(gait, angle)
        if isinstance(ending, Failure):
            why.append(str(ending))
            continue
        return ManipulationPlan.of(gait, ending, angle=angle, shift=np.zeros(3))
    raise NoGraspFoundError(
        f"no gait of {tool.name} with {task.hand.name} in {attempts} attempts; the last search: "
        f"{why[-1]}. Take another seed, a tool of another size, or turn it by the wrist",
        (),
    )


def _searches(task: GraspTask) -> Iterator[tuple[GraspTask, tuple[float, ...]]]:
    """The task with all fingers of the hand, then with one less, for each but the first; strokes.

    Long strokes of all sets of fingers, then short ones, and so on.
    """
    names = tuple(task.hand.fingers) if task.may_spare_fingers else task.finger_names
    sets = [names]
    if task.may_spare_fingers and len(names) > FEWEST:
        sets = [one for one in combinations(names, len(names) - 1) if one[0] == names[0]]
    rounds = product((STROKES, SHORT_STROKES), sets)
    for strokes, one in islice(cycle(rounds), SEARCHES):
        yield task.with_fingers(one), strokes


def verify_tool_gait(gait: MovementPlan) -> Failure | None:
    """Why strokes and regrasps are none of their tool, or not free where it stands; None if so."""
    tool = gait.tool
    assert tool is not None
    planned, rounded = gait.task.object, handle_cylinder(tool)
    for what, one, other in (
        ("names", planned.name, rounded.name),
        ("handle sizes", shape_key(planned.shape), shape_key(rounded.shape)),
        ("needed wrenches", gait.task.needed, rounded.needed),
    ):
        if one != other:
            text = f"the strokes are of a {planned.name} with other {what} than {tool.name} has"
            return Failure(kind="other_tool", text=text)
    return posture_blocked(gait, replace(gait.task, object=tool))


IDLE_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Shares (-) of the way from where idle fingers are planned to straight ones that are tried."""


def idle_fingers_apart(gait: MovementPlan, task: GraspTask) -> MovementPlan:
    """The gait with idle fingers still, straightened as far as leaves all links most room.

    Fingers that move on pass by them: a little finger pressed on an idle ring finger with 5 N.

    Args:
        gait: The gait.
        task: With the true object and what stands around.
    """
    hand = task.hand
    index = idle_joints(hand, task.finger_names)
    if not len(index):
        return gait
    planned, grasp = gait.knots[0].q[index], gait.grasp
    lower, upper = hand.q_lower[index], hand.q_upper[index]
    straight = np.clip(hand.neutral[index], lower, upper)
    world, pads = CollisionWorld(task), pad_contact_queries(task).names

    def at(share: float, q: FloatArray) -> FloatArray:
        out = q.copy()
        out[..., index] = planned + share * (straight - planned)
        return out

    def room(share: float) -> float:
        return min(
            world.closest(gait.T_world_base, at(share, q), 1, may_touch=pads)[0].distance
            for q in _postures(gait)
        )

    best = max(IDLE_SHARES, key=room)
    q = at(best, grasp.q)
    found = verify_grasp(gait.task, grasp.T_world_base, q, record=grasp.record)
    if isinstance(found, Failure):
        return gait

    def apart(phase: Phase) -> Phase:
        if isinstance(phase, Stroke):
            knots = tuple(replace(knot, q=at(best, knot.q)) for knot in phase.knots)
            return replace(phase, knots=knots)
        if isinstance(phase, Relocation):
            return replace(phase, postures=at(best, phase.postures))
        return phase

    return replace(gait, grasp=found, phases=tuple(map(apart, gait.phases)))


def _postures(gait: MovementPlan) -> list[FloatArray]:
    """Joints (nq,) of the first stroke and of the swings after it; one cycle stands for all."""
    return [k.q for k in gait.knots] + [q for r in gait.regrasps for q in r.postures]


def posture_blocked(gait: MovementPlan, task: GraspTask) -> Failure | None:
    """What is in the way in a posture of a gait, the palm where it grasps; None if nothing.

    Nothing may be penetrated, and links of different fingers keep ``LOADED_ROOM`` apart.

    Args:
        gait: The gait.
        task: With the true object and what stands around.
    """
    world, pads = CollisionWorld(task), pad_contact_queries(task).names
    for q in _postures(gait):
        (near, *_) = world.closest(gait.T_world_base, q, 1, may_touch=pads)
        if near.distance < -PENETRATION_TOL:
            return Failure(
                kind="use_collision",
                text=f"a posture of the gait is not free where the tool stands: {near}",
                numbers={"distance": near.distance},
            )
        crowded = world.between_fingers(gait.T_world_base, q, LOADED_ROOM)
        if crowded is not None:
            return Failure(
                kind="use_clearance",
                text=f"{crowded} apart in a posture of the gait; fingers that bear the use yield, "
                f"{1e3 * LOADED_ROOM:g} mm are kept",
                numbers={"distance": crowded.distance},
            )
    return None
