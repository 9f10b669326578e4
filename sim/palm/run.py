"""``reorient_in_palm``: an object lies on palm and fingers, and is turned there to a rotation.

Everything is expressed in the frame of the hand as it stands: z out of the palm, x to the fingers,
the origin at the palm's. The weight leans by ``tilt`` towards the fingers, as of a hand that an arm
holds so: what slides, slides to where fingers reach it. What rolls off the open palm, or is pushed
aside by fingers that curl, which trials tell, is held until they have curled about it (caged), and
is turned where it then lies.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from types import MappingProxyType
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

from planner.arrays import checked_kind, checked_number, finite_array
from planner.bridge import compile_spec
from planner.errors import NotFoundError, TaskError
from planner.hands.hand import Hand
from planner.kinematics import HandState
from planner.motion.path import checked_rotation
from planner.objects import GraspObject
from planner.search.attempt import check_seed
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask
from sim.palm.loop import Progress, turn
from sim.palm.model import PalmModel, Plant, plant_of
from sim.palm.report import PalmReport
from sim.palm.settings import PalmSettings
from sim.scene.build import Scene, add_looks, index_scene, scene_spec
from sim.scene.physics import PRESETS, AnyPhysics
from sim.show.picture import FORMATS, Tape, check_video, draw_tape, moments_of

GRAVITY = 9.81
"""m/s2."""

TILT = np.radians(20.0)
"""How far (rad) the palm leans to the fingers: less than the friction angle, 31 degrees at 0.6."""

TOLERANCE_DEG, HOLD_S, LONGEST_S = 5.0, 0.5, 120.0
"""Success: so near (degrees), for so long (s), before so long (s)."""

BELIEVED = 5 / 6
"""Share of the friction that there is that the controller believes in (-): 0.5 of 0.6."""

SETTLE_S = 0.6
"""Time (s) in which the object comes to rest on the palm before it is turned."""

ROLLS_M = 0.05
"""An object that gets further (m) on the open palm in ``SETTLE_S`` rolls: balls and ellipsoids of 5
to 7 cm get 0.35 m and further, cubes, cylinders on their ends, tori and L-brackets 2 mm."""

PUSHED_M = 0.037
"""An object that curling fingers push further (m) along the palm is held meanwhile: a cylinder of
56 mm is pushed by 31 to 58 mm, to where fingers hardly turn it. Cubes of 5 cm are pushed by 4 to 36
mm (60 draws), and are turned from there."""

BACK = 0.05
"""Share (-) of the way to the open hand by which fingers let go of what they cage, some millimetres
at the tips: what they press turns back with them when they open. Of eight turns of balls of 25 and
30 mm radius by 90 degrees in 20 s (seeds 9001, 9002, 9003, 9005 of the benchmark) 4 were done with
0, 6 with 0.05 and 8 with 0.1; of 14 others of 25 to 35 mm in 30 s (from seed 9340) 13 with 0.05, in
6 s in the median, and 12 with 0.1, in 13 s."""

FALLEN_M = 0.05
"""An object that is further (m) below where it was laid down has left the palm."""

HIGHEST, RISE = 0.25, 0.001
"""Height (m) up to which the object is lifted, in such steps, until it is clear of the hand."""

CRADLES: Mapping[str, tuple[tuple[float, float], Mapping[str, float]]] = MappingProxyType(
    {
        "allegro_hand": (
            (-0.03, -0.01),
            MappingProxyType(
                {
                    **{"index_0": 0.12, "index_1": 1.13, "index_2": 1.45, "index_3": 1.24},
                    **{"middle_0": -0.02, "middle_1": 0.45, "middle_2": 1.17, "middle_3": 1.5},
                    **{"ring_0": -0.46, "ring_1": 1.54, "ring_2": 1.11, "ring_3": 1.23},
                    **{"thumb_0": 0.64, "thumb_1": 1.39, "thumb_2": 1.5, "thumb_3": 1.26},
                }
            ),
        ),
        "shadow_hand": (
            (0.076, -0.016),
            MappingProxyType(
                {
                    **{"FFJ4": 0.11, "FFJ3": 0.65, "FFJ2": 1.56, "FFJ1": 1.56},
                    **{"MFJ4": 0.13, "MFJ3": 0.15, "MFJ2": 1.57, "MFJ1": 1.57},
                    **{"RFJ4": 0.2, "RFJ3": 0.27, "RFJ2": 1.57, "RFJ1": 1.57},
                    **{"LFJ5": 0.49, "LFJ4": 0.17, "LFJ3": 0.39, "LFJ2": 1.57, "LFJ1": 1.57},
                    **{"THJ5": 0.66, "THJ4": 1.02, "THJ3": 0.18, "THJ2": -0.08, "THJ1": 0.93},
                }
            ),
        ),
    }
)
"""Hand -> where an object lies on its palm (x, y), m, and joints (rad) that curl about it there.
Those of the Allegro-type hand are near what the published scene begins with (arXiv 2408.07855).
Those of the Shadow-type hand are, of 200 drawn, where a 5 cm cube rests flat and fingertips are
nearest to where its centre is wanted."""

AHEAD, LIFT = 0.02, 0.012
"""How far (m) towards the fingers and above where it lies the centre is wanted: off the palm, which
rubs, and where all fingertips reach."""


def reorient_in_palm(
    hand: Hand | str,
    object: GraspObject | str,
    goal_rotation: FloatArray,
    *,
    start_rotation: FloatArray | None = None,
    shift: Sequence[float] = (0.0, 0.0),
    cradle: tuple[Sequence[float], Mapping[str, float]] | None = None,
    tilt: float = TILT,
    settings: PalmSettings | None = None,
    physics: AnyPhysics | None = None,
    tolerance_deg: float = TOLERANCE_DEG,
    hold_s: float = HOLD_S,
    longest_s: float = LONGEST_S,
    seed: int = 0,
    picture: Path | str | None = None,
    video: Path | str | None = None,
    progress: Progress | None = None,
) -> PalmReport:
    """Turn an object that lies in the palm, in MuJoCo, and judge. Ctrl-C ends it with a report.

    Args:
        hand: A hand or its name.
        object: An object or its specification.
        goal_rotation: Rotation (3, 3) that it is to have, in the frame of the hand (z out of the
            palm, x to the fingers).
        start_rotation: The one in which it is laid down (3, 3); identity if None.
        shift: Where it is laid down (2,), m, from where objects lie on this hand.
        cradle: Where an object lies on the palm (x, y), m, and joints (rad) by name that curl
            about it; those of ``CRADLES`` if None.
        tilt: How far the palm leans to the fingers, rad.
        settings: Of the controller; defaults if None, with ``BELIEVED`` of the friction there is.
        physics: How MuJoCo computes, or a preset's name; defaults if None.
        tolerance_deg: Largest angle to the goal that counts as there, degrees.
        hold_s: How long it has to stay there, s.
        longest_s: Simulated time after which it has failed, s.
        seed: Of the postures to which fingers may open.
        picture: Write a picture of the end here (PNG).
        video: Write a film here.
        progress: Told the simulated time (s) and the angle to the goal (degrees) now and then.

    Raises:
        NotFoundError: No such hand, or one without a cradle.
        TaskError: A goal that is no rotation, a hand on an arm, servos that hold no position, or
            an object that rolls off at once.
    """
    wanted = "orthonormal columns with determinant 1, the frame of the hand from the object"
    goal = checked_rotation("goal_rotation", goal_rotation, wanted)
    first = np.eye(3)
    if start_rotation is not None:
        first = checked_rotation("start_rotation", start_rotation, wanted)
    moved = finite_array("shift", shift, (2,), error=TaskError)
    tilt = checked_number("tilt", tilt, least=0.0, most=np.pi / 2, unit="rad", error=TaskError)
    for name, value in (
        ("tolerance_deg", tolerance_deg),
        ("hold_s", hold_s),
        ("longest_s", longest_s),
    ):
        checked_number(name, value, above=0.0, most=1e4, error=TaskError)
    check_seed(seed)
    asked = None if settings is None else checked_kind("settings", settings, PalmSettings)
    check_video(None if video is None else Path(video))
    begin = time.perf_counter()
    scene, q, nest = palm_scene(hand, object, tilt=tilt, physics=physics, cradle=cradle)
    asked = asked or PalmSettings(mu=BELIEVED * scene.physics.mu)
    plant, data = plant_of(scene), mujoco.MjData(scene.model)
    opened, name = scene.task.hand.neutral, scene.task.object.name
    way = _travel(plant, asked, opened, opened, first, nest + moved)
    caged = float(np.linalg.norm(way)) > ROLLS_M
    if not caged:
        way = _travel(plant, asked, opened, q, first, nest + moved)
        caged = float(np.linalg.norm(way[:2])) > PUSHED_M
    if caged:  # laid down where it comes to rest, it has the rotation asked for when it begins
        way = _travel(plant, asked, opened, q, first, nest, held=True)
        _check_there(way, name)
        nest = nest + way[:2]
    lay_down(plant, data, asked, opened, first, nest + moved)
    tape = Tape(scene.model, scene.subject) if picture or video else None
    rate = max(1, round(1.0 / (FORMATS[".mp4"].rate * scene.model.opt.timestep)))
    taken = [0]

    def keep() -> None:
        if tape is not None and taken[0] % rate == 0:
            tape.keep(float(data.time), data.qpos)
        taken[0] += 1

    laid = data.xpos[plant.object_body].copy()
    _settle(plant, data, q, keep, held=caged)
    _check_there(data.xpos[plant.object_body] - laid, name)
    place = data.xpos[plant.object_body].copy()
    if not caged:
        place += [AHEAD, 0.0, LIFT]
        place[:2] -= moved
    log = turn(
        plant,
        data,
        goal,
        place,
        settings=asked,
        tolerance_deg=tolerance_deg,
        hold_s=hold_s,
        longest_s=longest_s,
        seed=seed,
        caged=caged,
        on_step=keep,
        progress=progress,
    )
    drawn = ""
    if tape is not None:
        stills = moments_of(picture, None)
        drawn = str(draw_tape(tape, pictures=stills, video=None if video is None else Path(video)))
    states = np.array(log.qpos)
    return PalmReport(
        hand=scene.task.hand.name,
        object=scene.task.object.shape.spec,
        mass_kg=scene.task.object.mass,
        seed=seed,
        goal=goal,
        tilt_deg=float(np.degrees(tilt)),
        caged=caged,
        tolerance_deg=tolerance_deg,
        hold_s=hold_s,
        longest_s=longest_s,
        outcome=log.outcome,
        time=np.array(log.time),
        error_deg=np.array(log.error_deg),
        phase=tuple(log.phase),
        T_world_object=states[:, scene.object_qpos],
        q=states[:, scene.hand_qpos],
        solve_ms=1e3 * np.array(log.solve_s),
        look_ms=1e3 * np.array(log.look_s),
        settings=asdict(asked),
        physics={"name": scene.physics.name, "mu": scene.physics.mu},
        wall_s=time.perf_counter() - begin,
        task=scene.task,
        T_world_base=scene.T_world_base,
        drawn=drawn,
    )


def palm_scene(
    hand: Hand | str,
    object: GraspObject | str,
    *,
    tilt: float = TILT,
    physics: AnyPhysics | None = None,
    cradle: tuple[Sequence[float], Mapping[str, float]] | None = None,
) -> tuple[Scene, FloatArray, FloatArray]:
    """A hand that stands palm up with a free object, its joints (nq,) and the place (2,), m.

    Raises:
        NotFoundError: No such hand, or one without a cradle.
        TaskError: The hand is two, or on an arm.
    """
    task = GraspTask.create(
        hand,
        object,
        table_height=None,
        gravity=GRAVITY * np.array([np.sin(tilt), 0.0, -np.cos(tilt)]),
    )
    hand = task.hand
    hand.require_one("turning in the palm")
    if hand.arm is not None:
        raise TaskError(f"{hand.name} is on an arm; name the hand alone: the palm stands still")
    if cradle is None:
        if hand.name not in CRADLES:
            hint = "Give cradle=((x, y), {joint: rad}): where an object lies, and curled fingers."
            raise NotFoundError("palm-up pose of a hand", hand.name, CRADLES, hint)
        cradle = CRADLES[hand.name]
    nest = finite_array("the cradle's place", cradle[0], (2,), error=TaskError)
    q = np.array(hand.neutral)
    for joint, angle in cradle[1].items():
        q[hand.joint_index(joint)] = angle
    q = np.clip(q, hand.q_lower, hand.q_upper)
    palm = HandState(hand, q).T_base_palm
    ahead = _ahead(hand, palm)
    turn_up = np.array([ahead, np.cross(hand.palm_normal, ahead), hand.palm_normal])
    T_world_base = SE3(turn_up, np.zeros(3)) * palm.inverse()
    chosen = PRESETS.given(physics)
    spec = scene_spec(task, T_world_base, chosen, with_gantry=False)
    add_looks(spec, task, T_world_base, q)
    model = compile_spec(spec, f"the scene of {spec.modelname}")
    return index_scene(task, chosen, T_world_base, model, None, task.object.shape), q, nest


def _ahead(hand: Hand, palm: SE3) -> FloatArray:
    """Direction to the fingers (3,), unit, in the palm's frame, across its normal."""
    state = HandState(hand, hand.neutral)
    tips = np.array([palm.actInv(state.pad_center(f)) for f in hand.fingers.values()])
    way = tips.mean(axis=0)
    way -= hand.palm_normal * (hand.palm_normal @ way)
    # along the axis of the palm's frame that is nearest: fingers spread, and a thumb stands aside
    axis = int(np.abs(way).argmax())
    return np.asarray(np.sign(way[axis]) * np.eye(3)[axis])


