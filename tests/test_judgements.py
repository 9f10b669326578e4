"""Small judgements that files, reports and models rest on: just within and just beyond each."""

from __future__ import annotations

import os
import stat
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import coal
import mujoco
import numpy as np
import pinocchio as pin
import pytest
import trimesh

from planner.bridge.geometry import LinkSurface
from planner.bridge.numbers import _principal
from planner.bridge.object_body import GROWN, _grown
from planner.bridge.structure import structure_of
from planner.clouds.files import _columns, _matrix
from planner.contacts.friction import ExpectedLoad
from planner.describe.fingertips import ConvexLink
from planner.describe.overlaps import HandGaps
from planner.describe.pads import _tangent_ball
from planner.errors import ObjectError
from planner.failure import Failure
from planner.files.disk import Journal
from planner.files.plans import _agree, _balance
from planner.forces.solve import ForceSolution
from planner.hand_loading import load_hand
from planner.hands.catalog import joined_names
from planner.hands.hand import Hand
from planner.hands.two_hands import _at_rest, _facing
from planner.joints.actuation import _disjoint_basis
from planner.kinematics import HandState
from planner.pages.scene import MUJOCO_GREY, PLAIN_COLOUR, TIP_COLOUR, Model, Part, _visual
from planner.quality.weakest import _distinct, distinct_faces
from planner.search import from_cloud
from planner.shapes.convex_pairs import DistancePair
from planner.spatial import SE3, FloatArray, pose_from_wxyz, pose_to_wxyz
from planner.system.disk_cache import _is_closed
from planner.task import GRIP_SAFETY, MIN_GRIP, _default_grip
from sim.contacts import reading
from sim.contacts.history import _elliptic_forces
from sim.creep import HIGHEST_IMPEDANCE, _needed_impedance
from sim.crosscheck.causes import MjcfText
from sim.crosscheck.compare import _inertia, _relative
from sim.crosscheck.parts import Difference, LinkInertia, Tally, Tolerances
from sim.crosscheck.report import Cell, Column, CrosscheckReport
from sim.datasets.episodes.episode import _command_unit
from sim.learning.controller import Demonstrator
from sim.manipulation.report import ManipulationReport
from sim.real_hand import ReplayedHand, loop
from sim.real_hand.safety import Stopped
from sim.recorder import StateRecorder
from sim.scene.physics import PhysicsOptions
from sim.show.dataset import MOST_TRIANGLES, _light


@pytest.mark.parametrize(
    ("mine", "theirs", "error"),
    [
        ([1.0, -2.0], [1.0, -2.0], 0.0),
        ([1.0, -2.0], [1.0, -1.0], 0.5),  # by the reference's largest
        ([0.0], [3.0], 1.0),  # by the other's, where the reference has none
        ([-np.inf, 1.0], [-1e16, 1.0], 0.0),  # as good as infinite
        ([-np.inf, 1.0], [np.inf, 1.0], np.inf),
        ([-np.inf, 2.0], [-np.inf, 1.0], 0.5),
    ],
)
def test_values_differ_by_a_share_of_the_references(
    mine: list[float], theirs: list[float], error: float
) -> None:
    tally = Tally(tolerances=Tolerances())
    _relative(tally, "mass", "palm", np.array(mine), np.array(theirs))
    assert tally.worst["mass"][0] == error
    assert (("mass", "palm") in tally.differences) == (error > 0)


def test_inertias_differ_by_mass_by_centre_and_by_tensor() -> None:
    def link(mass: float, center: float, inertia: float) -> LinkInertia:
        return LinkInertia(
            mass=mass, center=np.array([center, 0, 0]), inertia=np.diag([4.0, 4.0, inertia])
        )

    def told(theirs: LinkInertia | None) -> dict[str, float]:
        tally = Tally(tolerances=Tolerances())
        _inertia(tally, "palm", link(2.0, 0.1, 4.0), theirs)
        return {quantity: worst for quantity, (worst, _, _) in tally.worst.items()}

    assert told(link(1.0, 0.13, 3.0)) == pytest.approx(
        {"mass": 0.5, "link centre": 0.03, "inertia": 0.25}
    )
    assert told(None) == {"mass": 1.0}


