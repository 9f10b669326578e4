"""Known answers in places where faults put in at random went unnoticed."""

from __future__ import annotations

import math
import re
from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import lsq_linear

from planner.bridge.structure import JointPart
from planner.describe.drive import missing_servos
from planner.describe.proposal import LEAST_HEIGHT, fitting_objects
from planner.errors import HandError
from planner.failure import Failure
from planner.hand_loading import load_hand
from planner.hands.two_hands import _check_faces
from planner.motion.path import ATTITUDES, ObjectPath
from planner.objects import parse_object
from planner.shapes import Mesh
from planner.shapes.mesh_field import _one_of_each_cube
from planner.spatial import SE3
from planner.synthesis.terms.fingers import closest_on_segments, nearest
from planner.task import GraspTask
from sim.crosscheck import reader
from sim.manipulation.run import ManipulationRun
from sim.sensing.errors import ERROR_MODELS
from sim.sensing.touch.layout import GRID, ContactEstimate, TaxelFrictionEstimator


def test_nearest_points_of_segments_are_those_of_least_squares() -> None:
    """Both the loops and the arrays; segments cross, overlap, and are parallel or points."""
    rng = np.random.default_rng(0)
    ends = rng.normal(size=(4, 60, 3)) * rng.choice([0.02, 0.2], (4, 60, 1))
    ends[3, :10] = ends[2, :10] + ends[1, :10] - ends[0, :10]  # parallel
    ends[3, 10:15] = ends[2, 10:15]
    one, two = closest_on_segments(*ends)
    out = np.zeros((2, 3))
    for k in range(60):
        p1, q1, p2, q2 = ends[:, k]
        best = lsq_linear(np.column_stack([q1 - p1, p2 - q2]), p2 - p1, bounds=(0, 1), tol=1e-14)
        apart = float(np.sqrt(2 * best.cost))
        nearest(np.array([p1, p2, q1, q2]), 0, 1, 2, out)
        for a, b in ((one[k], two[k]), out):
            assert np.linalg.norm(b - a) == pytest.approx(apart, abs=1e-5)
            for point, p, q in ((a, p1, q1), (b, p2, q2)):  # each is on its segment
                way = np.linalg.norm(point - p) + np.linalg.norm(q - point)
                assert way == pytest.approx(np.linalg.norm(q - p), abs=1e-9)


@pytest.mark.parametrize(("ratio", "told"), [(0.49, False), (0.51, True)])
def test_a_touch_with_little_shear_tells_nothing_of_friction(ratio: float, told: bool) -> None:
    """Below half of the least friction that is looked for, the spread of shear is noise."""
    watch = TaxelFrictionEstimator([0.002])
    before = watch.friction.copy()
    seen: Any = ContactEstimate(
        normal_force=1.0,
        place=np.zeros(2),
        point=np.zeros(3),
        normal=np.array([0.0, 0.0, 1.0]),
        force=np.array([ratio * GRID[0], 0.0, 1.0]),
        torsion=0.0,
        pressure_spread=4e-6,
        shear_spread=6e-6,
    )
    watch.step(0.002, [seen], np.array([False]))
    assert bool((watch.friction != before).any()) == told


def test_objects_that_fit_a_hand_are_half_as_tall_again_as_wide() -> None:
    rows = (SimpleNamespace(name="pinch", gap=0.02), SimpleNamespace(name="open", gap=0.12))
    check: Any = SimpleNamespace(postures=rows)
    found = [parse_object(spec).shape for spec in fitting_objects(check)]
    width = 0.02 + 0.35 * 0.1
    for k, scale in enumerate((1.0, 0.75, 1.2)):
        cylinder, sphere, box = (2 * s.half_extents for s in found[3 * k : 3 * k + 3])
        tall = max(1.5 * scale * width, LEAST_HEIGHT)
        np.testing.assert_allclose(cylinder, [scale * width, scale * width, tall], atol=2e-3)
        np.testing.assert_allclose(sphere, scale * width, atol=2e-3)
        np.testing.assert_allclose(box, [0.85 * scale * width] * 2 + [tall], atol=2e-3)


SENSORS_PAGE = Path(__file__).parents[1] / "docs" / "how" / "sensors.md"

