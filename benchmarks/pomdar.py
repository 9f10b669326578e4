"""POMDAR's screw (C1) in its own scene: turned by the fingers of a hand on its mocap body.

https://github.com/srl-ethz/pomdar_benchmark (d077f986; it has no licence and is no part of this
project). Task file, table and options are its own, as its launcher puts them together; in place of
its hand ours is welded to the mocap body, with the palm where its palm is. Its scene has no test of
success: what counts is the angle of its hinge, by its own sensor. Its screw has no thread either:
the motor of its slide is driven so that it advances ``LEAD`` per turn, as in its own script.

Each stroke is a grasp of the head by three fingers and a turn in the hand, planned for a cylinder
as wide as the head on average; then the fingers open and go back. The palm stands still above the
bolt, but for following the thread.
"""

from __future__ import annotations

import ast
import time
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Annotated, Any

import mujoco
import numpy as np
import typer

from benchmarks.bench import Options as BenchOptions
from benchmarks.summary import counted, of, share, summary
from planner.errors import FileFormatError, NoGraspFoundError
from planner.failure import Failure
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.kinematics import HandState
from planner.motion.ending import find_release, object_at_target
from planner.motion.plan import Ending, ManipulationPlan
from planner.motion.search import plan_motion
from planner.shapes.round import Cylinder
from planner.spatial import SE3, FloatArray, pose_to_wxyz, shifted
from sim.cli.options import names
from sim.controllers import Observation
from sim.controllers.object_impedance import ObjectImpedance
from sim.foreign import ForeignRun, ForeignScene
from sim.manipulation.driver import ManipulationDriver
from sim.tables import Row

BOLT, HINGE, SLIDE, MOTOR, MOCAP = (
    "bolt_body",
    "bolt_hinge",
    "bolt_slide",
    "slide_bolt_motor",
    "hand_mocap",
)
"""Names in its scene."""

LEAD = 0.004
"""Advance of its screw per turn, m (its screwing_test.py)."""

STIFFNESS, DAMPING = 1000.0, 20.0
"""Of the thread: N/m, that of its script, and N s/m, about critical for 0.06 kg."""

PALM = np.array([0.339, 0.141, 0.299])
"""Where its palm is (3,), m, world; the fingers point along y, the palm looks down."""

HEAD = 0.0064
"""Radius (m) of the cylinder that is planned for: 6 mm to the faces of the head, 6.8 to corners."""

FINGERS = {"allegro_hand": ("thumb", "index", "middle"), "shadow_hand": ("thumb", "index", "little")}
"""Which turn the bolt: neighbouring tips of 16 mm are too near each other on a head of 12 mm."""

STROKE = {"allegro_hand": 60.0, "shadow_hand": 30.0}
"""Turn in the hand of a stroke, degrees."""

GRIP, MU = 1.0, 0.8
"""Least planned force (N) of a finger, and friction relied on (-): its scene has 1."""

ASKED, MOST = 720.0, 2.5
"""Turn of the screw, degrees, and most times as many strokes as that takes."""


@dataclass(frozen=True, kw_only=True)
class Options(BenchOptions):
    """Seeds count from ``--seed``: start of the bolt within a sixth of a turn, and of the search."""

    scene: Annotated[Path, typer.Option(help="Checkout of pomdar_benchmark.")]
    hands: Annotated[str, typer.Option(help="Names of hands.")] = ",".join(FINGERS)


def cases(options: Options) -> Iterator[Row]:
    """Hands x seeds."""
    if not (options.scene / "sim/tasks/C1_Thread.xml").is_file():
        raise FileFormatError(f"{options.scene} is no checkout of pomdar_benchmark")
    for hand in names(options.hands):
        for seed in range(options.seed, options.seed + options.n):
            yield {"hand": hand, "seed": seed, "folder": str(options.scene.resolve())}


def scene_of(sim: Path, task: str, hand: Hand) -> Any:
    """Its scene of a task, ``mujoco.MjModel``, with our hand on its mocap body (prefix robot/)."""
    launcher = ast.parse((sim / "launch_mujoco_orca.py").read_text())
    template = next(
        part.value.value
        for part in launcher.body
        if isinstance(part, ast.Assign) and part.targets[0].id == "SCENE_TEMPLATE"
    )
    root = ET.fromstring(template.format(task_rel=f"tasks/{task}.xml"))
    root.remove(root.find("include[@file='hand/orca_v1.xml']"))
    root.remove(root.find("equality"))
    with NamedTemporaryFile("w", suffix=".xml", dir=sim) as file:  # as its launcher does
        file.write(ET.tostring(root, encoding="unicode"))
        file.flush()
        spec = mujoco.MjSpec.from_file(file.name)
    normal, ahead = hand.palm_normal, np.array([0.0, 0.0, 1.0])
    own = np.column_stack([normal, ahead, np.cross(normal, ahead)])
    there = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    palm = SE3(there @ own.T, PALM)
    place, turn = pose_to_wxyz(palm * HandState(hand, np.zeros(hand.nq)).T_base_palm.inverse())
    frame = spec.worldbody.add_frame(pos=place, quat=turn)
    spec.attach(hand.new_spec(), frame=frame, prefix="robot/")
    spec.body("robot/" + hand.description.base_body).add_freejoint()
    spec.body(MOCAP).pos, spec.body(MOCAP).quat = place, turn
    weld = spec.add_equality(
        type=mujoco.mjtEq.mjEQ_WELD, name1=MOCAP, name2="robot/" + hand.description.base_body
    )
    weld.objtype = mujoco.mjtObj.mjOBJ_BODY
    weld.data = [*(0.0,) * 10, 1.0, 0.0]
    weld.solref, weld.solimp = (0.005, 1.0), (0.97, 0.99, 0.0005, 0.5, 2.0)  # those of its weld
    return spec.compile()