def test_only_judged_sides_have_faults_and_consequences_are_none_of_a_part() -> None:
    def difference(quantity: str, **of: Any) -> Difference:
        return Difference(quantity=quantity, part="palm", error=1.0, tolerance=0.1, **of)

    def cell(quantity: str, verdict: str) -> Cell:
        about: dict[str, Any] = {"error": 0.0, "where": "", "state": -1, "compared": 1}
        return Cell(quantity=quantity, verdict=verdict, tolerance=0.1, **about)

    mass, known = difference("mass"), difference("inertia", cause="axes", reason="turned axes")
    wrong = Column(
        name="urdf",
        cells=(cell("mass", "differs"), cell("inertia", "reported"), cell("timestep", "agrees")),
        differences=(mass, known),
        notes=("no tendons",),
    )
    aside = Column(name="aside", cells=wrong.cells, differences=(mass,), judged=False)
    sound = Column(name="sound", cells=(cell("mass", "agrees"),), differences=())
    broken = Column(name="broken", cells=(), differences=(), failure="not read")
    assert [c.ok for c in (wrong, aside, sound, broken)] == [False, False, True, False]
    assert wrong.faults == (mass, known)
    assert wrong.unexplained == (mass,)
    assert wrong.causes == {"axes": "turned axes"}

    def report(*columns: Column) -> CrosscheckReport:
        return CrosscheckReport(
            model="m",
            reference="r",
            columns=columns,
            seed=1,
            n_configurations=2,
            tolerances=Tolerances(),
        )

    assert report(wrong, aside).faults == (str(mass), str(known))
    assert report(aside, sound).faults == ()
    assert report(aside, sound).ok and not report(wrong, sound).ok
    text = str(report(wrong, aside, broken))
    assert "urdf: 1 of 3 quantities differ: mass" in text
    assert "aside (not judged): 1 of 3 quantities differ" in text
    assert "broken: not read" in text and "no tendons" in text
    assert "sound: 1 quantities agree" in str(report(sound))


@pytest.mark.parametrize("least", [500, 501, 777, round(1000 * HIGHEST_IMPEDANCE)])
def test_the_least_impedance_that_creeps_little_enough_is_found(least: int) -> None:
    def creep(physics: PhysicsOptions) -> float:
        assert physics.solimp[0] == physics.solimp[1]
        return 1.0 if 1000 * physics.solimp[0] < least - 1e-6 else 0.1

    physics = PhysicsOptions()
    assert _needed_impedance(physics, creep, 0.5) == pytest.approx(least / 1000)
    assert _needed_impedance(physics, lambda _: 1.0, 0.5) is None


@pytest.mark.parametrize(
    ("claimed", "true", "same"),
    [
        (1.0005, 1.0, True),
        (1.002, 1.0, False),
        (5e-7, 0.0, True),
        (1, 1.0, True),
        (True, True, True),
        (1, True, False),
        (None, None, True),
        (None, 0.0, False),
        ([1], [1], True),
        ([1], [2], False),
        ("1", 1.0, False),
    ],
)
def test_claimed_figures_agree_but_for_rounding(claimed: Any, true: Any, same: bool) -> None:
    assert _agree(claimed, true) == same


def test_weights_prove_closure_if_they_sum_to_one_and_balance() -> None:
    wrenches = np.array([[1.0, -1.0, 0.0], [0.0, 0.0, 0.0]])
    closure = {"weights": [0.4, 0.4, 0.2], "min_weight": 0.2}
    assert _balance([0.4, 0.4, 0.2], closure, wrenches)
    assert not _balance([0.4, 0.4, 0.4], closure, wrenches)  # sum
    assert not _balance([0.5, 0.3, 0.2], closure, wrenches)  # resultant
    assert not _balance([0.45, 0.45, 0.1], closure, wrenches)  # least
    assert not _balance([0.5, 0.5], closure, wrenches)
    none = {"weights": None, "min_weight": None}
    assert _balance(None, none, wrenches) and not _balance([0.4, 0.4, 0.2], none, wrenches)


