"""What a hand on an object of a cloud comes too near to: what was seen, hidden space.

Called by ``planner.search.survival`` of every plan, and by benchmarks of real frames.
"""

from __future__ import annotations

import coal
import numpy as np
from numpy.typing import NDArray

from planner.clouds.belief import Belief
from planner.clouds.cloud import GAP, THING
from planner.kinematics import HandState
from planner.plan import GraspPlan
from planner.shapes.mesh import surface_triangles
from planner.spatial import SE3, FloatArray
from planner.synthesis.link_spheres import link_spheres
from planner.task import GraspTask, Obstacle

SPARE = 0.002
"""Distance (m) from the surface that an opened finger keeps, and depth to which spheres in the
links may be in another hypothesis: they bulge by as much."""

CLEAR = 0.002
"""Distance (m) from every seen point that a hand keeps where it does not touch."""

LEAST_ABOVE, SURE_NOISE = 0.003, 3.0
"""Height (m) above the table, and in deviations of the camera's noise (-), from which on a point is
no longer taken for the table's: a plane found in a cloud is off by a millimetre or two, and of
normal noise one point in 700 lies further out."""

REACH = 0.3
"""Distance (m) from an object beyond which no part of a hand is that grasps it."""

APART, BOX, BOXES = 0.02, 0.06, 5
"""Distance (m) from the object from which on things are boxes, the side (m) of cells in which their
points are put together, and how many boxes there are at most: each costs rows of the problem."""

WAY_STEP = 0.01
"""Distance (m) of the poses at which the way in is looked at: less than a finger is thick."""


def clearance_of_points(plan: GraspPlan, points: FloatArray) -> float:
    """Least distance (m) of the hand from points (n, 3), world, links that touch left out.

    Beyond twice ``CLEAR`` it is only known to be that far.
    """
    hand, state = plan.task.hand, HandState(plan.task.hand, plan.q)
    pads = {finger.pad.joint_id for finger in plan.task.fingers}
    ball, least = coal.Sphere(1e-6), 2.0 * CLEAR
    request = coal.DistanceRequest()
    for link in hand.geometries:
        if link.joint_id in pads:
            continue
        T = plan.T_world_base * state.joint_pose(link.joint_id) * link.T_joint_geometry
        link.geometry.computeLocalAABB()
        local = (points - T.translation) @ T.rotation
        beyond = (
            np.linalg.norm(local - link.geometry.aabb_center, axis=1) - link.geometry.aabb_radius
        )
        for k in np.flatnonzero(beyond < least):
            there = coal.Transform3s(np.eye(3), local[k])
            found = coal.distance(
                link.geometry, coal.Transform3s(), ball, there, request, coal.DistanceResult()
            )
            least = min(least, float(found))
    return least


def seen_nearby(belief: Belief, T_world_object: SE3) -> tuple[FloatArray, FloatArray]:
    """Places of the object (n, 3) and of other things (m, 3), m, world, that were seen nearby.

    The object's as it has moved since; of other things all but the table.
    """
    cloud, turn = belief.cloud, T_world_object.rotation
    own = (cloud.points - belief.offset) @ turn.T + T_world_object.translation
    near = np.linalg.norm(cloud.past - T_world_object.translation, axis=1) < REACH
    others = cloud.past[near]
    if cloud.table is not None:
        least = cloud.table + max(SURE_NOISE * cloud.noise, LEAST_ABOVE)
        own, others = own[own[:, 2] > least], others[others[:, 2] > least]
    return own, others


def things_about(task: GraspTask) -> list[Obstacle]:
    """Boxes about other things that were seen, from which a search keeps away; the nearest ones.

    What is near to the object is left out: its plans are refused afterwards if they meet it.
    """
    belief, pose = task.object.belief, task.T_world_object
    assert belief is not None, "the task is of a cloud"
    others = seen_nearby(belief, pose)[1]
    far = belief.mean((others - pose.translation) @ pose.rotation)
    others, far = others[far > APART], far[far > APART]
    own = surface_triangles(task.object.shape)[0] @ pose.rotation.T + pose.translation
    cells, cell = np.unique(np.floor(others / BOX), axis=0, return_inverse=True)
    boxes = []
    for k in range(len(cells)):
        mine = cell.ravel() == k
        if mine.sum() < THING:
            continue
        lower, upper = others[mine].min(axis=0), others[mine].max(axis=0)
        within = (own > lower - APART / 2.0) & (own < upper + APART / 2.0)
        if not within.all(axis=1).any():
            size = np.maximum(upper - lower, 2.0 * CLEAR)
            place = SE3(np.eye(3), (lower + upper) / 2.0)
            boxes.append((float(far[mine].min()), size, place))
    boxes.sort(key=lambda box: box[0])
    return [
        Obstacle(name=f"_seen_beside_{k}", size=size, T_world_obstacle=place)
        for k, (_, size, place) in enumerate(boxes[:BOXES])
    ]


