"""Starts of holds: candidate i of a cell is a function of the seed, the cell and i alone.

``StatesAsked``: what is asked of a cache of states, and the draws that make them differ.

A *cell* is one object in one size. Its name names its files.

Where states begin: planned grasps, turns and gaits as poses with commands that press.

A source holds the object with the planned forces of ``plan_squeeze``. Its commands are linear in
the squeeze: ``rest + s (press - rest)``, where ``rest`` are the commands that exert nothing there.
Poses are in the frame of the hand's base, which is the world of the scene
(``sim.datasets.reset_states.hold``).
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from planner.arrays import check_fields, checked_count
from planner.batch.pool import end_with
from planner.batch.recipe import recipe_of, task_of
from planner.contacts import MOST_FRICTION, ContactSet
from planner.errors import NoGraspFoundError, ObjectError, PlannerError, TaskError
from planner.exchange.dexgraspbench.export import plan_squeeze, without_servos
from planner.files import write_json
from planner.files.disk import plain_name, whole_file
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.motion import MovementPlan, plan_motion
from planner.motion.gait import plan_gait
from planner.numerics.kernels import compiled_searches
from planner.objects import GraspObject, parse_object
from planner.search.grasp import plan_grasp
from planner.shapes import Mesh, Shape, shape_from_dict, shape_to_dict
from planner.spatial import SE3, FloatArray, IntArray, pose_to_wxyz
from planner.task import GraspTask
from sim.datasets.reset_states.hold import SCENE_FILE, HoldScene, load_scene
from sim.scene.physics import PhysicsOptions

G = 9.81
"""Gravity, m/s2."""

SCALES = (0.01, 100.0)
"""Range of a size relative to the given one (-)."""

MOST_STATES = 10_000_000
"""Most states of a cell: 1 GB of rows of a 16-joint hand."""

MOST_PLANS = 100_000
"""Most plans of one kind and cell."""


@dataclass(frozen=True, kw_only=True)
class Draws:
    """From what the start of a hold is drawn; everything about a planned pose and its commands.

    Attributes:
        position: Standard deviation of the object's offset along each axis, m.
        angle: Standard deviation of its rotation vector along each axis, rad.
        joints: Standard deviation of each finger joint and of its target, rad (m for slides).
        squeeze: Least and greatest factor of the planned squeeze (-), uniform in its logarithm.
        friction: Least and greatest sliding friction (-), uniform.
        mass: Least and greatest mass, kg, uniform; None for 0.5 to 1.5 times the object's.
        gravity: Direction (3,) in the frame of the hand's base; None for one drawn evenly from the
            sphere.
    """

    position: float = 0.002
    angle: float = 0.08
    joints: float = 0.04
    squeeze: tuple[float, float] = (1.0, 2.0)
    friction: tuple[float, float] = (0.6, 1.2)
    mass: tuple[float, float] | None = None
    gravity: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        """Check every number."""
        check_fields(self, ("position", "angle", "joints"), what="draws: ", least=0.0)
        check_fields(self, ("squeeze", "friction", "mass"), what="draws: ", above=0.0)
        check_fields(self, ("gravity",), what="draws: ")
        for name in ("squeeze", "friction", "mass"):
            pair = getattr(self, name)
            if pair is not None and not pair[0] <= pair[1]:
                raise TaskError(
                    f"{name} is drawn from {pair[0]:g} to {pair[1]:g}; give two finite numbers > "
                    "0, the smaller one first"
                )
        if self.gravity is not None and not np.linalg.norm(self.gravity) > 0:
            raise TaskError('gravity has no direction; give one, such as -1,0,0, or "random"')


@dataclass(frozen=True, kw_only=True)
class StatesAsked:
    """What is asked for.

    Attributes:
        hand: What ``load_hand`` takes.
        objects: Specifications as ``parse_object`` takes them.
        n: States of every object and size.
        seed: Same seed, same states.
        scales: Sizes relative to the specification (-).
        grasps: Grasps that are planned per object and size.
        motions: Turns that are planned, each of about seven verified poses.
        gaits: Gaits that are planned.
        turn: Angle of a turn, rad; a gait's is twice that.
        fingers: Names of those that take part; all that the hand can use if empty.
        mu: Friction that planning relies on (-).
        draws: From what the start of a hold is drawn.
        physics: How MuJoCo computes, here and in the scene that is written.
    """

    hand: str
    objects: tuple[str, ...]
    n: int
    seed: int = 0
    scales: tuple[float, ...] = (1.0,)
    grasps: int = 200
    motions: int = 30
    gaits: int = 4
    turn: float = float(np.pi / 6)
    fingers: tuple[str, ...] = ()
    mu: float = 0.5
    draws: Draws = field(default_factory=Draws)
    physics: PhysicsOptions = field(default_factory=PhysicsOptions)

    def __post_init__(self) -> None:
        """Check counts and sizes; what concerns hand and objects is found out by planning."""
        counts = (("n", 1, MOST_STATES), ("seed", 0, 2**63 - 1))
        for name, least, most in counts:
            checked_count(name, getattr(self, name), least=least, most=most, error=TaskError)
        for name in ("grasps", "motions", "gaits"):
            checked_count(name, getattr(self, name), least=0, most=MOST_PLANS, error=TaskError)
        if self.grasps + self.motions + self.gaits == 0:
            raise TaskError("no grasps, motions or gaits are to be planned; ask for some of them")
        if not self.objects:
            raise TaskError("there are no objects; name at least one")
        if not self.scales:
            raise TaskError("there are no scales; give at least one")
        check_fields(self, ("scales",), least=SCALES[0], most=SCALES[1])
        check_fields(self, ("turn",), unit="rad")
        check_fields(self, ("mu",), least=0.0, most=MOST_FRICTION)
        if not 0 < abs(self.turn) <= np.pi:
            raise TaskError(f"turn is {np.degrees(self.turn):g} degrees; give up to 180, not 0")

    def to_dict(self) -> dict[str, Any]:
        """As plain data that a file keeps; n is left out, since more states of it may follow."""
        data = asdict(replace(self, physics=PhysicsOptions()))
        data.pop("n")
        return json_plain(data | {"physics": self.physics.to_dict()})


def json_plain(data: dict[str, Any]) -> dict[str, Any]:
    """Data as it comes back from JSON: tuples are lists."""
    plain: dict[str, Any] = json.loads(json.dumps(data))
    return plain


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One object in one size.

    Attributes:
        name: Name of its files.
        object: Its specification.
        scale: Its size relative to that (-).
        recipe: Its task as text: without a table, so that grasps come from all sides.
        mass: Mass that its scene has, kg.
        number: 32 bits out of the shape that its draws depend on, beside the seed.
    """

    name: str
    object: str
    scale: float
    recipe: str
    mass: float
    number: int