def test_poses_of_views_are_rigid_and_columns_three_or_six() -> None:
    pose = np.eye(4)
    pose[:3, :3] = pin.exp3(np.array([0.1, 0.2, 0.3]))
    pose[:3, 3] = 1.0, 2.0, 3.0
    np.testing.assert_array_equal(_matrix("f", "pose", pose.tolist(), 4), pose)
    np.testing.assert_array_equal(_matrix("f", "k", (2 * np.eye(3)).tolist(), 3), 2 * np.eye(3))
    mirrored, moved = pose.copy(), pose.copy()
    mirrored[:3, 0] *= -1
    moved[3, 0] = 0.1
    faulty: list[Any] = [mirrored, moved, 2 * pose, np.eye(3), np.full((4, 4), np.nan), "x", None]
    for given in faulty:
        with pytest.raises(ObjectError, match="pose"):
            _matrix("f", "pose", given.tolist() if isinstance(given, np.ndarray) else given, 4)
    rows = np.arange(12.0).reshape(2, 6)
    both = _columns(Path("a.npy"), rows)
    np.testing.assert_array_equal(both["points"], rows[:, :3])
    np.testing.assert_array_equal(both["normals"], rows[:, 3:])
    assert _columns(Path("a.npy"), rows[:, :3])["normals"] is None
    for wrong in (rows[:, :4], rows[0]):
        with pytest.raises(ObjectError, match="shape"):
            _columns(Path("a.npy"), wrong)


def test_commands_have_the_unit_of_their_law(allegro: Hand) -> None:
    torque = load_hand("shadow_hand_torque")
    for hand, turning, sliding in ((allegro, "rad", "m"), (torque, "N m", "N")):
        fingers = range(2, 4)
        assert {_command_unit(hand, i, [False] * hand.nq) for i in fingers} == {turning}
        assert {_command_unit(hand, i, [True] * hand.nq) for i in fingers} == {sliding}


@pytest.mark.parametrize("name", ["allegro_hand", "shadow_hand"])
def test_a_palm_of_a_pair_faces_where_it_is_told_with_its_fingers_up(name: str) -> None:
    hand = load_hand(name)
    direction = np.array([0.6, -0.8, 0.0])
    wxyz = _facing(hand, direction)
    turn = pose_from_wxyz(np.zeros(3), np.array(wxyz)).rotation
    state = HandState(hand, hand.neutral)
    data = hand.pin_model.createData()
    pin.framesForwardKinematics(hand.pin_model, data, hand.neutral)
    palm = data.oMf[hand.palm_frame_id]
    np.testing.assert_allclose(turn @ palm.rotation @ hand.palm_normal, direction, atol=1e-6)
    middle = hand.fingers["middle"]
    up = turn @ (state.pad_center(middle) - palm.translation)
    assert up[2] > 0.95 * np.linalg.norm(up[1:])
    held: Any = SimpleNamespace(quaternion_wxyz=wxyz, position=(0.1, 0.2, 0.3))
    rest, base = _at_rest(held, hand)
    there = rest * base  # pose of the base in the pair
    placed = there * SE3(palm.rotation, palm.translation)
    np.testing.assert_allclose(placed.translation, [0.1, 0.2, 0.3], atol=1e-9)
    np.testing.assert_allclose(there.rotation, turn, atol=1e-9)
    np.testing.assert_allclose(rest.rotation[:, 0], direction, atol=1e-6)
    assert np.linalg.det(rest.rotation) == pytest.approx(1.0)


def test_distances_from_a_handle_are_those_of_coal_and_of_what_may_not_touch(
    allegro: Hand,
) -> None:
    """Exact where near, else no more than that; none from what may touch."""
    gaps, data = HandGaps(allegro, near=0.02), allegro.pin_model.createData()
    pin.forwardKinematics(allegro.pin_model, data, allegro.posture("pinch"))
    middle, along = np.array([0.06, 0.01, 0.03]), np.array([0.0, 0.6, 0.8])
    free = {allegro.geometries[0].joint_id}
    found = gaps.from_handle(data.oMi, free, middle, along, 0.05, 0.01)
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), along).toRotationMatrix()
    handle, near = coal.Capsule(0.01, 0.1), 0
    for g, distance in zip(allegro.geometries, found, strict=True):
        if g.joint_id in free:
            assert distance == np.inf
            continue
        placed = SE3(data.oMi[g.joint_id]) * g.T_joint_geometry
        true = DistancePair(handle, g.geometry).distance(SE3(turn, middle), placed)
        if distance <= 0.02:
            assert distance == pytest.approx(true, abs=1e-6)
            near += true <= 0.02
        else:
            assert true >= distance - 1e-9
    assert near >= 1


