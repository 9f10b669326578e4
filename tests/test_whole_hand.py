"""Grasps with inner links and the palm: where they can touch, plans, ways in, trials."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import mujoco
import numpy as np
import pinocchio as pin
import pytest
from test_closing import close

from planner import GraspTask, plan_grasp
from planner.batch.recipe import recipe_of, task_of
from planner.bridge import LinkGeometry
from planner.certify import bound_nearby
from planner.collision.pad_contact import pad_contacts
from planner.collision.pregrasp import Approach, verify_approach
from planner.collision.world import CollisionWorld
from planner.errors import NoGraspFoundError, NotFoundError, TaskError
from planner.files import read_plan
from planner.hand_loading import load_hand
from planner.hands import fingers as link_pads
from planner.hands.fingers import Pad
from planner.hands.grasp_types import contact_sets
from planner.hands.hand import Hand
from planner.kinematics import HandState, moving_hand
from planner.motion.search import check_task
from planner.objects import Region, TouchRegion, parse_object
from planner.plan import GraspPlan
from planner.search.beyond import search_directions
from planner.shapes import Mesh
from planner.spatial import SE3, FloatArray, minimum_jerk
from planner.synthesis.link_spheres import LinkSphere, link_spheres, margin_of
from planner.synthesis.options import SynthesisOptions
from planner.synthesis.problem import Start, build_problem
from planner.synthesis.seeds import seeder_for
from planner.synthesis.seeds.enveloping import EnvelopingSeeder
from planner.task import Obstacle
from planner.tolerances import TOUCH_TOL
from sim import simulate
from sim.controllers.closing import SEARCH_SPEED, GuardedClosing
from sim.scene.build import build_scene

pytestmark = pytest.mark.usefixtures("coarse_steps")

RADIUS = 0.04
"""Of the sphere that is held, m."""


@pytest.fixture(scope="module")
def hand() -> Hand:
    return load_hand("allegro_hand")


@pytest.fixture(scope="module")
def plan(hand: Hand) -> GraspPlan:
    return plan_grasp(GraspTask.create(hand, f"sphere:{RADIUS}", grasp_type="power"), seed=3)


def distance_of(plan: GraspPlan, geom: str, radius: float = RADIUS) -> float:
    """Distance (m) of a capsule's or box's surface from the sphere's, by MuJoCo's kinematics."""
    model = plan.task.hand.mj_model
    data = mujoco.MjData(model)
    data.qpos[:] = plan.q
    mujoco.mj_kinematics(model, data)
    k = model.geom(geom).id
    center = plan.T_world_base.inverse().act(plan.task.T_world_object.translation)
    local = data.geom_xmat[k].reshape(3, 3).T @ (center - data.geom_xpos[k])
    size = model.geom_size[k]
    if model.geom_type[k] == mujoco.mjtGeom.mjGEOM_CAPSULE:
        local[2] -= np.clip(local[2], -size[1], size[1])
        return float(np.linalg.norm(local) - size[0] - radius)
    if model.geom_type[k] == mujoco.mjtGeom.mjGEOM_BOX:
        return float(np.linalg.norm(local - np.clip(local, -size, size)) - radius)
    assert model.geom_type[k] == mujoco.mjtGeom.mjGEOM_SPHERE
    return float(np.linalg.norm(local) - size[0] - radius)


@pytest.mark.parametrize("name", ["allegro_hand", "shadow_hand"])
def test_pads_of_links_lie_on_their_links_and_face_the_palms_side(name: str) -> None:
    hand = load_hand(name)
    state = HandState(hand, hand.neutral)  # fingers straight
    palm = state.T_base_palm.rotation @ hand.palm_normal
    for part in hand.contact_parts.values():
        if not part.is_link or part.name.endswith(".side"):
            continue
        pad = part.pad
        geometry = next(g for g in hand.geometries if g.name == pad.geom)
        local = geometry.T_joint_geometry.actInv(pad.center)
        size = geometry.size
        if geometry.kind == "box":  # as far from one face as its radius, and in the middle of it
            np.testing.assert_allclose(local, 0.0, atol=1e-12)
            assert np.isclose(size, pad.radius).any()
            spans = np.sort(np.append(np.linalg.norm(pad.reach, axis=1), pad.radius))
            np.testing.assert_allclose(spans, np.sort(size))
        elif geometry.kind == "capsule" and len(pad.reach):
            assert pad.radius == size[0]
            np.testing.assert_allclose(np.linalg.norm(pad.reach), size[1])
            np.testing.assert_allclose(pad.reach @ pad.axis, 0.0, atol=1e-12)
        if part.joints and not part.name.startswith(("thumb", "little")):
            assert state.joint_pose(pad.joint_id).rotation @ pad.axis @ palm > 0.3
    assert hand.contact_parts[hand.description.palm_body].joints == ()


def test_links_of_a_hand_without_a_pinch_posture_are_named_and_have_no_flanks(hand: Hand) -> None:
    """Where fingers oppose each other is not known; a name that is none tells the fingers."""
    postures = {k: v for k, v in hand.description.postures.items() if k != "pinch"}
    one = replace(hand, description=hand.description.model_copy(update={"postures": postures}))
    chosen = one.choose_fingers(["thumb", "index_proximal"])
    assert [finger.name for finger in chosen] == ["thumb", "index_proximal"]
    flanks = {name for name in hand.contact_parts if name.endswith(".side")}
    assert flanks and set(one.contact_parts) == set(hand.contact_parts) - flanks
    with pytest.raises(NotFoundError, match=r"(?s)'thum'.*thumb"):
        one.choose_fingers(["thum"])


class Hull:
    """What ``link_pads`` asks of the geometry of a hull."""

    def __init__(self, points: FloatArray) -> None:
        """Keep the corners (n, 3), m."""
        self._points = points

    def points(self) -> FloatArray:
        return self._points


def pad_of_hull(points: FloatArray, facing: list[float], *, of_palm: bool) -> Pad:
    shape: dict[str, Any] = {"name": "hull", "body": "link", "kind": "mesh", "size": np.zeros(3)}
    turn = SE3(pin.exp3(np.array([0.3, -0.2, 0.5])), np.array([0.01, 0.02, 0.03]))
    geometry = LinkGeometry(joint_id=1, T_joint_geometry=turn, geometry=Hull(points), **shape)
    pad = link_pads._pad(geometry, turn.rotation @ np.array(facing), of_palm=of_palm)
    back = turn.inverse()
    axis, reach = back.rotation @ pad.axis, pad.reach @ back.rotation.T
    return replace(pad, center=back.act(pad.center), axis=axis, reach=reach)


def test_the_pad_of_a_hull_is_on_its_front_and_not_on_the_box_around_it() -> None:
    """A frustum that is told to face 17 degrees aside has its flat top, seen along its normal."""
    top, bottom = [0.04, 0.05, 0.01], [0.05, 0.06, -0.01]
    corners = [(sx * x, sy * y, z) for x, y, z in (top, bottom) for sx in (-1, 1) for sy in (-1, 1)]
    pad = pad_of_hull(np.array(corners), [0.3, 0.0, 1.0], of_palm=True)
    np.testing.assert_allclose(pad.axis, [0.0, 0.0, 1.0], atol=1e-9)
    assert (pad.center + pad.radius * pad.axis)[2] == pytest.approx(0.01, abs=1e-9)
    assert len(pad.reach) == 2 and np.abs(pad.reach).max() < 0.05


def test_a_round_hull_touches_along_a_line_with_its_radius() -> None:
    turns = np.linspace(0.0, 2 * np.pi, 48, endpoint=False)
    rim = 0.008 * np.column_stack([np.zeros(48), np.cos(turns), np.sin(turns)])
    end = np.array([0.02, 0.0, 0.0])
    prism = np.vstack([rim - end, rim + end])
    pad = pad_of_hull(prism, [0.0, 0.0, 1.0], of_palm=False)
    assert pad.radius == pytest.approx(0.008, rel=0.15)
    np.testing.assert_allclose(np.abs(pad.reach), [[0.016, 0.0, 0.0]], atol=1e-5)
    np.testing.assert_allclose(pad.axis, [0.0, 0.0, 1.0], atol=0.07)


def test_a_start_assigns_opposed_sides_of_a_box_and_none_on_the_table() -> None:
    """The thumb on one side, all else on those beside it: nothing that presses is balanced."""
    task = GraspTask.create("shadow_hand", "box:0.072x0.061x0.068", grasp_type="power")
    seeder = EnvelopingSeeder(task.choices[1])
    for seed in range(12):
        start = seeder.draw(np.random.default_rng(seed))
        assert isinstance(start, Start)
        normals = np.array([patch.code for patch in start.patches])
        assert (normals @ normals.T).min() == -1.0 and normals[:, 2].min() > -1.0


def test_fingers_of_a_start_flex_above_the_table_and_not_within_it() -> None:
    """Palm down, far from the object; fingers whose links are in the table stay, and that costs."""
    task = GraspTask.create("allegro_hand", "sphere:0.02", grasp_type="power").choices[1]
    seeder, palm = EnvelopingSeeder(task), task.hand.description.palm_body
    part, index = task.hand.contact_parts[palm].pad, task.hand.fingers["index"].q_index
    T_base_palm = HandState(task.hand, seeder.open).joint_pose(part.joint_id)
    turn = pin.Quaternion.FromTwoVectors(part.axis, np.array([0.0, 0.0, -1.0])).matrix()
    flexed, above, cost = [], [], []
    for height in (0.10, 0.06):
        pose = SE3(turn, np.array([0.5, 0.0, height])) * T_base_palm.inverse()
        q = seeder._closed(pose, seeder.open, np.random.default_rng(0))
        flexed.append(np.abs(q - seeder.open)[index].max())
        above.append(seeder._above_table(seeder._links_at(pose, q)).min())
        cost.append(seeder._miss(pose, q))
    assert flexed[0] > 0.5 and flexed[1] == 0.0
    assert above[0] > 0.0 > above[1] and cost[1] > cost[0]


def test_the_distance_from_a_mesh_in_a_start_is_nearly_the_true_one() -> None:
    task = GraspTask.create("allegro_hand", "superquadric", grasp_type="power")
    shape, rng = task.object.shape, np.random.default_rng(0)
    assert isinstance(shape, Mesh)
    points, normals = shape.surface_samples(200, rng)
    away = rng.uniform(0.0, 0.03, 200)
    gaps, outward = EnvelopingSeeder(task)._from_surface(points + away[:, None] * normals)
    assert np.quantile(np.abs(gaps - away), 0.9) < 1e-3
    assert np.median((outward * normals).sum(axis=1)) > 0.99


def test_joints_of_a_link_are_those_that_move_it(hand: Hand) -> None:
    part = hand.contact_parts["index_proximal"]
    assert part.joints == ("index_0", "index_1")
    assert hand.contact_parts["index_distal"].joints == hand.fingers["index"].joints


def test_contacts_touch_by_another_engines_kinematics(plan: GraspPlan) -> None:
    assert not plan.task.is_of_fingertips
    for part in plan.task.fingers:
        assert abs(distance_of(plan, part.pad.geom)) <= TOUCH_TOL


def test_nothing_else_of_the_hand_is_in_the_object(plan: GraspPlan) -> None:
    for geometry in plan.task.hand.geometries:
        assert distance_of(plan, geometry.name) > -TOUCH_TOL


def test_the_way_in_is_free_and_so_is_closing(plan: GraspPlan) -> None:
    """Sampled in MuJoCo: nothing touches on the way but the palm, and that at its end."""
    task = plan.task
    scene = build_scene(task, T_world_base=plan.T_world_base, q=plan.q)
    start, end = plan.T_world_base_start.translation, plan.T_world_base.translation
    way = start + np.linspace(0.0, 0.95, 15)[:, None] * (end - start)
    along = [SE3(plan.T_world_base.rotation, at) for at in way]
    moments = [(plan.q_pregrasp, base) for base in along]
    moments += [
        (plan.q_pregrasp + s * (plan.q - plan.q_pregrasp), plan.T_world_base)
        for s in np.linspace(0.0, 0.9, 10)
    ]
    palm = {scene.model.geom("hand/" + name).id for name in task.carried_geometries}
    for q, base in moments:
        data = scene.start(q, base)
        for contact in data.contact[: data.ncon]:
            pair = set(contact.geom.tolist())
            if pair & set(scene.finger_of_geom) and not pair & palm:
                assert contact.dist > 0.0, [scene.model.geom(g).name for g in pair]


def test_it_is_held_with_the_forces_that_were_planned(plan: GraspPlan) -> None:
    report = simulate(plan)
    assert report.success, report.reason
    pressing = [c for c in report.comparison if c.planned_normal_force > 0.5]
    assert len(pressing) >= 3
    # the palm's friction shares with the fingers' as it likes: the median, not each
    errors = [abs(c.measured_normal_force / c.planned_normal_force - 1.0) for c in pressing]
    assert np.median(errors) < 0.15
    assert all(contact.position_error_mm < 2.0 for contact in pressing)


def test_outermost_contacts_press_and_the_palm_need_not(plan: GraspPlan) -> None:
    task = plan.task
    assert {task.finger_names[i] for i in task.outermost} == {
        f"{f}_distal" for f in ("thumb", "index", "middle", "ring")
    }
    least = dict(zip(task.finger_names, task.least_normals, strict=True))
    assert least["palm"] == 0.0 and least["thumb_distal"] == task.grip_force
    assert (plan.contacts.forces[list(task.outermost), 0] >= task.grip_force - 1e-6).all()


def test_the_palms_force_loads_no_joint_of_a_finger(plan: GraspPlan) -> None:
    """J'f of the other contacts alone is what the actuators give."""
    from planner.verification import force_arguments

    task = plan.task
    given = force_arguments(task, plan.contacts, plan.T_world_base, plan.q)
    palm = task.finger_names.index("palm")
    jacobians: FloatArray = np.asarray(given["jacobians"])
    assert not jacobians[palm].any()
    proximal = task.hand.contact_parts["index_proximal"]
    if "index_proximal" in task.finger_names:
        rows = jacobians[task.finger_names.index("index_proximal")]
        outside = np.setdiff1d(np.arange(task.hand.nq), proximal.q_index)
        assert not rows[:, outside].any()


