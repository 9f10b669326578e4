"""``CollisionWorld``: distances of a hand from all around it and from itself, against MuJoCo."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from planner.collision.world import FAR, OBJECT, TABLE, Clearance, CollisionWorld
from planner.errors import NotFoundError, PlannerError, TaskError
from planner.hands.hand import Hand
from planner.kinematics import HandState
from planner.objects import GraspObject, parse_object
from planner.spatial import SE3, FloatArray, pose_to_wxyz
from planner.task import GraspTask, Obstacle

OBJECTS = ("sphere", "box", "cylinder", "capsule", "ellipsoid")
WALL = Obstacle(
    name="wall",
    size=np.array([0.3, 0.02, 0.25]),
    T_world_obstacle=SE3(pin.exp3(np.array([0.1, 0.2, 0.4])), np.array([0.0, 0.15, 0.1])),
)


def make_task(hand: Hand, item: str | GraspObject, **options: Any) -> GraspTask:
    return GraspTask.create(hand, item, **options)


def random_q(hand: Hand, rng: np.random.Generator) -> FloatArray:
    return rng.uniform(hand.q_lower, hand.q_upper)


def base_with_tip_at(hand: Hand, q: FloatArray, point: FloatArray, rng: np.random.Generator) -> SE3:
    """A base pose (turned at random) that puts a random finger's tip at a point of the world."""
    fingers = list(hand.fingers.values())
    tip = HandState(hand, q).tip_pose(fingers[rng.integers(len(fingers))]).translation
    rotation = pin.exp3(rng.uniform(-1.5, 1.5, 3))
    return SE3(rotation, point - rotation @ tip)


class Twin:
    """The same world in MuJoCo: the hand on a mocap body, everything else fixed in the world."""

    def __init__(self, task: GraspTask) -> None:
        """Assemble it from the task, without the planner's geometry code."""
        spec = mujoco.MjSpec()
        mount = spec.worldbody.add_body(name="mount", mocap=True)
        mount.add_frame().attach_body(task.hand.new_spec().worldbody.first_body(), "hand_", "")
        geom = task.object.shape.mujoco_geom()
        assert geom is not None
        kind, size = geom
        fixed: list[tuple[str, SE3, str, tuple[float, ...]]] = [
            (OBJECT, task.T_world_object, kind, size)
        ]
        if task.table_height is not None:
            top = np.array([*task.T_world_object.translation[:2], task.table_height - 0.05])
            fixed.append((TABLE, SE3(np.eye(3), top), "box", (1.0, 1.0, 0.05)))
        for o in task.obstacles:
            fixed.append((o.name, o.T_world_obstacle, "box", tuple(o.size / 2)))
        for name, pose, kind, size in fixed:
            position, quaternion = pose_to_wxyz(pose)
            spec.worldbody.add_geom(
                name=name,
                type=getattr(mujoco.mjtGeom, f"mjGEOM_{kind.upper()}"),
                size=[*size, 0, 0][:3],
                pos=position,
                quat=quaternion,
            )
        self.model = spec.compile()
        self.model.opt.ccd_tolerance = 1e-9
        self.model.opt.ccd_iterations = 200
        self.data = mujoco.MjData(self.model)
        self.names = {self.model.geom(i).name: i for i in range(self.model.ngeom)}

    def place(self, T_world_base: SE3, q: FloatArray) -> None:
        self.data.mocap_pos[0], self.data.mocap_quat[0] = pose_to_wxyz(T_world_base)
        self.data.qpos[:] = q
        mujoco.mj_kinematics(self.model, self.data)

    def _geom(self, name: str) -> int:
        return self.names[name] if name in self.names else self.names[f"hand_{name}"]

    def distance(self, first: str, second: str) -> float:
        """Distance of two geoms (m) where they are apart; else some number <= 0."""
        ids = [self._geom(name) for name in (first, second)]
        return float(mujoco.mj_geomDistance(self.model, self.data, *ids, 10.0, None))


@pytest.mark.parametrize("item", OBJECTS)
def test_near_pairs_are_as_far_apart_as_in_mujoco_and_far_pairs_at_least_as_said(
    right_hand: Hand, item: str
) -> None:
    task = make_task(right_hand, item, obstacles=(WALL,))
    world, twin = CollisionWorld(task), Twin(task)
    rng = np.random.default_rng(OBJECTS.index(item))
    near = far = 0
    for _ in range(6):
        q = random_q(right_hand, rng)
        spot = task.T_world_object.translation + rng.uniform(-0.06, 0.06, 3)
        T_world_base = base_with_tip_at(right_hand, q, spot, rng)
        twin.place(T_world_base, q)
        for c in world.distances(T_world_base, q):
            theirs = twin.distance(c.first, c.second)
            if c.distance >= FAR:
                far += 1
                assert c.distance <= theirs + 1e-9, c
            elif theirs > 0:
                near += 1
                assert c.distance == pytest.approx(theirs, abs=1e-6), c
            else:
                assert c.distance <= 1e-9, c
    assert near > 50
    assert far > 50