def lay_down(
    plant: Plant,
    data: Any,
    settings: PalmSettings,
    q: FloatArray,
    rotation: FloatArray,
    place: FloatArray,
) -> None:
    """Put the open hand's joints at q (nq,), and the object just above it, over a place (2,), m.

    Raises:
        TaskError: There is no room for it above the palm.
    """
    data.eq_active[:] = plant.model.eq_active0
    if plant.model.neq:
        data.eq_active[plant.model.eq_obj1id == plant.object_body] = 0
    x, y, z, w = pin.Quaternion(rotation).coeffs()
    data.qpos[plant.qpos] = q
    data.ctrl[plant.ctrl] = plant.moment @ q
    model = PalmModel(plant, settings)
    for height in np.arange(0.0, HIGHEST, RISE):
        data.qpos[plant.object_qpos] = [*place, height, w, x, y, z]
        if model.gap(data.qpos) > 0.5 * RISE and height > 0.5 * RISE:
            break
    else:
        raise TaskError(
            f"the object touches the hand up to {HIGHEST:g} m above the palm; it is too large for "
            "this hand"
        )
    mujoco.mj_forward(plant.model, data)


def _travel(
    plant: Plant,
    settings: PalmSettings,
    opened: FloatArray,
    curled: FloatArray,
    rotation: FloatArray,
    place: FloatArray,
    held: bool = False,
) -> FloatArray:
    """Way (3,), m, of an object that is laid down.

    Tried on data of its own, while the fingers go from ``opened`` to ``curled`` joints (nq,).
    """
    data = mujoco.MjData(plant.model)
    lay_down(plant, data, settings, opened, rotation, place)
    first = data.xpos[plant.object_body].copy()
    _settle(plant, data, curled, held=held)
    way: FloatArray = data.xpos[plant.object_body] - first
    return way