def test_a_plan_comes_back_from_its_file(plan: GraspPlan, tmp_path: Path) -> None:
    path = tmp_path / "power.json"
    plan.save(path)
    again = read_plan(path)
    assert again.task.finger_names == plan.task.finger_names
    assert (again.q == plan.q).all()


def test_the_text_of_a_task_keeps_its_choices_and_is_the_old_one_without(hand: Hand) -> None:
    power = GraspTask.create("allegro_hand", "sphere", grasp_type="power")
    assert task_of(recipe_of(power)).alternatives == power.alternatives != ()
    assert "alternatives" not in recipe_of(GraspTask.create("allegro_hand", "sphere"))


def test_types_name_contacts(hand: Hand) -> None:
    fingers = ("thumb", "middle", "ring", "index")  # from the thumb on, by nearness
    assert contact_sets(hand, "tripod") == (fingers[:3],)
    assert contact_sets(hand, "pinch") == (fingers[:2],)
    power = contact_sets(hand, "power")
    assert all("palm" in names and "thumb_distal" in names for names in power)
    assert contact_sets(hand, "any")[0] == tuple(f.name for f in hand.choose_fingers())


def test_any_spares_fingers_as_fingertips_do() -> None:
    """Four tips do not fit on an ellipsoid of 19 mm; three do, and no palm reaches it."""
    small = parse_object("ellipsoid:0.0190x0.0294x0.0195", mass=0.04)
    task = GraspTask.create("shadow_hand", small, grasp_type="any")
    assert task.may_spare_fingers and not any(t.may_spare_fingers for t in task.choices[1:])
    plan = plan_grasp(task, seed=5323, max_attempts=60)
    assert len(plan.task.finger_names) == 3