def cells_of(asked: StatesAsked) -> tuple[Hand, list[tuple[Cell, GraspTask]]]:
    """The hand and every object in every size, with its task.

    Raises:
        PlannerError: Hand or object cannot be loaded, two objects have one name, or the hand cannot
            be commanded by positions or hangs on an arm.
    """
    hand = load_hand(asked.hand)
    if reason := without_servos(hand):
        raise TaskError(
            f"{reason}; states are held by position targets: give a hand with position servos"
        )
    hand.require_one("a dataset of states")
    if hand.arm is not None:
        raise TaskError(
            f"{hand.name} hangs on an arm; states are those of a hand on a fixed base: give the "
            "hand alone"
        )
    cells: list[tuple[Cell, GraspTask]] = []
    for spec in asked.objects:
        given = parse_object(spec)
        for scale in asked.scales:
            item = scaled(given, scale)
            task = GraspTask.create(
                hand, item, table_height=None, mu=asked.mu, fingers=asked.fingers or None
            )
            label = given.shape.spec if given.name == given.shape.kind else given.name
            name = plain_name(f"{label}-s{scale:g}")
            if any(cell.name == name for cell, _ in cells):
                raise ObjectError(f"two objects are called {name}; give each object and size once")
            recipe = recipe_of(task)
            number = int(hashlib.sha256(recipe.encode()).hexdigest()[:8], 16)
            cell = Cell(
                name=name, object=spec, scale=scale, recipe=recipe, mass=item.mass, number=number
            )
            cells.append((cell, task))
    return hand, cells


def scaled(item: GraspObject, scale: float) -> GraspObject:
    """The object with all lengths multiplied; its mass stays.

    Raises:
        ObjectError: The result is too small or too large for a shape.
    """
    if scale == 1.0:
        return item
    return replace(item, shape=_scaled_shape(item.shape, scale))