def _spheres(plan: GraspPlan, q: FloatArray, inner: bool = False) -> tuple[FloatArray, FloatArray]:
    """Centres (n, 3), m, object's frame, and radii (n,), m, of spheres in the links at the grasp.

    Args:
        plan: Where the hand's base is.
        q: Joints (nq,).
        inner: Whether fingertips are left out.
    """
    state = HandState(plan.task.hand, q)
    spheres = [s for s in link_spheres(plan.task.hand) if not inner or not (s.is_pad or s.on_tip)]
    T_object_base: SE3 = plan.task.T_world_object.inverse() * plan.T_world_base
    poses = [T_object_base * state.joint_pose(i) for i in range(len(state.pin_data.oMi))]
    centers = np.array([poses[s.joint_id].act(s.center) for s in spheres])
    return centers, np.array([s.radius for s in spheres])


def _way_in(plan: GraspPlan) -> tuple[FloatArray, FloatArray]:
    """The same of all links on the way in, fingers opened; of an arm's at its end."""
    centers, radii = _spheres(plan, plan.q_pregrasp)
    back = plan.T_world_base_start.translation - plan.T_world_base.translation
    steps = int(np.ceil(np.linalg.norm(back) / WAY_STEP)) + 1
    shifts = np.linspace(0.0, 1.0, steps)[:, None, None] * (
        back @ plan.task.T_world_object.rotation
    )
    return (shifts + centers).reshape(-1, 3), np.tile(radii, steps)


def hits(plan: GraspPlan, belief: Belief) -> NDArray[np.bool_]:
    """Whether the palm or an inner link is in each hypothesis (k,), or any link on the way in."""
    centers, radii = _joined(_spheres(plan, plan.q, inner=True), _way_in(plan))
    means = belief.means(centers)
    # on the chosen one the plan is verified: links are no larger than they are clear of it
    gaps = means - np.minimum(radii, means[belief.chosen])
    return np.asarray(gaps.min(axis=1, initial=np.inf) < -SPARE - belief.grid.spacing)


def clearance_of_others(plan: GraspPlan, belief: Belief, others: FloatArray) -> float:
    """Least distance (m) of any link, at the grasp or on the way in, from points (n, 3), world.

    Those as near to the object as its own may be its edge. It is twice ``CLEAR`` at most.
    """
    from scipy.spatial import cKDTree

    if not len(others):
        return 2.0 * CLEAR
    pose = plan.task.T_world_object
    things = (others - pose.translation) @ pose.rotation
    centers, radii = _joined(_spheres(plan, plan.q), _way_in(plan))
    near = cKDTree(things).query_ball_point(centers, radii + 2.0 * CLEAR)
    things = things[np.unique(np.concatenate(near).astype(np.int64))]
    things = things[belief.mean(things) > GAP]
    if not len(things):
        return 2.0 * CLEAR
    return min(float((cKDTree(things).query(centers)[0] - radii).min()), 2.0 * CLEAR)


def _joined(*spheres: tuple[FloatArray, FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Spheres of several postures."""
    centers, radii = zip(*spheres, strict=True)
    return np.concatenate(centers), np.concatenate(radii)


def hidden_share(plan: GraspPlan, belief: Belief) -> float:
    """Share (-) of the hand's volume, at the grasp, through which no camera saw."""
    centers, radii = _spheres(plan, plan.q)
    pose = plan.task.T_world_object
    behind = belief.sight.behind(centers @ pose.rotation.T + pose.translation)
    return float((radii**3)[behind >= 0.0].sum() / (radii**3).sum())