@pytest.mark.parametrize("given", ["fingertip", None])
def test_fingertips_are_the_default(given: str | None) -> None:
    one = GraspTask.create("allegro_hand", "sphere", grasp_type=given)
    assert one.is_of_fingertips and one.may_spare_fingers and not one.alternatives


def test_what_a_type_cannot_be_is_said() -> None:
    with pytest.raises(NotFoundError, match="grasp type"):
        GraspTask.create("allegro_hand", "sphere", grasp_type="claw")
    with pytest.raises(TaskError, match="give one of them"):
        GraspTask.create("allegro_hand", "sphere", grasp_type="power", fingers=["thumb", "index"])
    with pytest.raises(TaskError, match=r"2 finger.*--mu-torsion"):
        GraspTask.create("allegro_hand", "sphere", grasp_type="pinch")
    with pytest.raises(NotFoundError, match="finger of allegro_hand is called"):
        GraspTask.create("allegro_hand", "sphere", fingers=["thumb", "index", "elbow"])


def test_a_hook_holds_a_bar_without_the_thumb(hand: Hand) -> None:
    bar = parse_object("cylinder:0.014x0.12", mass=0.3)
    task = GraspTask.create(hand, bar, grasp_type="hook", table_height=None)
    assert not [name for name in task.all_names if name.startswith("thumb")]
    plan = plan_grasp(task, seed=0)
    report = simulate(plan)
    assert report.success, report.reason


