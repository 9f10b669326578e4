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
from planner.task import Obstacle
from sim.cli.options import names
from sim.controllers import Phase
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

STANDS_ON = (("table", 0.4, -0.02, 0.0), ("foot", 0.0608, 0.0, 0.02), ("post", 0.0078, 0.02, 0.0876))
"""What stands below the head: half a width, heights of bottom and top, m; boxes about the axis."""

FINGERS = {"allegro_hand": ("thumb", "index", "middle"), "shadow_hand": ("thumb", "middle", "little")}
"""Which turn the bolt: neighbouring tips of 16 mm are too near each other on a head of 12 mm."""

STROKE = {"allegro_hand": 60.0, "shadow_hand": 45.0}
"""Turn in the hand of a stroke, degrees."""

GRIP, MU = 1.0, 0.8
"""Least planned force (N) of a finger, and friction relied on (-): its scene has 1."""

RATE = 1.5
"""Rate of a stroke, rad/s."""

GRASPING: dict[Phase, float] = {"approach": 0.25, "close": 0.3, "squeeze": 0.25}
"""Phases before a stroke, s."""

TRIES, LOOKS_DOWN = 10, -0.5
"""Plans that are made until the palm looks down, and most vertical part (-) of its normal."""

ABOVE = 0.15
"""How far (m) above where an approach begins the hand comes from its mount."""

STEPS = 2
"""Steps of its 2 ms per command."""

ASKED, MOST, POOR = 720.0, 2.5, 2
"""Turn of the screw, degrees; most times as many strokes as that takes (-); and strokes of less
than 30 % of what was planned after which a plan is made anew."""


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
        self._hand = [i for i in range(self.model.nbody) if "robot/" in self.model.body(i).name]
        self.hit = False
        self._begun = self._planned = float(self._slide.qpos[0])

    @property
    def _thread(self) -> float:
        """Where its slide is to be, m."""
        return -LEAD * float(self._hinge.qpos[0]) / (2.0 * np.pi)

    @property
    def turned(self) -> float:
        """Turn of the screw, degrees."""
        return float(np.rad2deg(self.first - self._hinge.qpos[0]))

    @property
    def sank(self) -> float:
        """How far it has gone in, m."""
        return float(self._slide.qpos[0]) - self._begun

    def step(self, T_world_base: SE3, ctrl: FloatArray) -> None:
        """One of its steps."""
        data, slide = self.data, self._slide
        data.mocap_pos[0], data.mocap_quat[0] = pose_to_wxyz(T_world_base)
        data.ctrl[self._ctrl] = ctrl
        spring = STIFFNESS * (self._thread - slide.qpos[0]) - DAMPING * slide.qvel[0]
        data.actuator(MOTOR).ctrl[0] = spring - self._weight
        mujoco.mj_step(self.model, data, STEPS)
        self.hit = self.hit or self._hits()

    def plan(self, hand: str) -> ManipulationPlan:
        """A stroke.

        Raises:
            NoGraspFoundError: There is none.
        """
        self._planned = float(self._slide.qpos[0])
        task = self.scene.task(mu=MU, grip_force=GRIP, fingers=FINGERS[hand])
        head = replace(task.object, shape=Cylinder(radius=HEAD, height=0.008))
        around = [
            Obstacle(
                name=name,
                size=(2 * half, 2 * half, top - bottom),
                T_world_obstacle=SE3(np.eye(3), np.array([0.0, 0.0, (top + bottom) / 2])),
            )
            for name, half, bottom, top in STANDS_ON
        ]
        task = replace(task, object=head, obstacles=tuple(around))
        for _ in range(TRIES):
            motion = plan_motion(
                task,
                angle=-np.deg2rad(STROKE[hand]),
                path_tolerance=0.0005,
                seed=int(self._rng.integers(2**31)),
                max_attempts=60,
            )
            if motion.grasp.T_world_palm.rotation[2] @ task.hand.palm_normal < LOOKS_DOWN:
                break
        release = find_release(motion)
        if isinstance(release, Failure):
            raise NoGraspFoundError(str(release), ())
        angle = motion.planned_angle
        target = object_at_target(task, motion.path.axis, angle, None)
        ending = Ending(T_world_target=target, release=release, back="")
        return ManipulationPlan.of(motion, ending, angle=angle, shift=np.zeros(3))

    def bring(self, plan: ManipulationPlan) -> None:
        """The hand from where it is mounted to where the approach begins, from above."""
        start, run = plan.grasp.T_world_base_start, self._run(plan)
        run.move(shifted(start, [0.0, 0.0, ABOVE]), 1.5, phase="approach")
        run.move(start, 0.7, phase="approach")

    def stroke(self, plan: ManipulationPlan) -> None:
        """Grasp, turn, open; the palm stays, but goes down with the bolt."""
        run = self._run(plan)
        driver = run.controller
        assert isinstance(driver, ManipulationDriver)

        def phase(name: Phase, duration: float, **until: Any) -> None:
            down = self._planned - float(self._slide.qpos[0])
            run.move(shifted(plan.T_world_base, [0.0, 0.0, down]), duration, phase=name, **until)

        for name, duration in GRASPING.items():
            phase(name, duration)
        driver.begin_stroke(plan.angle)
        phase(
            "turn",
            abs(plan.angle) / RATE,
            wait=0.6,
            until=lambda _: bool(driver.reference.left <= np.deg2rad(1.0)),
        )
        phase("open", 0.3)

    def _run(self, plan: ManipulationPlan) -> ForeignRun:
        driver = ManipulationDriver(plan, ObjectImpedance(plan.grasp), rate=RATE)
        period = STEPS * float(self.model.opt.timestep)
        return ForeignRun(plan.grasp, self.scene, self.step, period=period, controller=driver)

    def _hits(self) -> bool:
        """Whether the hand touches anything but the bolt."""
        pairs = self.model.geom_bodyid[self.data.contact.geom]
        mine = np.isin(pairs, self._hand)
        other = ~mine & (pairs != self.scene.object_body)
        return bool((mine.any(axis=1) & other.any(axis=1)).any())