def test_pairs_are_all_but_the_allowed(right_hand: Hand) -> None:
    task = make_task(right_hand, "box", obstacles=(WALL,))
    world = CollisionWorld(task)
    q, T_world_base = right_hand.posture("open"), SE3(np.eye(3), np.array([0, 0, 1.0]))
    pairs = [frozenset((c.first, c.second)) for c in world.distances(T_world_base, q)]
    assert len(set(pairs)) == len(pairs)
    names = [g.name for g in right_hand.geometries]
    expected = {frozenset((a, b)) for a in names for b in names if a != b}
    expected -= right_hand.allowed_pairs
    expected |= {frozenset((a, b)) for a in names for b in (OBJECT, TABLE, "wall")}
    assert set(pairs) == expected
    assert world.surroundings == {OBJECT, TABLE, "wall"}


def test_without_table_and_obstacles_only_the_object_is_around(allegro: Hand) -> None:
    assert CollisionWorld(make_task(allegro, "box", table_height=None)).surroundings == {OBJECT}


def test_a_known_gap_by_hand(allegro: Hand) -> None:
    # The palm is a box of half height 0.0475 m about z = -0.0475: at base height z its bottom is at
    # z - 0.095; the table's top is at 0.
    world = CollisionWorld(make_task(allegro, "sphere", T_world_object=None))
    q = allegro.posture("open")
    for gap in (0.012, 0.001, -0.003):
        T_world_base = SE3(np.eye(3), np.array([0.5, 0.0, 0.095 + gap]))
        distances = {(c.first, c.second): c.distance for c in world.distances(T_world_base, q)}
        assert distances["palm", TABLE] == pytest.approx(gap, abs=1e-6)


def test_a_tip_pressed_into_the_object_is_negative_by_its_depth(right_hand: Hand) -> None:
    # A pad's centre above a sphere's, by the sum of radii less the depth.
    task = make_task(right_hand, "sphere", table_height=None)
    world = CollisionWorld(task)
    q = right_hand.posture("pinch")
    finger = right_hand.fingers["index"]
    state = HandState(right_hand, q)
    reach = finger.pad.radius + 0.035
    for depth in (-0.002, 0.0, 0.001, 0.004):
        # the pad faces down: only its sphere is the nearest part of its geometry
        down = pin.Quaternion.FromTwoVectors(
            state.pad_axis(finger), np.array([0.0, 0.0, -1.0])
        ).toRotationMatrix()
        spot = task.T_world_object.translation + np.array([0, 0, reach - depth])
        T_world_base = SE3(down, spot - down @ state.pad_center(finger))
        found = {(c.first, c.second): c.distance for c in world.distances(T_world_base, q)}
        assert found[finger.pad.geom, OBJECT] == pytest.approx(-depth, abs=2e-6)


def test_the_object_is_where_the_task_says(right_hand: Hand) -> None:
    # World and hand moved together change no distance, except to the table, which stays level.
    turn = SE3(pin.exp3(np.array([0.4, -0.7, 0.2])), np.array([0.3, -0.2, 0.5]))
    q = right_hand.posture("pinch")
    T_world_base = SE3(pin.exp3(np.array([0.1, 0.2, 0.3])), np.array([0.05, 0.0, 0.1]))
    item, pose = parse_object("ellipsoid"), SE3(np.eye(3), np.array([0.0, 0.0, 0.2]))
    still = CollisionWorld(make_task(right_hand, item, table_height=None, T_world_object=pose))
    moved = CollisionWorld(
        make_task(right_hand, item, table_height=None, T_world_object=turn * pose)
    )
    before = [c.distance for c in still.distances(T_world_base, q)]
    after = [c.distance for c in moved.distances(turn * T_world_base, q)]
    np.testing.assert_allclose(before, after, rtol=0, atol=1e-8)


def test_answers_do_not_depend_on_what_was_asked_before(allegro: Hand) -> None:
    task = make_task(allegro, "box")
    world = CollisionWorld(task)
    rng = np.random.default_rng(6)
    poses = []
    for _ in range(4):
        q = random_q(allegro, rng)
        poses.append((base_with_tip_at(allegro, q, task.T_world_object.translation, rng), q))
    first = [world.distances(*p) for p in poses]
    again = [world.distances(*p) for p in reversed(poses)][::-1]
    fresh = [CollisionWorld(task).distances(*p) for p in poses]
    for a, b, c in zip(first, again, fresh, strict=True):
        np.testing.assert_allclose(
            [x.distance for x in a], [x.distance for x in b], rtol=0, atol=1e-9
        )
        np.testing.assert_allclose(
            [x.distance for x in a], [x.distance for x in c], rtol=0, atol=1e-9
        )