def test_a_hand_without_inner_links_makes_no_hook() -> None:
    with pytest.raises(TaskError, match=r"inner links that can touch, and .* has"):
        GraspTask.create("robosuite:inspire_right", "sphere", grasp_type="hook")
    with pytest.raises(TaskError, match="a hook"):
        GraspTask.create("two_allegro_hands", "sphere:0.1", grasp_type="hook")


@pytest.mark.parametrize("name", ["shadow_hand", "allegro_hand"])
def test_a_flank_looks_across_its_link_to_where_the_thumb_can_press(name: str) -> None:
    hand = load_hand(name)
    parts, data = hand.contact_parts, hand.pin_model.createData()
    flanks = [part for part in parts.values() if part.name.endswith(".side")]
    assert {f.name.split("_")[0] for f in flanks} == set(hand.fingers) - {"thumb"}
    pin.forwardKinematics(hand.pin_model, data, hand.posture("pinch"))
    thumb = hand.fingers["thumb"].pad
    at = data.oMi[thumb.joint_id].act(thumb.center)
    for flank in flanks:
        pad, link = flank.pad, parts[flank.name.removesuffix(".side")].pad
        assert (flank.bodies, pad.geom, pad.center.tolist()) == (
            parts[flank.name.removesuffix(".side")].bodies,
            link.geom,
            link.center.tolist(),
        )
        along = pad.reach[0] / np.linalg.norm(pad.reach[0])
        assert np.abs([pad.axis @ along, pad.axis @ link.axis]).max() < 1e-9
        assert np.linalg.norm(pad.axis) == pytest.approx(1.0)
        assert pad.axis @ (data.oMi[pad.joint_id].actInv(at) - pad.center) > 0.0