def test_the_largest_ball_in_a_box_that_touches_a_face_is_half_its_thickness() -> None:
    geometry: Any = SimpleNamespace(
        name="box",
        kind="box",
        body="b",
        size=(0.01, 0.02, 0.03),
        T_joint_geometry=SE3(np.eye(3), np.array([0.1, 0.0, 0.0])),
    )
    solid = ConvexLink(geometry)
    for point, normal, radius in (
        ([0.11, 0.0, 0.0], [1.0, 0.0, 0.0], 0.01),
        ([0.1, 0.02, 0.0], [0.0, 1.0, 0.0], 0.01),  # the sides are nearer than the far face
        ([0.11, 0.015, 0.0], [1.0, 0.0, 0.0], 0.005),
    ):
        found = _tangent_ball(solid, np.array(point), np.array(normal))
        assert found == pytest.approx(radius, abs=3e-4)


def test_a_part_grows_by_as_much_at_its_farthest_corner() -> None:
    corners = np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.4]])
    moved = _grown(corners) - corners
    away = corners - corners.mean(axis=0)
    sizes = np.linalg.norm(moved, axis=1)
    assert sizes.max() == pytest.approx(GROWN) == pytest.approx(sizes[3])
    np.testing.assert_allclose(np.cross(moved, away), 0.0, atol=1e-12)
    assert ((moved * away).sum(axis=1) > 0).all()


def test_the_default_grip_carries_the_weight_by_friction_twice() -> None:
    item: Any = SimpleNamespace(mass=3.0, shape=SimpleNamespace(bounding_radius=0.05))
    gravity = np.array([0.0, 0.0, -10.0])
    grip = _default_grip(item, gravity, 0.5, 4, ExpectedLoad())
    assert 4 * 0.5 * grip == pytest.approx(GRIP_SAFETY * 30.0)
    light: Any = SimpleNamespace(mass=0.01, shape=item.shape)
    assert _default_grip(light, gravity, 0.5, 4, ExpectedLoad()) == MIN_GRIP
    assert _default_grip(item, gravity, 0.5, 4, ExpectedLoad(force=50.0)) > grip


def test_rows_of_a_projector_span_it_and_mix_no_joints_that_it_does_not() -> None:
    rows = np.zeros((2, 5))
    rows[0, :2] = 0.6, 0.8
    rows[1, 3:] = np.sqrt(0.5), -np.sqrt(0.5)
    projector: FloatArray = rows.T @ rows
    basis = _disjoint_basis(projector)
    np.testing.assert_allclose(basis.T @ basis, projector, atol=1e-12)
    np.testing.assert_allclose(basis @ basis.T, np.eye(2), atol=1e-12)
    assert sorted(np.flatnonzero(np.abs(row) > 1e-9).tolist() for row in basis) == [[0, 1], [3, 4]]
    assert _disjoint_basis(np.zeros((3, 3))).shape == (0, 3)


@pytest.mark.parametrize(
    ("kind", "owner", "mode", "closed"),
    [
        (stat.S_IFREG, "mine", 0o644, True),
        (stat.S_IFREG, "root", 0o600, True),
        (stat.S_IFREG, "other", 0o600, False),
        (stat.S_IFREG, "mine", 0o664, False),
        (stat.S_IFREG, "mine", 0o646, False),
        (stat.S_IFIFO, "mine", 0o600, False),
    ],
)
def test_files_are_trusted_that_no_other_user_writes(
    kind: int, owner: str, mode: int, closed: bool
) -> None:
    mine = os.getuid() if hasattr(os, "getuid") else 0
    owners = {"mine": mine, "root": 0, "other": mine + 1}
    state: Any = SimpleNamespace(st_uid=owners[owner], st_mode=kind | mode)
    assert bool(_is_closed(state)) == closed


def test_forces_of_contacts_are_found_from_where_their_moment_begins() -> None:
    """Of a contact with three numbers the fourth is 0; one without constraint has none."""
    forces = np.arange(20.0)
    found = _elliptic_forces(
        forces, np.array([0, 10, 10]), np.array([2, 4, -1]), np.array([3, 4, 3])
    )
    np.testing.assert_array_equal(found, [[2, 3, 4, 0], [14, 15, 16, 17], [0, 0, 0, 0]])