def _settle(
    plant: Plant,
    data: Any,
    q: FloatArray,
    keep: Callable[[], None] = lambda: None,
    held: bool = False,
) -> None:
    """Let the object come to rest while the fingers curl about it, to joints q (nq,).

    What is ``held`` stays where it is until they have, and have let go of it by ``BACK``: it is
    caged, and nothing presses it.
    """
    opened, curled = data.ctrl[plant.ctrl].copy(), plant.moment @ q
    if held:
        pose = data.qpos[plant.object_qpos].copy()
        _curl(plant, data, opened, curled, keep, pose)
        touching = plant.moment @ data.qpos[plant.qpos]
        curled = touching + BACK * (opened - touching)
        _curl(plant, data, touching, curled, keep, pose)
        opened = curled
    _curl(plant, data, opened, curled, keep)


def _curl(
    plant: Plant,
    data: Any,
    first: FloatArray,
    last: FloatArray,
    keep: Callable[[], None],
    pose: FloatArray | None = None,
) -> None:
    """Move commands (nu,) in half of ``SETTLE_S``, wait as long; hold the object at a pose (7,)."""
    steps = round(SETTLE_S / plant.model.opt.timestep)
    for k in range(steps):
        data.ctrl[plant.ctrl] = first + min(1.0, 2.0 * k / steps) * (last - first)
        if pose is not None:
            data.qpos[plant.object_qpos], data.qvel[plant.object_dof] = pose, 0.0
        mujoco.mj_step(plant.model, data)
        keep()


def _check_there(way: FloatArray, name: str) -> None:
    """Refuse an object that has left the palm on its way (3,), m.

    Raises:
        TaskError: It is far below where it was laid down, or nowhere.
    """
    if not -way[2] <= FALLEN_M:  # refuses what is not finite, too
        raise TaskError(
            f"{name} rolls off the palm at once ({-1e3 * way[2]:.0f} mm down in {SETTLE_S:g} s); "
            "lay it down another way (start_rotation, shift), or lean the palm less (tilt)"
        )