def test_a_lateral_grasp_presses_flanks_and_the_tip_of_the_thumb() -> None:
    hand = load_hand("shadow_hand")
    task = GraspTask.create(hand, "box:0.06x0.02x0.06", grasp_type="lateral", table_height=None)
    plan = plan_grasp(task, seed=0)
    thumb, *flanks = plan.task.finger_names
    assert thumb == "thumb" and all(f.startswith("index_") and f.endswith(".side") for f in flanks)
    # the kinematics of MuJoCo: contacts lie on the capsules, beside and not before them
    model = hand.mj_model
    data = mujoco.MjData(model)
    data.qpos[:] = plan.q
    mujoco.mj_kinematics(model, data)
    palm = data.body(hand.description.palm_body)
    looks = palm.xmat.reshape(3, 3) @ hand.palm_normal
    for k, name in enumerate(flanks, start=1):
        geom = data.geom(name.removesuffix(".side"))
        radius, half = model.geom(name.removesuffix(".side")).size[:2]
        at = plan.T_world_base.actInv(plan.contacts[k].position) - geom.xpos
        line = geom.xmat.reshape(3, 3)[:, 2]
        out = at - np.clip(at @ line, -half, half) * line
        assert np.linalg.norm(out) == pytest.approx(radius, abs=6e-4)
        assert np.degrees(np.arccos(abs(out @ looks) / np.linalg.norm(out))) > 15.0
    report = simulate(plan)
    assert report.success, report.reason


def test_who_makes_no_lateral_grasp_is_told() -> None:
    with pytest.raises(TaskError, match="flanks of two links"):
        GraspTask.create("robosuite:inspire_right", "sphere", grasp_type="lateral")
    with pytest.raises(TaskError, match="a lateral grasp"):
        GraspTask.create("two_allegro_hands", "sphere:0.1", grasp_type="lateral")


def test_links_by_name_are_a_grasp_too(hand: Hand) -> None:
    names = ["thumb", "index", "middle", "ring", "palm"]
    try:
        plan = plan_grasp(GraspTask.create(hand, "sphere:0.035", fingers=names), seed=1)
    except NoGraspFoundError as error:
        pytest.fail(str(error))
    assert plan.task.finger_names == tuple(names)
    assert abs(distance_of(plan, "palm", 0.035)) <= TOUCH_TOL


def test_what_is_known_of_fingertips_alone_is_not_claimed_of_links(plan: GraspPlan) -> None:
    bound = bound_nearby(plan, np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0]))
    assert bound.factor == np.inf and "links" in bound.reason
    with pytest.raises(TaskError, match="takes fingertips alone, and thumb_distal"):
        simulate(plan, error_model="lab")
    with pytest.raises(TaskError, match="the closed loop takes fingertips alone"):
        simulate(plan, controller="impedance")
    with pytest.raises(TaskError, match="a motion takes fingertips alone"):
        check_task(plan.task, 1e-4, 0)


def test_the_gap_of_a_palm_is_that_of_its_contact(plan: GraspPlan) -> None:
    at = plan.task.finger_names.index("palm")
    palm = pad_contacts(plan.task, plan.T_world_base, plan.q)[at]
    outward = plan.task.T_world_object.rotation @ palm.outward
    back = SE3(plan.T_world_base.rotation, plan.T_world_base.translation + 0.002 * outward)
    away = pad_contacts(plan.task, back, plan.q)[at]
    assert palm.pad_gap == palm.sphere_gap
    assert away.pad_gap == pytest.approx(palm.pad_gap + 0.002, abs=2e-4)


def test_a_palm_on_a_fixed_base_is_refused() -> None:
    task = GraspTask.create("allegro_on_arm7", "cylinder:0.03x0.14", grasp_type="power")
    with pytest.raises(TaskError, match="no way in is planned"):
        plan_grasp(task)


@pytest.mark.parametrize("name", ["allegro_hand", "shadow_hand"])
def test_an_inner_link_of_the_thumb_comes_first_in_power_grasps(name: str) -> None:
    """Half of the turns and the first; of type any each set has one turn, fingertips the first."""
    hand = load_hand(name)
    power, free = contact_sets(hand, "power"), contact_sets(hand, "any")
    around = [{"thumb_proximal", "thumb_distal", "palm"} <= set(names) for names in power]
    assert around == [True, True, True, False, True, False]
    assert len(power[-1]) == 4 and free[1:] == tuple(dict.fromkeys(power))
    assert free[:1] == contact_sets(hand, "fingertip")


def test_the_grip_is_shared_by_what_presses(hand: Hand) -> None:
    """Of two kilogrammes: of six contacts four press, each as hard as one of four fingertips."""
    item = parse_object("sphere:0.04", mass=2.0)
    power = GraspTask.create(hand, item, grasp_type="power")
    assert [len(task.outermost) for task in power.choices] == [4, 4, 4, 4, 4, 3]
    assert power.grip_force == pytest.approx(2.0 * 2.0 * 9.81 / (0.5 * 4))
    assert power.grip_force == GraspTask.create(hand, item).grip_force
    assert power.choices[-1].grip_force == pytest.approx(2.0 * 2.0 * 9.81 / (0.5 * 3))