def test_why_a_run_stopped_is_in_its_message() -> None:
    assert str(Stopped("reading stale", "30 ms")) == "reading stale: 30 ms"


def test_a_journal_has_every_row_at_once_and_none_once_it_is_closed(tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    with Journal(path) as journal:
        journal.add({"row": 1})
        assert path.read_text(encoding="utf-8") == '{"row": 1}\n'
    with pytest.raises(ValueError, match="closed"):
        journal.add({"row": 2})


def test_names_are_joined_by_a_plus_but_not_in_a_path_that_is_there(tmp_path: Path) -> None:
    there = tmp_path / "left+right.toml"
    assert joined_names(there) == (f"{tmp_path}/left", "right.toml")
    there.touch()
    assert joined_names(there) == ()
    assert joined_names("allegro_hand + shadow_hand") == ("allegro_hand", "shadow_hand")
    assert joined_names("allegro_hand") == ()


def test_moments_at_which_nothing_was_read_have_no_numbers() -> None:
    recorder: Any = SimpleNamespace(_read=[None, (np.ones(4), np.full(7, 2.0))])
    joints, poses = StateRecorder._readings(recorder, 4)
    np.testing.assert_array_equal(joints, [[np.nan] * 4, [1.0] * 4])
    np.testing.assert_array_equal(poses, [[np.nan] * 7, [2.0] * 7])
    recorder._read = [None, None]
    assert StateRecorder._readings(recorder, 4) == (None, None)


def test_time_of_a_tick_is_that_of_interface_controller_and_the_rest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Read 1 s, made ready 2 s, controlled 4 s, limited 5 s, written 8 s."""
    monkeypatch.setattr("time.thread_time", lambda: 20.0)
    ran: Any = SimpleNamespace(_spans=[])
    loop.ControlLoop._note_cpu(ran, [0.0, 1.0, 3.0, 7.0, 12.0])
    assert ran._spans == [(9.0, 4.0, 7.0)]


def test_the_hardest_collision_of_the_hand_is_told_and_none_of_the_object(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Contacts of one pair add up."""

    def touch(kind: Any, first: str, second: str, force: float) -> reading.Touch:
        return reading.Touch(kind=kind, first=first, second=second, normal_force=force)

    touches = [
        touch("object-table", "object", "table", 50.0),
        touch("hand-table", "palm", "table", 3.0),
        touch("hand-obstacle", "tip", "shelf", 2.0),
        touch("hand-obstacle", "tip", "shelf", 2.5),
    ]
    scene: Any = None
    monkeypatch.setattr(reading, "_touches", lambda *_: touches)
    assert reading.collisions(scene, (), ()) == ("tip - shelf", 4.5)
    monkeypatch.setattr(reading, "_touches", lambda *_: touches[:1])
    assert reading.collisions(scene, (), ()) == ("", 0.0)


def test_a_command_below_the_logged_one_differs_as_much_as_one_above() -> None:
    log = SimpleNamespace(
        commands=np.array([[1.0, 2.0], [np.nan, 0.0]]),
        begin_s=np.array([5.0, 5.1]),
        end_s=np.array([5.05, 5.15]),
    )
    hand: Any = SimpleNamespace(
        log=log, actuator_names=("a", "b"), _i=0, _stopped=False, _differences=[], _now=0.0
    )
    ReplayedHand.write(hand, np.array([0.5, 2.1]))
    hand._i = 1
    ReplayedHand.write(hand, np.array([9.0, 9.0]))  # nothing was logged
    found = ReplayedHand.comparison(hand)
    assert (found.compared, found.largest, found.actuator, found.time_s) == (1, 0.5, "a", 0.0)
    assert hand._now == 5.15


@pytest.mark.parametrize("off", [0.0, 0.2])
def test_the_turn_off_a_goal_is_that_between_it_and_where_the_object_is(off: float) -> None:
    """The goal is itself a turn; of a plan without one there is no number."""
    goal = SE3(pin.exp3(np.array([0.7, 0.1, 0.3])), np.zeros(3))
    last = SE3(goal.rotation @ pin.exp3(np.array([0.0, off, 0.0])), np.ones(3))
    states = np.array([np.zeros(7), np.concatenate(pose_to_wxyz(last))])
    ending = SimpleNamespace(turned=True, T_world_target=goal)
    report: Any = SimpleNamespace(
        plan=SimpleNamespace(ending=ending), recording=SimpleNamespace(T_world_object=states)
    )
    getter: Any = ManipulationReport.goal_off
    assert getter.fget(report) == pytest.approx(off, abs=1e-7)
    ending.turned = False
    assert np.isnan(getter.fget(report))


@pytest.mark.parametrize("find", [_distinct, distinct_faces])
def test_a_face_that_is_met_twice_is_told_once(find: Any) -> None:
    """Nearest first; those at one distance in the order of their products with the ties."""
    axes, ties = np.eye(6), np.array([3.0, 1.0, 2.0, 0.0, 0.0, 0.0])
    rows = [(axes[0], -0.1), (axes[1], -0.1), (axes[0], -0.1), (axes[2], -0.1), (axes[1], -0.3)]
    faces = np.array([[*normal, offset] for normal, offset in rows])
    expected = [(axes[1], -0.1), (axes[2], -0.1), (axes[0], -0.1), (axes[1], -0.3)]
    np.testing.assert_array_equal(
        find(faces, ties), [[*normal, offset] for normal, offset in expected]
    )


@pytest.mark.parametrize(
    ("colour", "carries_pad", "shown"),
    [
        (MUJOCO_GREY, True, TIP_COLOUR),
        (MUJOCO_GREY, False, PLAIN_COLOUR),
        ((1.0, 0.0, 0.0, 0.0), True, PLAIN_COLOUR),  # not to be seen in the file
        ((1.0, 0.0, 0.0, 1.0), True, (1.0, 0.0, 0.0, 1.0)),
    ],
)
def test_links_without_a_colour_of_their_own_are_dark_where_they_touch(
    colour: tuple[float, float, float, float], carries_pad: bool, shown: tuple[float, ...]
) -> None:
    surface = LinkSurface(
        name="tip",
        body="tip",
        joint_id=1,
        collides=True,
        is_mesh=False,
        vertices=np.eye(4, 3),
        triangles=np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]),
        colour=colour,
    )
    part = _visual(surface, 1.0, carries_pad)
    np.testing.assert_allclose(part.colour, shown)
    assert len(part.triangles) == 4