def measure(case: Row) -> Row:
    """Turn the screw once."""
    hand = load_hand(case["hand"])
    trial = _Screwing(Path(case["folder"]) / "sim", hand, case["seed"])
    far = float(np.linalg.norm(PALM - trial.scene.T_world_object.translation))
    row: Row = {"hand": hand.name, "seed": case["seed"], "mount_mm": 1e3 * far}
    begin, strokes, plans, poor = time.process_time(), 0, 0, POOR
    most = MOST * ASKED / STROKE[hand.name]
    while trial.turned < ASKED and strokes < most:
        if poor >= POOR:
            try:
                plan = trial.plan(hand.name)
            except NoGraspFoundError as error:
                return {**row, "done": False, "ended": "no plan", "detail": str(error)[:200]}
            trial.bring(plan)
            plans, poor = plans + 1, 0
        before = trial.turned
        trial.stroke(plan)
        strokes += 1
        poor += trial.turned - before < 0.3 * STROKE[hand.name]
    return {
        **row,
        "done": trial.turned >= ASKED,
        "ended": "done" if trial.turned >= ASKED else "not turned",
        "turned_deg": trial.turned,
        "sank_mm": 1e3 * trial.sank,
        "strokes": strokes,
        "plans": plans,
        "hit": trial.hit,
        "simulated_s": float(trial.data.time),
        "cpu_s": time.process_time() - begin,
    }


def tables(result: Row) -> Iterator[Row]:
    """One line per hand."""
    yield summary(
        "POMDAR's screw C1, turned by 720 degrees",
        result["rows"],
        ("hand",),
        {
            "done": share("done"),
            "turned, degrees, least": of("turned_deg", "min", digits=0),
            "strokes": of("strokes"),
            "simulated, s": of("simulated_s", digits=0),
            "touched other things": share("hit"),
            "CPU, s": of("cpu_s", digits=0),
            "ended": counted("ended"),
        },
    )