def test_a_weak_hand_shares_the_load_with_its_palm(hand: Hand) -> None:
    """Half the default grip of 2 kg, after two attempts; a grip that is given stays."""
    item = parse_object(f"sphere:{RADIUS}", mass=2.0)
    task = GraspTask.create(hand, item, grasp_type="power")
    assert task.sharing_palm is not None and task.sharing_palm.sharing_palm is None
    assert GraspTask.create(hand, item).sharing_palm is None  # no palm
    strict = replace(task, grip_force=task.grip_force + 1e-6)
    assert strict.sharing_palm is None
    plan = plan_grasp(task, seed=0)
    assert plan.record.attempts > 2
    assert plan.task.grip_force == pytest.approx(2.0 * 2.0 * 9.81 / (0.5 * 2 * 4))
    report = simulate(plan)
    assert report.success, report.reason
    with pytest.raises(NoGraspFoundError):
        plan_grasp(strict, seed=0, max_attempts=plan.record.attempts)


SERVO, RANGE = 0.8, 1.2
"""Torque per error (N m/rad) and range of commands (rad) of the servos below."""

SPRING, BENT = 0.05, 0.02
"""Stiffness (N m/rad) of springs in the joints there, and their torque (N m) at zero."""


@pytest.mark.parametrize("gravity", [0.0, -3.7, -9.81])
def test_the_room_of_actuators_is_that_of_their_laws_beside_pinocchios_torques(
    gravity: float,
) -> None:
    """Servos whose force ends with their range; fingers bear contacts, the wrist all the weight."""
    hand = load_hand("shadow_hand")
    a, n = hand.actuation, len(hand.actuation.names)
    bias = np.tile([0.0, -SERVO, 0.0], (n, 1))
    ends = np.tile([-RANGE, RANGE], (n, 1))
    springs, bent = a.stiffness + SPRING * np.eye(hand.nq), np.full(hand.nq, BENT)
    sprung = replace(a, stiffness=springs, spring_torque=bent)
    servos = replace(sprung, gain=np.full(n, SERVO), bias=bias, ctrl_range=ends)
    hand = replace(hand, actuation=servos)
    item, down = parse_object("sphere:0.03", mass=1.0), np.array([0.0, 0.0, gravity])
    task = GraspTask.create(hand, item, gravity=down, table_height=None, grasp_type="power")
    problem = build_problem(hand, task.fingers, task.object.shape)
    start = EnvelopingSeeder(task).draw(np.random.default_rng(4))
    assert isinstance(start, Start)
    x = problem.first(start)
    p = problem.parameters(task, start, start.q, SynthesisOptions())
    f = problem.formulation
    (term,) = [t for t in problem.terms if t.term.name == "effort"]
    room = np.array(ca.Function("r", [f.x, f.p], [term.expression])(x, p)).ravel()
    unit = float(ca.Function("u", [f.x, f.p], [f.symbols.newtons])(x, p))
    centers = ca.Function("c", [f.x, f.p], f.symbols.centers)(x, p)
    outward = ca.Function("n", [f.x, f.p], f.symbols.outward)(x, p)
    forces = unit * start.forces
    pressed = [-forces[i] @ np.array(outward[i]).ravel() for i in task.outermost]
    assert min(pressed) == pytest.approx(task.grip_force)
    state, turn = HandState(hand, start.q), start.T_object_base.rotation
    tau = np.zeros(hand.nq)
    for finger, center, normal, force in zip(task.fingers, centers, outward, forces, strict=True):
        point = np.array(center).ravel() - finger.pad.radius * turn.T @ np.array(normal).ravel()
        rates = state.point_jacobian(finger.pad.joint_id, point)[:3]
        tau[finger.q_index] += rates[:, finger.q_index].T @ (turn.T @ force)
    down = turn.T @ task.T_world_object.rotation.T @ task.gravity
    wrist = hand.wrist_index
    palm = hand.contact_parts["palm"].pad.joint_id
    held = state.point_jacobian(palm, start.T_object_base.inverse().translation)[:3]
    tau[wrist] = (state.gravity_torque(down) - task.object.mass * down @ held)[wrist]
    tau -= servos.passive_torque(start.q)
    low, high = servos.torque_limits(start.q).T
    coupled = np.flatnonzero(np.any([c.row for c in hand.couplings], axis=0))
    moved = {int(j) for finger in task.fingers for j in finger.q_index}
    alone = sorted((moved | set(wrist.tolist())) - set(coupled.tolist()))
    assert len(alone) > 10
    for j in alone:
        for expected in (high[j] - tau[j], tau[j] - low[j]):
            off = np.abs(room - expected / (0.05 * unit)).min()
            assert off < 1e-6, (servos.joint_names[j], off)
    tips = build_problem(hand, hand.choose_fingers(), task.object.shape)
    assert "effort" not in {t.term.name for t in tips.terms}