ROWS = {
    "joint offset": "encoder_offset",
    "joint scale": "encoder_scale",
    "joint reading, joint velocity": "encoder_noise rate_noise",
    "joint resolution": "encoder_step",
    "backlash between servo and joint": "backlash",
    "dry friction per joint, beyond the model's": "dry_friction",
    "actuator force": "torque_constant",
    "commands: delay, rate": "command_delay command_rate",
    "object pose, white noise": "pose_noise turn_noise",
    "object pose, drift over 1 s": "pose_drift turn_drift",
    "object pose: rate, delay": "pose_rate pose_delay",
    "dropouts: probability per pose, duration": "dropout dropout_time",
    "touch: force, sliding velocity": "touch_noise sliding_noise",
    "touch: force scale, per finger": "touch_scale",
    "touch: position on the pad, drift over 1 s": "touch_place",
    "touch: resolution, threshold": "touch_step touch_threshold",
    "touch: rate, delay": "touch_rate touch_delay",
    "object size": "object_size",
    "object mass": "object_mass",
    "centre of mass, share of half the extents": "object_center",
    "object friction": "object_friction",
}
"""Rows of the page's table of presets and the fields of ``ErrorModel`` that they tell."""

UNITS = {"°": math.pi / 180, "%": 0.01, "mm": 1e-3, "ms": 1e-3, "mm/s": 1e-3}
"""Others are those of the fields."""


@pytest.mark.parametrize(("name", "column"), [("lab", 2), ("rough", 3)])
def test_presets_of_sensor_errors_are_those_of_the_page(name: str, column: int) -> None:
    lines = SENSORS_PAGE.read_text(encoding="utf-8").splitlines()
    cells = [[c.strip() for c in line.strip("| ").split(" | ")] for line in lines]
    told = {row[0]: row[column] for row in cells if len(row) == 4 and row[0] in ROWS}
    assert set(told) == set(ROWS)
    preset = ERROR_MODELS[name]
    for row, names in ROWS.items():
        values = told[row].split(", ")
        for field, value in zip(names.split(), values * len(names.split()), strict=False):
            number, unit = re.fullmatch(r"([\d.]+)\s*(.*)", value).groups()  # type: ignore[union-attr]
            known = getattr(preset, field)
            if known != np.inf and not (known == 0.0 and field.endswith(("_time", "_rate"))):
                assert known == pytest.approx(float(number) * UNITS.get(unit, 1.0), rel=2e-3), field
    told_fields = set(" ".join(ROWS.values()).split())
    numbers = {f.name for f in fields(preset) if f.type == "float"}
    assert numbers - told_fields <= {"pose_bias", "turn_bias", "drift_time"}


def half_way(strokes: int, path: ObjectPath, pose: SE3, height: float = 0.1) -> Any:
    """A run whose object is at a pose half-way in a turn, lifted by a height (m)."""
    task = GraspTask.create("allegro_hand", "box:0.05x0.05x0.08")
    first = task.T_world_object
    grasp: Any = SimpleNamespace(
        task=task, q_pregrasp=task.hand.neutral, pregrasp_distance=0.0, T_world_base_start=first,
        arm=None,
    )  # fmt: skip
    return SimpleNamespace(
        plan=SimpleNamespace(
            path=path, ending=SimpleNamespace(back=""), cycles=strokes, task=task, grasp=grasp
        ),
        sim=SimpleNamespace(
            simulation=SimpleNamespace(plan=grasp),
            reading=SimpleNamespace(T_world_object=lambda: pose),
        ),
        _phases=SimpleNamespace(height=height),
    )