class _Screwing:
    """One trial."""

    def __init__(self, sim: Path, hand: Hand, seed: int) -> None:
        """Put the bolt where it is drawn, and the hand where its scene mounts one."""
        self.model = scene_of(sim, "C1_Thread", hand)
        self.data = mujoco.MjData(self.model)
        self._hinge, self._slide = (self.data.joint(name) for name in (HINGE, SLIDE))
        self._rng = np.random.default_rng(seed)
        self.first = -self._rng.uniform(0.0, np.pi / 3)
        self._hinge.qpos[0] = self.first
        self._slide.qpos[0] = self._thread
        mujoco.mj_forward(self.model, self.data)
        self._weight = -self.model.body(BOLT).mass[0] * self.model.opt.gravity[2]
        self.scene = ForeignScene(
            self.model, self.data, hand, BOLT, prefix="robot/", jointed=True
        )
        names = hand.actuation.names
        self._ctrl = [self.model.actuator("robot/" + name).id for name in names]
        self._begun = float(self._slide.qpos[0])

    @property
    def _thread(self) -> float:
        """Where its slide is to be, m."""
        return -LEAD * float(self._hinge.qpos[0]) / (2.0 * np.pi)

    @property
    def turned(self) -> float:
        """Turn of the screw, degrees."""
        return float(np.rad2deg(self.first - self._hinge.qpos[0]))

    def step(self, T_world_base: SE3, ctrl: FloatArray) -> None:
        """One of its steps."""
        data, slide = self.data, self._slide
        data.mocap_pos[0], data.mocap_quat[0] = pose_to_wxyz(T_world_base)
        data.ctrl[self._ctrl] = ctrl
        spring = STIFFNESS * (self._thread - slide.qpos[0]) - DAMPING * slide.qvel[0]
        data.actuator(MOTOR).ctrl[0] = spring - self._weight
        mujoco.mj_step(self.model, data)

    def plan(self, hand: str) -> ManipulationPlan:
        """A stroke.

        Raises:
            NoGraspFoundError: There is none.
        """
        task = self.scene.task(mu=MU, grip_force=GRIP, fingers=FINGERS[hand])
        head = replace(task.object, shape=Cylinder(radius=HEAD, height=0.008))
        task = replace(task, object=head)
        motion = plan_motion(
            task,
            angle=-np.deg2rad(STROKE[hand]),
            path_tolerance=0.002,
            seed=int(self._rng.integers(2**31)),
            max_attempts=60,
        )
        release = find_release(motion)
        if isinstance(release, Failure):
            raise NoGraspFoundError(str(release), ())
        angle = motion.planned_angle
        target = object_at_target(task, motion.path.axis, angle, None)
        ending = Ending(T_world_target=target, release=release, back="")
        return ManipulationPlan.of(motion, ending, angle=angle, shift=np.zeros(3))

    def stroke(self, plan: ManipulationPlan) -> ForeignRun:
        """Grasp, turn, open."""
        driver = ManipulationDriver(plan, ObjectImpedance(plan.grasp), rate=1.5)
        period = float(self.model.opt.timestep)
        run = ForeignRun(plan.grasp, self.scene, self.step, period=period, controller=driver)

        def at(pose: SE3) -> SE3:  # the bolt goes down
            return shifted(pose, [0.0, 0.0, self._begun - float(self._slide.qpos[0])])

        if self.turned < 1.0:
            run.move(at(plan.grasp.T_world_base_start), 1.5, phase="approach")
        for phase, duration in (("approach", 0.4), ("close", 0.4), ("squeeze", 0.3)):
            run.move(at(plan.T_world_base), duration, wait=0.1, phase=phase)
        driver.begin_stroke(plan.angle)

        def made(_: Observation) -> bool:
            return bool(driver.reference.left <= np.deg2rad(1.0))

        run.move(at(plan.T_world_base), abs(plan.angle) / 1.5, wait=0.6, phase="turn", until=made)
        run.move(at(plan.T_world_base), 0.4, phase="open")
        return run