def test_forces_around_an_object_bear_its_weight_and_those_of_tips_cancel(hand: Hand) -> None:
    item = parse_object("sphere:0.03", mass=1.0)
    for grasp_type, borne in (("power", True), ("fingertip", False)):
        task = GraspTask.create(hand, item, table_height=None, grasp_type=grasp_type)
        problem = build_problem(hand, task.fingers, item.shape)
        (term,) = [t for t in problem.terms if t.term.name == "balance"]
        f = problem.formulation
        start = seeder_for(task).draw(np.random.default_rng(0))
        assert isinstance(start, Start)
        p = problem.parameters(task, start, start.q, SynthesisOptions())
        row = np.array(ca.Function("b", [f.x, f.p], [term.expression])(problem.first(start), p))
        weight = task.T_world_object.rotation.T @ task.gravity
        unit = float(ca.Function("u", [f.x, f.p], [f.symbols.newtons])(problem.first(start), p))
        expected = start.forces.sum(axis=0) + borne * weight / unit
        assert row.ravel()[:3] == pytest.approx(expected)


def test_a_wrist_that_cannot_hold_the_object_is_turned_another_way() -> None:
    """A palm that looks sideways has a long lever to the wrist's joints, one above it has none."""
    hand = load_hand("shadow_hand")

    def seeder(mass: float) -> EnvelopingSeeder:
        item = parse_object("sphere:0.03", mass=mass)
        task = GraspTask.create(hand, item, table_height=None, grasp_type="power")
        return EnvelopingSeeder(task)

    drawn = [seeder(1.0)._drawn_hand(np.random.default_rng(i)) for i in range(12)]
    assert all(seeder(1.0)._wrist_bears(*one) for one in drawn)
    heavy = [seeder(8.0)._wrist_bears(*one) for one in drawn]
    assert 0 < sum(heavy) < len(heavy)
    better = [seeder(8.0)._drawn_hand(np.random.default_rng(i)) for i in range(12)]
    assert sum(seeder(8.0)._wrist_bears(*one) for one in better) > sum(heavy)


WEAK = 0.15
"""Share of their force (-) that motors have left below."""


def test_what_a_wrist_bears_is_what_its_motors_give_by_mujoco() -> None:
    """Of hand and object together, by motors that hardly hold the hand alone.

    Where the object would lift the hand instead, several answers are others.
    """
    hand = load_hand("shadow_hand")
    weak = replace(hand.actuation, force_range=WEAK * hand.actuation.force_range)
    hand = replace(hand, actuation=weak)
    model, wrist = copy(hand.mj_model), hand.wrist_index
    data, differ = mujoco.MjData(model), 0
    palm = model.body(hand.description.palm_body).id
    for seed in range(60):
        mass = 0.2 + 0.02 * seed
        item = parse_object("sphere:0.03", mass=mass)
        task = GraspTask.create(hand, item, table_height=None, grasp_type="power")
        seeder = EnvelopingSeeder(task)
        rng = np.random.default_rng(seed)
        q = seeder._with_noise(seeder.open, rng)
        in_base = SE3(moving_hand(hand).move(q).joint_pose(seeder._palms[0].pad.joint_id))
        T_object_base = seeder._palm_pose(rng) * in_base.inverse()
        down = T_object_base.rotation.T @ task.T_world_object.rotation.T @ task.gravity
        model.opt.gravity[:], data.qpos[:] = down, q
        mujoco.mj_forward(model, data)
        rates = np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, rates, None, T_object_base.inverse().translation, palm)
        low, high = hand.actuation.torque_limits(q)[wrist].T
        own, held = data.qfrc_bias[wrist], (mass * down @ rates)[wrist]
        borne, apart = (
            bool(((torque >= low) & (torque <= high)).all()) for torque in (own - held, own + held)
        )
        assert seeder._wrist_bears(T_object_base, q) == borne
        differ += borne != apart
    assert differ > 2, differ


def test_a_hull_beside_a_touching_pad_keeps_the_clearance_of_links(hand: Hand) -> None:
    """Spheres fill a hull by half a millimetre less than it is; boxes and capsules they fill."""
    link = hand.contact_parts["index_distal"]
    sphere = LinkSphere(
        geometry="other",
        finger="index",
        joint_id=link.pad.joint_id,
        center=np.zeros(3),
        radius=0.01,
        is_pad=False,
        on_tip=True,
        in_hull=False,
    )
    hull = replace(sphere, in_hull=True)
    assert margin_of(sphere, [link]) == "clear_tip"
    assert margin_of(hull, [link]) == "clear_object"
    assert margin_of(replace(hull, finger=""), [link]) == "clear_tip"
    assert margin_of(replace(sphere, geometry=link.pad.geom), [link]) is None