@pytest.mark.parametrize("strokes", [1, 2])
def test_half_a_turn_that_would_fall_goes_back_by_one_stroke_alone(strokes: int) -> None:
    """A gait cannot be reversed: fingers stand elsewhere. A stroke is, to where it began."""
    tilted = SE3(pin.exp3(0.4 * np.eye(3)[1]), np.array([0.01, 0.02, 0.1]))
    path = ObjectPath(axis=np.eye(3)[1], angle=1.0, shift=np.zeros(3))
    ending = ManipulationRun.put_down(half_way(strokes, path, tilted))
    if strokes > 1:
        assert isinstance(ending, Failure) and ending.kind == "falls"
    else:
        assert not isinstance(ending, Failure)
        assert ending.back == "half-way it does not stand"
        np.testing.assert_allclose(ending.T_world_target.rotation, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(
            ending.T_world_target.translation, [0.01, 0.02, 0.04], atol=1e-12
        )


@pytest.mark.parametrize("name", ["sideways", "up"])
def test_what_is_put_down_half_way_in_an_attitude_stands_below_where_it_was_lifted(
    name: str,
) -> None:
    """The wrist has turned it about its centre, lifted; so the lift is no way to the side."""
    turn, height = ATTITUDES[name], 0.15
    path = ObjectPath(axis=np.eye(3)[1], angle=1.0, shift=np.zeros(3), attitude=turn)
    center = np.array([0.0, 0.0, 0.04])
    moved = np.array([0.01, -0.02, 0.003])  # of the object, before the wrist turned
    pose = SE3(turn @ pin.exp3(0.4 * np.eye(3)[1]), center + turn @ moved + [0.0, 0.0, height])
    ending = ManipulationRun.put_down(half_way(1, path, pose, height))
    assert not isinstance(ending, Failure)
    np.testing.assert_allclose(ending.T_world_target.translation, [0.01, -0.02, 0.04], atol=1e-9)


def test_the_child_that_reads_models_finds_this_package() -> None:
    assert Path(reader.__file__).resolve() == reader.PACKAGES / "sim" / "crosscheck" / "reader.py"


@pytest.mark.parametrize(("order", "fits"), [((0, 1), True), ((1, 0), False)])
@pytest.mark.parametrize("middle", [0.0, 1.0, -1.0])
def test_two_palms_look_at_each_other_wherever_the_pair_stands(
    middle: float, order: tuple[int, int], fits: bool
) -> None:
    places = [(0.0, middle - 0.25, 0.0), (0.0, middle + 0.25, 0.0)]
    half = math.sqrt(0.5)
    held: Any = [
        SimpleNamespace(name=name, position=places[k], quaternion_wxyz=(half, 0.0, 0.0, turn))
        for name, k, turn in (("right", order[0], half), ("left", order[1], -half))
    ]
    hands = [load_hand("allegro_hand"), load_hand("allegro_hand_left")]
    pair: Any = SimpleNamespace(hands=held)
    if fits:
        _check_faces("pair.toml", pair, hands)
    else:
        with pytest.raises(HandError, match="'right' does not look towards the other hand"):
            _check_faces("pair.toml", pair, hands)


@pytest.mark.parametrize("radius", [0.03, 0.05])
def test_a_teacups_handle_stands_off_by_three_quarters_of_its_radius(radius: float) -> None:
    cup = parse_object(f"teacup:{radius}x0.09x0.002").shape
    assert isinstance(cup, Mesh)
    long, wide, high = np.ptp(cup.vertices, axis=0)
    assert (wide, high) == pytest.approx((2 * radius, 0.09))
    thick = long - 2 * radius - 0.75 * radius  # half the handle's thickness
    assert 0.002 < thick < 0.006


@pytest.mark.parametrize(("kind", "believed", "filler", "usual"), [
    ("hinge", 5.0, 5.1, 0.7), ("slide", 500.0, 510.0, 20.0),
])  # fmt: skip
def test_efforts_that_no_finger_has_are_not_proposed(
    kind: str, believed: float, filler: float, usual: float
) -> None:
    """URDF files hold 30, 100 or 1000 where nobody knew."""
    efforts = (believed, filler, math.inf, 0.0)
    joints = [
        JointPart(name=str(k), body=k, kind=kind, limits=None, damping=0.0, frictionloss=0.0,
                  armature=0.0, effort=effort)
        for k, effort in enumerate(efforts)
    ]  # fmt: skip
    asked: list[str] = []
    notes: Any = SimpleNamespace(because=lambda *_: None, ask=asked.append)
    structure: Any = SimpleNamespace(joints=joints)
    servos = missing_servos(structure, [], range(4), np.full(4, 1e-5), notes)
    force = {name: servo.force_limit for servo in servos for name in servo.joints}
    assert force == {"0": believed, "1": usual, "2": usual, "3": usual}
    assert f"up to {filler:g} N m on 1, 3" in asked[0]


@pytest.mark.parametrize("shape", [(2, 7, 3), (7, 2, 3), (3, 5, 9)])
def test_one_point_of_each_cube_is_kept(shape: tuple[int, int, int]) -> None:
    grid = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1).reshape(-1, 3)
    points = np.concatenate([0.01 * grid, 0.01 * grid + 0.004])
    kept = _one_of_each_cube(points, 0.01 - 1e-9)
    assert len(kept) == len(grid)
    assert len({tuple(c) for c in np.floor(points[kept] / 0.01 + 1e-6).astype(int)}) == len(grid)