def same_nearest(nearest: Clearance, everything: list[Clearance]) -> bool:
    """Whether a pair is the nearest of all; ``distances`` gives only bounds beyond ``FAR``."""
    smallest = min(everything, key=lambda c: c.distance)
    if smallest.distance < FAR:
        return nearest == smallest
    return nearest.distance >= smallest.distance


def test_the_nearest_pair_is_the_smallest_distance(right_hand: Hand) -> None:
    task = make_task(right_hand, "box")
    world = CollisionWorld(task)
    rng = np.random.default_rng(7)
    inner = 0
    for _ in range(15):
        q = random_q(right_hand, rng)
        spot = task.T_world_object.translation + rng.uniform(-0.1, 0.2, 3)
        T_world_base = base_with_tip_at(right_hand, q, spot, rng)
        everything = world.distances(T_world_base, q)
        assert same_nearest(world.nearest(T_world_base, q), everything)
        outer = [c for c in everything if c.second in world.surroundings]
        asked = world.nearest(T_world_base, q, surroundings_only=True)
        assert same_nearest(asked, outer)
        inner += asked != world.nearest(T_world_base, q)
    assert inner  # at least once the hand was nearer to itself


@pytest.mark.parametrize("item", OBJECTS)
def test_the_nearest_pair_is_exact_however_far(right_hand: Hand, item: str) -> None:
    task = make_task(right_hand, item, obstacles=(WALL,))
    world, twin = CollisionWorld(task), Twin(task)
    rng = np.random.default_rng(9)
    for _ in range(3):
        q = random_q(right_hand, rng)
        T_world_base = SE3(pin.exp3(rng.uniform(-1.5, 1.5, 3)), np.array([0.1, -0.3, 0.7]))
        twin.place(T_world_base, q)
        found = world.nearest(T_world_base, q, surroundings_only=True)
        least = min(
            twin.distance(g.name, around)
            for g in right_hand.geometries
            for around in world.surroundings
        )
        assert found.distance > FAR
        assert found.distance == pytest.approx(least, abs=1e-6)


def test_a_configuration_that_is_not_finite_is_never_called_clear(allegro: Hand) -> None:
    world = CollisionWorld(make_task(allegro, "box"))
    q = np.full(allegro.nq, np.nan)
    with pytest.raises(PlannerError, match="NaN"):
        world.nearest(SE3.Identity(), q)


def test_proximity_gives_the_points_between_which_a_distance_lies(right_hand: Hand) -> None:
    # In the world, and for allowed pairs too.
    task = make_task(right_hand, "ellipsoid", obstacles=(WALL,))
    world = CollisionWorld(task)
    rng = np.random.default_rng(8)
    q = random_q(right_hand, rng)
    spot = task.T_world_object.translation + np.array([0.0, 0.08, 0.02])
    T_world_base = base_with_tip_at(right_hand, q, spot, rng)
    to_object = task.T_world_object.inverse()
    for c in world.distances(T_world_base, q):
        near = world.proximity(T_world_base, q, c.first, c.second)
        np.testing.assert_allclose(
            near.point_b - near.point_a, near.distance * near.normal, rtol=0, atol=1e-6
        )
        if c.distance < FAR:
            assert near.distance == pytest.approx(c.distance, abs=1e-9)
        if c.second == OBJECT:
            on_object = to_object.act(near.point_b)
            assert task.object.shape.signed_distance(on_object)[0] == pytest.approx(0, abs=1e-6)
        if c.second == TABLE and near.distance > 0:
            assert near.point_b[2] == pytest.approx(0, abs=1e-6)
    allowed = next(iter(sorted(sorted(pair) for pair in right_hand.allowed_pairs)))
    assert np.isfinite(world.proximity(T_world_base, q, *allowed).distance)


def test_proximity_of_an_unknown_geometry(allegro: Hand) -> None:
    world = CollisionWorld(make_task(allegro, "box"))
    with pytest.raises(NotFoundError, match=r"no geometry is called 'tabel'.*mean 'table'"):
        world.proximity(SE3.Identity(), allegro.posture("open"), "palm", "tabel")


@pytest.mark.parametrize("name", [OBJECT, TABLE, "palm"])
def test_an_obstacle_named_like_something_else_is_refused(allegro: Hand, name: str) -> None:
    # the verdict tells pad contacts from collisions by these names
    wall = Obstacle(name=name, size=WALL.size, T_world_obstacle=WALL.T_world_obstacle)
    with pytest.raises(TaskError, match=rf"called \['{name}'\]; name each obstacle differently"):
        CollisionWorld(make_task(allegro, "box", obstacles=(wall,)))


def test_two_obstacles_of_one_name_are_refused(allegro: Hand) -> None:
    with pytest.raises(TaskError, match=r"called \['wall'\]; name each obstacle differently"):
        CollisionWorld(make_task(allegro, "box", obstacles=(WALL, WALL)))


def test_a_clearance_reads_in_millimetres() -> None:
    assert str(Clearance(first="palm", second="table", distance=-0.00123)) == (
        "palm - table: -1.23 mm"
    )