def test_a_set_that_a_region_forbids_is_left_out(hand: Hand) -> None:
    everywhere = Region(name="all", lower=(-np.inf,) * 3, upper=(np.inf,) * 3)
    item = replace(parse_object("sphere:0.035"), touch=TouchRegion(required={"index": everywhere}))
    task = GraspTask.create(hand, item, grasp_type="any")
    assert [choice.finger_names for choice in task.choices] == [task.finger_names]


def test_what_a_reach_takes_up_is_no_offset(hand: Hand) -> None:
    """A pad that reaches 10 mm along x of its joint, which is y of the axes that are asked in."""
    pad = replace(hand.contact_parts["index_middle"].pad, reach=np.array([[0.01, 0.0, 0.0]]))
    turn = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    off = np.array([0.001, 0.015, -0.002])
    np.testing.assert_allclose(pad.beyond_reach(off, turn), [0.001, 0.005, -0.002], atol=1e-12)
    np.testing.assert_allclose(pad.beyond_reach(-off, turn, 2.0), [-0.001, 0.0, 0.002], atol=1e-12)


def test_the_last_two_millimetres_of_a_way_in_are_looked_at(plan: GraspPlan) -> None:
    """A wall half a millimetre before the foremost link where the way ends, far from it before."""
    task, base = plan.task, plan.T_world_base
    way = base.translation - plan.T_world_base_start.translation
    along = way / np.linalg.norm(way)
    state = HandState(task.hand, plan.q_pregrasp)
    spheres = link_spheres(task.hand)
    at = np.array([base.act(state.joint_pose(b.joint_id).act(b.center)) for b in spheres])
    reached = at @ along + np.array([b.radius for b in spheres])
    foremost = int(np.argmax(reached))
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), along).matrix()
    tip = at[foremost] + spheres[foremost].radius * along
    wall = Obstacle(
        name="wall",
        size=np.array([0.01, 0.01, 0.002]),
        T_world_obstacle=SE3(turn, tip + (5e-4 + 0.001) * along),
    )
    approach = Approach(
        q=plan.q_pregrasp,
        pregrasp_distance=plan.pregrasp_distance,
        T_world_base_start=plan.T_world_base_start,
    )
    assert verify_approach(CollisionWorld(task), base, plan.q, approach) is None
    walled = replace(task, obstacles=(wall,))
    failure = verify_approach(CollisionWorld(walled), base, plan.q, approach)
    assert failure is not None and failure.kind == "approach_collision"


@pytest.fixture(scope="module")
def inner(hand: Hand) -> GraspPlan:
    """A grasp in which two links of one finger touch."""
    names = [f"{f}_distal" for f in ("thumb", "index", "middle", "ring")]
    names += ["index_proximal", "middle_proximal", "palm"]
    return plan_grasp(GraspTask.create(hand, "sphere:0.045", fingers=names), seed=0)


@pytest.mark.parametrize("touching", ["index_proximal", "index_distal"])
def test_a_link_that_touches_stops_its_joints_and_no_others(
    inner: GraspPlan, touching: str
) -> None:
    """Where a finger's inner link touches, its tip goes on; where the tip does, the link does."""
    closing, task = GuardedClosing(inner), inner.task
    close(closing, inner, range(200))
    which = task.finger_names.index(touching)
    reference = close(closing, inner, range(200, 251), touching=(which,), q=inner.q)[-1]
    share = float(minimum_jerk(np.asarray(199 / 250)))
    stopped = inner.q_pregrasp + share * (inner.q - inner.q_pregrasp)
    link = task.hand.contact_parts["index_proximal"].q_index
    rest = np.setdiff1d(task.hand.fingers["index"].q_index, link)
    on, off = (rest, link) if touching == "index_proximal" else (link, rest)
    np.testing.assert_allclose(reference[off], stopped[off], atol=1e-12)
    np.testing.assert_allclose(reference[on], inner.q[on], atol=1e-12)
    assert np.abs(inner.q - stopped)[np.r_[on, off]].max() > 1e-3


def test_an_inner_link_that_finds_nothing_stays_and_a_tip_looks_for_the_object(
    inner: GraspPlan,
) -> None:
    """Both links of the index finger have arrived without touching: only the tip searches on."""
    closing, task = GuardedClosing(inner), inner.task
    tip = task.finger_names.index("index_distal")
    others = {"index_proximal", "index_distal", "palm"}
    touching = tuple(i for i, name in enumerate(task.finger_names) if name not in others)
    close(closing, inner, range(251))
    reference = close(closing, inner, range(250, 400), touching=touching, q=inner.q)[-1]
    gone = reference - inner.q
    far = 150 * 0.002 * SEARCH_SPEED  # steps of 2 ms
    way = search_directions(inner)[tip]
    np.testing.assert_allclose(gone[way.index], far * way.straight, atol=1e-3 * far)
    np.testing.assert_allclose(np.delete(gone, way.index), 0.0, atol=1e-12)