def test_what_an_element_has_as_mujoco_reads_it(tmp_path: Path) -> None:
    """Of sections that come again the last counts; classes add to those around them."""
    path = tmp_path / "model.xml"
    path.write_text(
        """<mujoco>
        <compiler angle="radian" autolimits="true"/><compiler angle="degree"/>
        <default><joint damping="1" armature="2"/>
          <default class="finger"><joint damping="3"/>
            <default class="tip"><joint armature="4"/></default>
          </default>
        </default>
        <worldbody><body name="a" childclass="finger">
          <joint name="one"/><body><joint name="two" class="tip"/></body></body>
          <body><joint name="three"/></body>
        </worldbody></mujoco>""",
        encoding="utf-8",
    )
    text = MjcfText(path)
    assert text.option("compiler", "angle") == "degree"
    assert text.option("compiler", "autolimits") == "true"
    assert text.option("compiler", "meshdir") is None and text.option("option", "gravity") is None
    expected = {"one": ("3", "2"), "two": ("3", "4"), "three": ("1", "2")}
    for name, values in expected.items():
        element = text.element("joint", name)
        assert element is not None
        inherited = text.inherited(element)
        assert (inherited["damping"], inherited["armature"]) == values
    assert text.element("joint", "four") is None and not text.includes


def test_principal_moments_are_those_of_the_whole_tensor() -> None:
    """MuJoCo writes it as xx yy zz xy xz yz; NaN where only a diagonal is given."""
    turn = pin.exp3(np.array([0.3, -0.8, 0.5]))
    tensor = turn @ np.diag([1.0, 2.0, 4.0]) @ turn.T
    full = [*np.diag(tensor), tensor[0, 1], tensor[0, 2], tensor[1, 2]]
    body: Any = SimpleNamespace(fullinertia=full, inertia=np.ones(3))
    np.testing.assert_allclose(_principal(body), [1.0, 2.0, 4.0])
    body = SimpleNamespace(fullinertia=[np.nan] * 6, inertia=[3.0, 2.0, 1.0])
    np.testing.assert_array_equal(_principal(body), [3.0, 2.0, 1.0])