def _scaled_shape(shape: Shape, scale: float) -> Shape:
    if type(shape) is Mesh:  # not a shape that is made of triangles by its sizes
        if shape.source is None:
            return Mesh.from_triangles(shape.vertices * scale, shape.faces)
        source = shape.source
        return Mesh.load(source.path, scale=source.scale * scale, repair=source.repair)
    data = {
        key: _times(value, scale) if key.endswith("_m") else value
        for key, value in shape_to_dict(shape).items()
    }
    return shape_from_dict(data)


def _times(value: Any, scale: float) -> Any:
    return [v * scale for v in value] if isinstance(value, list) else value * scale


KINDS = ("grasp", "motion", "gait")
"""What a source is from."""

MOTION_ATTEMPTS = 6
"""Attempts per motion or gait: another plan with another seed follows anyway, and a gait that is
not found costs up to 3 s."""


@dataclass(frozen=True, kw_only=True)
class Source:
    """A planned pose of the object in the hand; lists instead of arrays, as it is kept in a file.

    Attributes:
        kind: What it is from, one of ``KINDS``.
        plan: Number of its plan among those of its kind.
        pose: Number of the pose along that plan, from 0.
        fingers: Names of the fingers that hold.
        q: Joints (nq,), rad or m.
        position: Of the object's centre of mass (3,) in the hand's base, m.
        quaternion: Its orientation there, w, x, y, z.
        rest: Commands (nu,) that exert nothing.
        press: Commands (nu,) of the planned squeeze.
    """

    kind: str
    plan: int
    pose: int
    fingers: tuple[str, ...]
    q: list[float]
    position: list[float]
    quaternion: list[float]
    rest: list[float]
    press: list[float]

    def to_dict(self) -> dict[str, Any]:
        """As plain data."""
        return asdict(self)


@dataclass(frozen=True, kw_only=True)
class PlanJob:
    """One plan that is to be made, as it is sent to a worker.

    Attributes:
        recipe: The task as text.
        kind: What is planned, one of ``KINDS``.
        k: Number of the plan among those of its kind.
        seed: Seed of its search.
        turn: Angle of a turn, rad.
        parent: Process that asked for it.
    """

    recipe: str
    kind: str
    k: int
    seed: int
    turn: float
    parent: int

    @property
    def key(self) -> str:
        """What names it in a journal."""
        return f"{self.kind} {self.k}"


def plan_jobs(asked: StatesAsked, cell: Cell) -> Iterator[PlanJob]:
    """The plans of a cell; the seed of each depends on seed, cell, kind and number alone."""
    for number, (kind, count) in enumerate(
        zip(KINDS, (asked.grasps, asked.motions, asked.gaits), strict=True)
    ):
        for k in range(count):
            words = np.random.SeedSequence([asked.seed, cell.number, number, k])
            seed = int(words.generate_state(1, np.uint64)[0] >> np.uint64(1))
            yield PlanJob(
                recipe=cell.recipe, kind=kind, k=k, seed=seed, turn=asked.turn, parent=os.getpid()
            )


def planned_sources(job: PlanJob) -> dict[str, Any]:
    """Make a plan: its sources, or the reason why there are none, under the job's key."""
    end_with(job.parent)
    task = task_of(job.recipe)
    try:
        with compiled_searches():  # one plan of many
            found = list(_sources(job, task))
    except NoGraspFoundError as error:
        return {"key": job.key, "reason": str(error).splitlines()[0], "sources": []}
    except PlannerError as error:
        return {"key": job.key, "reason": str(error), "sources": []}
    reason = "" if found else "the servos cannot press as planned"
    return {"key": job.key, "reason": reason, "sources": [s.to_dict() for s in found]}


