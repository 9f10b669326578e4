"""Tasks of POMDAR in its own scenes: its screw (C1) turned, two objects (G2, G6) picked up.

https://github.com/srl-ethz/pomdar_benchmark (d077f986; it has no licence and is no part of this
project). Task file, table and options are its own, as its launcher puts them together; in place of
its hand ours is welded to the mocap body, with the palm where its palm is. In simulation it has no
test of success: what counts is the angle of its hinge, and an object that is held 0.1 m higher. Its
screw has no thread either: the motor of its slide is driven so that it advances ``LEAD`` per turn,
as in its own script.

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

from benchmarks.bench import HandOptions
from benchmarks.common import checked_hand
from benchmarks.summary import counted, of, share, summary
from planner import plan_grasp
from planner.errors import FileFormatError, NoGraspFoundError, NotFoundError
from planner.failure import Failure
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.kinematics import HandState
from planner.motion.ending import let_go
from planner.motion.plan import ManipulationPlan
from planner.motion.search import plan_motion
from planner.plan import GraspPlan
from planner.quality import force_closure
from planner.shapes.round import Cylinder
from planner.spatial import SE3, FloatArray, pose_to_wxyz, shifted
from planner.task import Obstacle
from sim.cli.options import names
from sim.controllers import Phase
from sim.controllers.object_impedance import ObjectImpedance
from sim.foreign import ForeignRun, ForeignScene
from sim.manipulation.driver import ManipulationDriver
from sim.tables import Row

SCREW = "C1_Thread"
"""Its name of the task."""

PICKED = {"G2_Sphere": "g10_sphere", "G6_Cylinder_Large": "g1_cylinder"}
"""Tasks in which an object is picked up, and its body."""

PLATE = ("plate", 0.1265, 0.1063, 0.0, 0.0138)
"""What carries these: half widths, bottom and top, m."""

LIFT, PICKED_GRIP, REST = 0.1, 2.0, 500
"""How far it is lifted, m; least planned force of a finger, N; steps until it is at rest."""

MOCAP = "hand_mocap"
"""Its body that carries the hand."""

LEAD = 0.004
"""Advance of its screw per turn, m (its screwing_test.py)."""

STIFFNESS, DAMPING = 1000.0, 20.0
"""Of the thread: N/m, that of its script, and N s/m, about critical for 0.06 kg."""

PALM = np.array([0.339, 0.141, 0.299])
"""Where its palm is (3,), m, world; the fingers point along y, the palm looks down."""

HEAD = 0.0064
"""Radius (m) of the cylinder that is planned for: 6 mm to the faces of the head, 6.8 to corners."""

STANDS_ON = (
    ("table", 0.4, -0.02, 0.0),
    ("foot", 0.0608, 0.0, 0.02),
    ("post", 0.0078, 0.02, 0.0876),
)
"""What stands below the head: half a width, heights of bottom and top, m; boxes about the axis."""

FINGERS = {
    "allegro_hand": ("thumb", "index", "middle"),
    "shadow_hand": ("thumb", "middle", "little"),
}
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
class Options(HandOptions):
    """Seeds count from ``--seed``: of the search, and of where the bolt begins, by 60 degrees."""

    scene: Annotated[Path, typer.Option(help="Checkout of pomdar_benchmark.")]
    tasks: Annotated[str, typer.Option(help="Its names of tasks.")] = ",".join((SCREW, *PICKED))


@dataclass(frozen=True, kw_only=True)
class Checkout:
    """Where POMDAR is; it does not stand in the rows."""

    sim: Path


def cases(options: Options) -> Iterator[Row]:
    """Tasks x hands x seeds."""
    if not (options.scene / "sim/tasks" / f"{SCREW}.xml").is_file():
        raise FileFormatError(f"{options.scene} is no checkout of pomdar_benchmark")
    checkout = Checkout(sim=options.scene.resolve() / "sim")
    for task in names(options.tasks):
        if task not in (SCREW, *PICKED):
            raise NotFoundError("task", task, (SCREW, *PICKED))
        for hand in options.hand_names:
            if task == SCREW and hand not in FINGERS:
                raise NotFoundError("hand with fingers for the screw", hand, FINGERS)
            checked_hand(hand)
            for seed in range(options.seed, options.seed + options.n):
                yield {"task": task, "hand": hand, "seed": seed, "checkout": checkout}


def scene_of(sim: Path, task: str, hand: Hand) -> Any:
    """Its scene of a task, ``mujoco.MjModel``, with our hand on its mocap body (prefix robot/)."""
    launcher = (sim / "launch_mujoco_orca.py").read_text()
    assigned: list[Any] = [p for p in ast.parse(launcher).body if isinstance(p, ast.Assign)]
    template = next(p.value.value for p in assigned if p.targets[0].id == "SCENE_TEMPLATE")
    root = ET.fromstring(template.format(task_rel=f"tasks/{task}.xml"))
    for part in (*root.findall("include[@file='hand/orca_v1.xml']"), *root.findall("equality")):
        root.remove(part)
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


class _Trial:
    """One trial of a task: the hand where its scene mounts one."""

    def __init__(self, sim: Path, task: str, hand: Hand, seed: int) -> None:
        """Put the scene together."""
        self.hand, self.model = hand, scene_of(sim, task, hand)
        self.data = mujoco.MjData(self.model)
        self._rng = np.random.default_rng(seed)
        self._ctrl = [self.model.actuator("robot/" + n).id for n in hand.actuation.names]
        self._hand = [i for i in range(self.model.nbody) if "robot/" in self.model.body(i).name]
        self.hit = False

    def read(self, body: str) -> ForeignScene:
        """Its scene as it is now."""
        mujoco.mj_forward(self.model, self.data)
        self.scene = ForeignScene(
            self.model, self.data, self.hand, body, prefix="robot/", jointed=True
        )
        far = np.linalg.norm(PALM - self.scene.T_world_object.translation)
        self.row: Row = {"hand": self.hand.name, "mount_mm": 1e3 * float(far)}
        return self.scene

    def step(self, T_world_base: SE3, ctrl: FloatArray) -> None:
        """One of its steps."""
        data = self.data
        data.mocap_pos[0], data.mocap_quat[0] = pose_to_wxyz(T_world_base)
        data.ctrl[self._ctrl] = ctrl
        mujoco.mj_step(self.model, data, STEPS)
        self.hit = self.hit or self._hits()

    def run(self, plan: GraspPlan, controller: Any = None) -> ForeignRun:
        """A plan to be executed by its steps."""
        period = STEPS * float(self.model.opt.timestep)
        return ForeignRun(plan, self.scene, self.step, period=period, controller=controller)

    def bring(self, plan: GraspPlan, run: ForeignRun) -> None:
        """The hand from where it is to where the approach begins, from above."""
        start = plan.T_world_base_start
        run.move(shifted(start, [0.0, 0.0, ABOVE]), 1.5, phase="approach")
        run.move(start, 0.7, phase="approach")

    def _hits(self) -> bool:
        """Whether the hand touches anything but the object."""
        pairs = self.model.geom_bodyid[self.data.contact.geom]
        mine = np.isin(pairs, self._hand)
        other = ~mine & (pairs != self.scene.object_body)
        return bool((mine.any(axis=1) & other.any(axis=1)).any())


class _Screwing(_Trial):
    """The screw."""

    def __init__(self, sim: Path, hand: Hand, seed: int) -> None:
        """Put the bolt where it is drawn."""
        super().__init__(sim, SCREW, hand, seed)
        self._hinge, self._slide = (self.data.joint(f"bolt_{n}") for n in ("hinge", "slide"))
        self.first = -self._rng.uniform(0.0, np.pi / 3)
        self._hinge.qpos[0] = self.first
        self._slide.qpos[0] = self._thread
        self._weight = -self.model.body("bolt_body").mass[0] * self.model.opt.gravity[2]
        self.read("bolt_body")
        self._begun = self._planned = float(self._slide.qpos[0])

    @property
    def _thread(self) -> float:
        """Where its slide is to be, m."""
        return -LEAD * float(self._hinge.qpos[0]) / (2.0 * np.pi)

    @property
    def turned(self) -> float:
        """Turn of the screw, degrees."""
        return float(np.rad2deg(self.first - self._hinge.qpos[0]))

    def step(self, T_world_base: SE3, ctrl: FloatArray) -> None:
        """One of its steps, the bolt on its thread."""
        slide = self._slide
        spring = STIFFNESS * (self._thread - slide.qpos[0]) - DAMPING * slide.qvel[0]
        self.data.actuator("slide_bolt_motor").ctrl[0] = spring - self._weight
        super().step(T_world_base, ctrl)

    def plan(self) -> ManipulationPlan:
        """A stroke.

        Raises:
            NoGraspFoundError: There is none.
        """
        self._planned = float(self._slide.qpos[0])
        task = self.scene.task(mu=MU, grip_force=GRIP, fingers=FINGERS[self.hand.name])
        head = replace(task.object, shape=Cylinder(radius=HEAD, height=0.008))
        around = tuple(_box(name, half, half, *z) for name, half, *z in STANDS_ON)
        task = replace(task, object=head, obstacles=around)
        for _ in range(TRIES):
            motion = plan_motion(
                task,
                angle=-np.deg2rad(STROKE[self.hand.name]),
                path_tolerance=0.0005,
                seed=int(self._rng.integers(2**31)),
                max_attempts=60,
            )
            if motion.grasp.T_world_palm.rotation[2] @ task.hand.palm_normal < LOOKS_DOWN:
                break
        angle = motion.planned_angle
        ending = let_go(motion, angle)
        if isinstance(ending, Failure):
            raise NoGraspFoundError(str(ending), ())
        return ManipulationPlan.of(motion, ending, angle=angle, shift=np.zeros(3))

    def stroke(self, plan: ManipulationPlan) -> None:
        """Grasp, turn, open; the palm stays, but goes down with the bolt."""
        driver = self._driver(plan)
        run = self.run(plan.grasp, driver)

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

    def _driver(self, plan: ManipulationPlan) -> ManipulationDriver:
        return ManipulationDriver(plan, ObjectImpedance(plan.grasp), rate=RATE)

    def play(self) -> Row:
        """Turn it by as much as is asked."""
        begin, strokes, plans, poor = time.process_time(), 0, 0, POOR
        whole = STROKE[self.hand.name]
        while self.turned < ASKED and strokes < MOST * ASKED / whole:
            if poor >= POOR:
                plan = self.plan()
                self.bring(plan.grasp, self.run(plan.grasp, self._driver(plan)))
                plans, poor = plans + 1, 0
            before = self.turned
            self.stroke(plan)
            strokes += 1
            poor += self.turned - before < 0.3 * whole
        return {
            "done": self.turned >= ASKED,
            "turned_deg": self.turned,
            "sank_mm": 1e3 * (float(self._slide.qpos[0]) - self._begun),
            "strokes": strokes,
            "plans": plans,
            "cpu_s": time.process_time() - begin,
        }


class _Picking(_Trial):
    """An object that is lifted by ``LIFT`` and held: G2, G6."""

    def __init__(self, sim: Path, task: str, hand: Hand, seed: int) -> None:
        """Let the object come to rest."""
        super().__init__(sim, task, hand, seed)
        mujoco.mj_step(self.model, self.data, REST)
        self.read(PICKED[task])

    def play(self) -> Row:
        """Grasp, lift, hold."""
        begin = time.process_time()
        task = replace(self.scene.task(grip_force=PICKED_GRIP), obstacles=(_box(*PLATE),))
        plan = plan_grasp(task, seed=int(self._rng.integers(2**31)), max_attempts=300)
        run, first = self.run(plan), self.scene.T_world_object.translation[2]
        self.bring(plan, run)
        run.grasp()
        run.move(shifted(plan.T_world_base, [0.0, 0.0, LIFT]), 1.0)
        run.move(run.wanted, 1.0)
        rose, (far, turned) = self.scene.T_world_object.translation[2] - first, run.slip
        held = rose > 0.9 * LIFT and force_closure(run.contacts).closed
        cpu_s = time.process_time() - begin
        return {
            "done": bool(held),
            "rose_mm": 1e3 * float(rose),
            "slip_mm": far,
            "slip_deg": turned,
            "cpu_s": cpu_s,
        }


def _box(name: str, x: float, y: float, bottom: float, top: float) -> Obstacle:
    """A box about the vertical axis, by half its width and by its heights, m."""
    place = SE3(np.eye(3), np.array([0.0, 0.0, (top + bottom) / 2]))
    return Obstacle(name=name, size=np.array([2 * x, 2 * y, top - bottom]), T_world_obstacle=place)


def measure(case: Row) -> Row:
    """One trial."""
    sim, task, seed = case["checkout"].sim, case["task"], case["seed"]
    hand = load_hand(case["hand"])
    trial = _Screwing(sim, hand, seed) if task == SCREW else _Picking(sim, task, hand, seed)
    row = {"task": task, "seed": seed, **trial.row}
    try:
        row |= trial.play()
    except NoGraspFoundError as error:
        return {**row, "done": False, "ended": "no plan", "detail": str(error)[:200]}
    row |= {"hit": trial.hit, "simulated_s": float(trial.data.time)}
    return {**row, "ended": "done" if row["done"] else "not done"}


def tables(result: Row) -> Iterator[Row]:
    """One line per task and hand."""
    yield summary(
        "POMDAR: C1 turned by 720 degrees, others lifted by 0.1 m and held",
        result["rows"],
        ("task", "hand"),
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