def test_actuators_are_read_with_the_stiffness_and_the_limit_of_their_law() -> None:
    """A servo holds with its gain; a motor and one of another law hold nothing."""
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body><joint name="j"/><geom size="0.1"/></body></worldbody>
        <actuator><position joint="j" kp="7" forcerange="-3 2"/><motor joint="j" gear="4"/>
        </actuator></mujoco>"""
    )
    servo, motor = structure_of(model).actuators
    assert (servo.stiffness, servo.force_limit, servo.row.tolist()) == (7.0, 3.0, [1.0])
    assert (motor.stiffness, motor.force_limit, motor.row.tolist()) == (0.0, np.inf, [4.0])


@pytest.mark.parametrize(
    ("found", "solver", "said"),
    [
        (False, "daqp", "not found"),
        (True, "", "found, nothing to solve"),
        (True, "daqp", "found by daqp in 2.5 ms"),
    ],
)
def test_how_forces_were_found_is_said_with_the_time_in_milliseconds(
    found: bool, solver: str, said: str
) -> None:
    solution: Any = SimpleNamespace(found=found, solver=solver, solve_time_s=0.0025)
    getter: Any = ForceSolution._verdict
    assert getter.fget(solution) == said


def test_a_small_picture_has_few_triangles_shared_out_by_size() -> None:
    """What it does not show is left out; a small part keeps its least number, here all it has."""
    ball, cube = trimesh.creation.icosphere(5, 0.05), trimesh.creation.box((0.02, 0.02, 0.02))

    def part(mesh: trimesh.Trimesh, name: str, layer: Any) -> Part:
        return Part(
            name=name,
            layer=layer,
            vertices=np.array(mesh.vertices),
            triangles=np.array(mesh.faces),
            colour=(1.0, 1.0, 1.0, 1.0),
        )

    parts = part(ball, "ball", "object"), part(cube, "cube", "hand"), part(ball, "c", "collision")
    small = _light(Model(joints=(), parts=parts))
    assert [p.name for p in small.parts] == ["ball", "cube"]
    assert 0.8 * MOST_TRIANGLES < len(small.parts[0].triangles) <= MOST_TRIANGLES
    assert len(small.parts[1].triangles) == len(cube.faces)


def test_a_demonstrator_gives_up_when_its_teacher_does() -> None:
    getter: Any = Demonstrator.gave_up
    for reason in ("", "the grasp opens"):
        demonstrator: Any = SimpleNamespace(teacher=SimpleNamespace(gave_up=reason))
        assert getter.fget(demonstrator) == reason


@pytest.mark.parametrize("table", [None, 0.0])
def test_an_object_that_was_felt_beside_its_place_is_planned_for_there(
    table: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The shift is felt in the object's frame; on a table nothing goes up or down."""
    given: list[SE3] = []

    def verified(_: Any, __: Any, there: SE3) -> Failure:
        given.append(there)
        return Failure(kind="no", text="no")

    monkeypatch.setattr(from_cloud, "_verified", verified)
    turn, shift = pin.exp3(np.array([0.0, 0.0, np.pi / 2])), np.array([0.01, 0.002, 0.003])
    belief = SimpleNamespace(
        with_felt=lambda felt, error: (None, shift), cloud=SimpleNamespace(table=table)
    )
    task = SimpleNamespace(T_world_object=SE3(turn, np.array([0.3, 0.0, 0.1])))
    plan: Any = SimpleNamespace(
        belief=belief,
        pose_error=(0.005, 0.0),
        plan=SimpleNamespace(task=task, arm=object()),
        others=(SimpleNamespace(plan=None),),
        survives=0.5,
    )
    assert from_cloud.CloudPlan.after(plan, np.zeros((1, 3))) is None
    up = 0.003 if table is None else 0.0
    moved = given[0].act(task.T_world_object.translation) - task.T_world_object.translation
    np.testing.assert_allclose(moved, [-0.002, 0.01, up], atol=1e-12)