def _sources(job: PlanJob, task: GraspTask) -> Iterator[Source]:
    rng = np.random.default_rng(job.seed)
    axis = rng.normal(size=3)
    if job.kind == "grasp":
        plan = plan_grasp(task, seed=job.seed)
        yield from _pose(
            job, 0, plan.task, plan.contacts, plan.T_world_base, plan.q, task.T_world_object
        )
    elif job.kind == "motion":
        # every second turn is about the object's own axis, where round objects roll best
        axis = axis if job.k % 2 else np.array([0.0, 0.0, 1.0])
        turn = job.turn if job.k % 4 < 2 else -job.turn
        motion = plan_motion(
            task, axis=axis, angle=turn, seed=job.seed, max_attempts=MOTION_ATTEMPTS
        )
        yield from _knots(job, motion)
    else:
        gait = plan_gait(
            task,
            axis=(0.0, 0.0, 1.0),
            angle=2.0 * job.turn,
            seed=job.seed,
            max_attempts=MOTION_ATTEMPTS,
        )
        yield from _knots(job, gait)
        own, number = gait.task, len(gait.knots)
        for move in gait.regrasps:  # later cycles repeat the postures
            number += 1
            q = move.postures[len(move.postures) // 2]
            less = own.with_fingers(move.during.fingers)
            T_base = gait.T_world_base
            yield from _pose(job, number, less, move.during, T_base, q, move.T_world_object)


def _knots(job: PlanJob, motion: MovementPlan) -> Iterator[Source]:
    for number, knot in enumerate(motion.knots):
        yield from _pose(
            job,
            number,
            motion.grasp.task,
            knot.contacts,
            motion.T_world_base,
            knot.q,
            knot.T_world_object,
        )


def _pose(
    job: PlanJob,
    number: int,
    task: GraspTask,
    contacts: ContactSet,
    T_world_base: SE3,
    q: FloatArray,
    T_world_object: SE3,
) -> Iterator[Source]:
    """The source of one pose, if the servos can press there."""
    squeeze = plan_squeeze(task, contacts, T_world_base, q)
    if squeeze.reason:
        return
    rest, _ = task.hand.actuation.ctrl_for_torque(q, np.zeros_like(q), np.zeros_like(q))
    position, quaternion = pose_to_wxyz(T_world_base.inverse() * T_world_object)
    yield Source(
        kind=job.kind,
        plan=job.k,
        pose=number,
        fingers=tuple(contacts.fingers),
        q=q.tolist(),
        position=position.tolist(),
        quaternion=quaternion.tolist(),
        rest=rest.tolist(),
        press=squeeze.ctrl.tolist(),
    )


CELL_FILE, SOURCES_FILE = "cell.json", "sources.npz"
"""Files that a worker needs beside the scene; both in the folder ``WORK``."""

WORK = "work"
"""Folder of a cell for what a resumed run needs."""

_COLUMNS = ("q", "position", "quaternion", "rest", "press")


@dataclass(frozen=True, kw_only=True, eq=False)
class Start:
    """The start of a hold.

    Attributes:
        source: Row of the source.
        q: Joints (nq,), rad or m.
        commands: Position commands (nu,), within the actuators' ranges.
        position: Of the object (3,) in the hand's base, m.
        quaternion: Its orientation, w, x, y, z.
        gravity: (3,), m/s2, in the hand's base.
        mass: kg.
        friction: Sliding friction (-).
    """

    source: int
    q: FloatArray
    commands: FloatArray
    position: FloatArray
    quaternion: FloatArray
    gravity: FloatArray
    mass: float
    friction: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Starts:
    """From what the starts of a cell are drawn, and the scene in which they are held.

    Attributes:
        seed: Seed of the states.
        number: Number of the cell.
        draws: The draws.
        mass: Least and greatest mass, kg.
        sources: Columns of the sources by name, a row each.
        lower: (nq,), lower joint limits.
        upper: (nq,), upper joint limits.
        ctrl_range: (nu, 2), ranges of the commands.
        moment: (nu, nq), lengths of the actuators per joint.
        still: (nq,), 0 for joints of the wrist, which are not perturbed, else 1.
        scene: The scene.
    """

    seed: int
    number: int
    draws: Draws
    mass: tuple[float, float]
    sources: dict[str, Any]
    lower: FloatArray
    upper: FloatArray
    ctrl_range: FloatArray
    moment: FloatArray
    still: FloatArray
    scene: HoldScene

    def draw(self, index: int) -> Start:
        """Candidate ``index``."""
        rng = np.random.default_rng([self.seed, self.number, index])
        draws, sources = self.draws, self.sources
        row = int(rng.integers(len(sources["q"])))
        q, rest = sources["q"][row], sources["rest"][row]
        offset = rng.normal(size=len(q)) * draws.joints * self.still
        squeeze = float(np.exp(rng.uniform(*np.log(draws.squeeze))))
        commands = rest + squeeze * (sources["press"][row] - rest) + self.moment @ offset
        turn = rng.normal(size=3) * draws.angle
        place = sources["position"][row] + rng.normal(size=3) * draws.position
        drawn = rng.normal(size=3)  # drawn anyway, so that what follows does not depend on it
        down = drawn if draws.gravity is None else np.array(draws.gravity)
        return Start(
            source=row,
            q=np.clip(q + offset, self.lower, self.upper),
            commands=np.clip(commands, *self.ctrl_range.T),
            position=place,
            quaternion=_turned(sources["quaternion"][row], turn),
            gravity=G * down / np.linalg.norm(down),
            mass=float(rng.uniform(*self.mass)),
            friction=float(rng.uniform(*draws.friction)),
        )

    def put(self, start: Start) -> None:
        """Put a start into the scene."""
        self.scene.draw(start.mass, start.friction, start.gravity)
        self.scene.put(start.q, start.position, start.quaternion, start.commands)


def _turned(quaternion: FloatArray, turn: FloatArray) -> FloatArray:
    """An orientation (w, x, y, z), turned by a rotation vector (3,) in the object's own axes."""
    angle = float(np.linalg.norm(turn))
    w, v = np.cos(angle / 2), np.sinc(angle / (2 * np.pi)) / 2 * turn
    w0, v0 = quaternion[0], quaternion[1:]
    out: FloatArray = np.concatenate([[w0 * w - v0 @ v], w0 * v + w * v0 + np.cross(v0, v)])
    return out


def write_cell(
    asked: StatesAsked, cell: Cell, hand: Hand, sources: list[dict[str, Any]], folder: Path
) -> None:
    """Write what workers need to hold the starts of a cell.

    Args:
        asked: What is asked for.
        cell: The cell.
        hand: The hand.
        sources: Sources as plain data, at least one.
        folder: Folder of the cell; its scene is there.
    """
    still = np.ones(hand.nq)
    still[hand.wrist_index] = 0.0
    low, high = asked.draws.mass or (0.5 * cell.mass, 1.5 * cell.mass)
    data = {
        "seed": asked.seed,
        "number": cell.number,
        "draws": asked.to_dict()["draws"],
        "mass": [low, high],
        "lower": hand.q_lower.tolist(),
        "upper": hand.q_upper.tolist(),
        "ctrl_range": hand.actuation.ctrl_range.tolist(),
        "moment": hand.actuation.moment.tolist(),
        "still": still.tolist(),
        "joint_names": list(hand.joint_names),
        "actuator_names": list(hand.actuation.names),
        "fingers": sorted(hand.finger_of_body.items()),
    }
    columns: dict[str, Any] = {name: np.array([s[name] for s in sources]) for name in _COLUMNS}
    columns["kind"] = np.array([KINDS.index(s["kind"]) for s in sources], dtype=np.int8)
    for name in ("plan", "pose"):
        columns[name] = np.array([s[name] for s in sources], dtype=np.int32)
    with whole_file(folder / WORK / SOURCES_FILE) as stream:
        np.savez(stream, **columns)
    write_json(data, folder / WORK / CELL_FILE)


@lru_cache(maxsize=2)
def load_starts(folder: Path) -> Starts:
    """What ``write_cell`` wrote into the folder of a cell, with its scene; once per process."""
    data = json.loads((folder / WORK / CELL_FILE).read_text(encoding="utf-8"))
    with np.load(folder / WORK / SOURCES_FILE) as file:
        sources = {name: file[name] for name in file.files}
    draws: dict[str, Any] = {
        k: tuple(v) if isinstance(v, list) else v for k, v in data["draws"].items()
    }
    arrays = ("lower", "upper", "ctrl_range", "moment", "still")
    scene = load_scene(
        folder / SCENE_FILE,
        tuple(data["joint_names"]),
        tuple(data["actuator_names"]),
        tuple((body, finger) for body, finger in data["fingers"]),
    )
    return Starts(
        seed=data["seed"],
        number=data["number"],
        draws=Draws(**draws),
        mass=(data["mass"][0], data["mass"][1]),
        sources=sources,
        scene=scene,
        **{name: np.array(data[name], dtype=np.float64) for name in arrays},
    )


def rows_of(sources: dict[str, Any], rows: IntArray) -> dict[str, Any]:
    """What sources (m,) say of where they are from: names of kinds, numbers of plans and poses."""
    kinds = np.array(KINDS)[sources["kind"][rows]]
    return {"kind": kinds, "plan": sources["plan"][rows], "pose": sources["pose"][rows]}
