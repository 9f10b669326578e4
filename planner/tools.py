"""Tools: objects with a tip, a handle, wrenches that their use needs, and a plan to grasp them so.

A tool is a TOML file (``opposable-tool``, version 1) beside a mesh, or with a shape of its own made
of sections along z::

    format = "opposable-tool"
    version = 1
    name = "key"
    mass_kg = 0.05
    section = [                      # from the tip upwards, m: a radius, or a size along x and y
      { z_m = 0.0, size_m = [0.008, 0.004] },
      { z_m = 0.03, size_m = [0.008, 0.004] },
      { z_m = 0.03, size_m = [0.012, 0.03] },
      { z_m = 0.06, size_m = [0.012, 0.03] },
    ]
    tip = { position_m = [0, 0, 0], axis = [0, 0, -1] }      # out of the tool, into the work
    handle = [{ lower_m = [-1, -1, 0.032], upper_m = [1, 1, 1] }]
    needed = [{ name = "turn", force_N = [0, 0, -2], torque_N_m = [0, 0, -0.03] }]   # at the tip

    [use]                            # what is done with it: a kind of ``sim.tools``, its numbers
    kind = "turn"
    numbers = { angle_deg = 90, friction_N_m = 0.03 }

Instead of ``section`` there may be ``mesh``, a file beside it, with ``scale`` (m per unit of it),
or ``shape``, a kind with sizes (``planner.objects``), whose origin is its centre of mass. Positions
are in the axes and about the origin of the mesh, the shape or the sections; a ``Tool`` has them
about its centre of mass.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from pydantic import Field, ValidationError

from planner.arrays import check_fields, checked_kind, finite_array
from planner.certify.breaking import breaking_along
from planner.collision.world import CollisionWorld
from planner.errors import NotFoundError, ObjectError, TaskError, shown
from planner.failure import Failure
from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.joints.description import PINCH
from planner.kinematics import HandState
from planner.numerics.kernels import planning_time
from planner.objects import GraspObject, NeededWrench, Region, TouchRegion, parse_object
from planner.plan import GraspPlan
from planner.schema import Finite, StrictData, Vector3, faults_of
from planner.search.attempt import Attempt, best_of_made, nothing_found, search
from planner.search.grasp import DEFAULT_MAX_ATTEMPTS, attempts
from planner.shapes import SIZED_SHAPES, Mesh, Shape
from planner.shapes.made import fans, stacked
from planner.spatial import SE3, FloatArray, fixed_array
from planner.synthesis.options import SynthesisOptions
from planner.system.package import models_dir
from planner.task import GraspTask, Obstacle
from planner.verification import NO_NEEDED

__all__ = ["Tool", "load_tool", "plan_use", "read_tool", "tool_names", "use_task"]

AROUND = 48
"""Points of a section: those of a handle of 15 mm radius are 2 mm apart; a multiple of 4."""

ROW = 0.006
"""Longest distance (m) of rings along a tool, so that triangles are not slivers."""

LONGEST, HEAVIEST = 0.6, 5.0
"""Largest length (m) and mass (kg) of a tool in one hand: more was given in other units."""

STRONGER = 4.0
"""How many times the force that its fingers press with in the pinch posture a hand is believed to
have at best in another posture (-): what needs more is refused before anything is searched."""

MOST_PRESS = 1000.0
"""Largest force (N) of a finger that is looked for."""

BEST_OF = 6
"""Grasps of which the best is taken: proven margins differ by 3 to 12 among grasps of one task, and
those that are near 3 let a screwdriver creep (Shadow-type hand)."""

GOOD_ENOUGH = 0.5
"""Share (-) of the allowed slip up to which a rehearsed grasp is taken at once: with other friction
the slip may double."""

USE_MARGIN = 2.0
"""How many times each needed wrench a grasp for a use is to produce (-): with 1.25 a screwdriver
turned slowly in a hand whose elastic fingers share the load unevenly."""

LOADED_CLEARANCE = 0.0015
"""Least distance (m) of links from each other, and of those that do not hold from the tool, in a
grasp for a use: fingers that bear its load yield by a millimetre, and knuckles planned 0.2 mm apart
pressed on each other."""

ASKED_CLEARANCE = 0.004
"""Distance (m) of fingers that synthesis asks for in a grasp for a use without options."""

FLAT = 1e-8
"""Added to J J^T (m^2): a stretched finger has a direction in which it does not move."""

WAY_CLEARANCE = 0.002
"""Least distance (m) of the hand from what stands around on the way of a use."""


TIP_BESIDE = 0.001
"""How far (m) a tip may be outside of the tool's bounding sphere: files are rounded."""


class SectionData(StrictData):
    """An outline across z: a circle, or a rectangle."""

    z_m: Finite
    radius_m: float | None = Field(default=None, strict=True, gt=0)
    size_m: tuple[Finite, Finite] | None = None


class TipData(StrictData):
    """Where the tool works, and along which axis it points there."""

    position_m: Vector3
    axis: Vector3


class BoxData(StrictData):
    """A box in the tool's frame; a corner is without bounds where it is left out."""

    lower_m: Vector3 | None = None
    upper_m: Vector3 | None = None


class NeededData(StrictData):
    """A wrench that the hand must be able to produce on the tool, at the tip."""

    name: str
    force_N: Vector3 = (0.0, 0.0, 0.0)
    torque_N_m: Vector3 = (0.0, 0.0, 0.0)


class UseData(StrictData):
    """What is done with the tool.

    ``workpiece_m`` are the full extents of the block that it is done on, whose top the fixture
    stands on; ``gap_m`` is from the fixture's mouth to the tip when the tool is grasped.
    """

    kind: str
    workpiece_m: Vector3 = (0.06, 0.06, 0.08)
    gap_m: float = Field(default=0.02, strict=True, ge=0, le=0.2)
    numbers: dict[str, Finite] = Field(default_factory=dict)


class ToolFile(StrictData):
    """A tool as TOML; its shape is one of ``mesh``, ``shape`` and ``section``."""

    format: Literal["opposable-tool"]
    version: Literal[1]
    name: str
    summary: str = ""
    mass_kg: float = Field(strict=True, gt=0, le=HEAVIEST)
    grip_N: float | None = Field(default=None, strict=True, gt=0)
    mesh: str | None = None
    scale: float = Field(default=1.0, strict=True, gt=0)
    shape: str | None = None
    section: list[SectionData] | None = None
    tip: TipData
    handle: list[BoxData] = Field(min_length=1)
    forbidden: list[BoxData] = Field(default_factory=list)
    needed: list[NeededData] = Field(min_length=1)
    use: UseData


@dataclass(frozen=True, kw_only=True, eq=False)
class Tool(GraspObject):
    """An object that something is done with; all of it is in the object's frame.

    Attributes:
        tip: (3,), m: where it works.
        axis: (3,), unit: along which it points there, out of the tool.
        needed: What its use needs the hand to produce.
        use: What is done with it, and how; None: no use is defined.
        grip_force: N per finger with which it is held; the default of a task if None.
        scale: How many times larger than in its file it is (-).
    """

    tip: FloatArray = field(default_factory=lambda: np.zeros(3))
    axis: FloatArray = field(default_factory=lambda: np.array([0.0, 0.0, -1.0]))
    needed: tuple[NeededWrench, ...] = ()
    use: UseData | None = None
    grip_force: float | None = None
    scale: float = 1.0

    def __post_init__(self) -> None:
        """Check the mass and the frames.

        Raises:
            ObjectError: A tip or axis that is no vector.
        """
        super().__post_init__()
        for name in ("tip", "axis"):
            what = f"{self.name}: its {name}"
            vector = finite_array(what, getattr(self, name), (3,), error=ObjectError)
            object.__setattr__(self, name, fixed_array(vector))
        check_fields(self, ("grip_force", "scale"), what=f"{self.name}: ", above=0.0)
        size = float(np.linalg.norm(self.axis))
        if size == 0.0:
            raise ObjectError(f"{self.name}: its axis is zero; give the direction of its tip")
        object.__setattr__(self, "axis", fixed_array(self.axis / size))

    def __eq__(self, other: object) -> bool:
        """Whether all of it is the same; arrays number by number."""
        return (
            isinstance(other, Tool)
            and np.array_equal((self.tip, self.axis), (other.tip, other.axis))
            and all(
                getattr(self, f.name) == getattr(other, f.name)
                for f in fields(self)
                if f.name not in ("tip", "axis")
            )
        )

    def __hash__(self) -> int:
        """Of what can be hashed: regions and numbers of uses are in mappings."""
        return hash((self.name, self.shape, self.mass, self.needed, self.scale))

    def T_world_object(self, tip: Sequence[float] | FloatArray, yaw: float = 0.0) -> SE3:
        """Where the tool is with its axis down and its tip at a point.

        Args:
            tip: (3,), m, world.
            yaw: Turn about the vertical, rad, from where the least turn from its file puts it.
        """
        turn = _turn_between(self.axis, np.array([0.0, 0.0, -1.0]))
        c, s = np.cos(yaw), np.sin(yaw)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ turn
        return SE3(turn, np.asarray(tip) - turn @ self.tip)


def tool_names() -> tuple[str, ...]:
    """Names of the tools that come with Opposable."""
    return tuple(sorted(p.stem for p in (models_dir() / "tools").glob("*.toml")))


def load_tool(given: Tool | str | Path, *, scale: float = 1.0) -> Tool:
    """A tool as it is, by its name, or read from its file.

    Args:
        given: What a caller has.
        scale: How many times larger than in its file it is to be (-); its mass stays.

    Raises:
        NotFoundError: There is none of that name.
        ObjectError: As ``read_tool``, or a ``Tool`` with a scale.
    """
    if isinstance(given, Tool):
        if scale != 1.0:
            raise ObjectError(
                f"{given.name} is made, and scale is {scale}; give the path or name of its file"
            )
        return given
    if isinstance(given, GraspObject):
        raise ObjectError(
            f"{given.name} has no tip and no axis, so it is no tool; write a tool file beside it"
        )
    if Path(given).suffix.lower() == ".toml":
        return read_tool(given, scale=scale)
    if str(given) not in tool_names():
        hint = "The path of a tool file, NAME.toml, is taken too."
        raise NotFoundError("tool", str(given), tool_names(), hint)
    return read_tool(models_dir() / "tools" / f"{given}.toml", scale=scale)


def read_tool(path: Path | str, *, scale: float = 1.0) -> Tool:
    """Read a tool file.

    Args:
        path: The file.
        scale: How many times larger than in the file the tool is to be (-).

    Raises:
        ObjectError: It cannot be read, is no tool file, or says something that cannot be; says
            what and where.
    """
    path = Path(path)
    if not (np.isfinite(scale) and 0.2 <= scale <= 5.0):
        raise ObjectError(f"{path}: scale is {scale}; give 0.2 to 5")
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ObjectError(f"cannot read the tool file {path}: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ObjectError(f"{path} is not a TOML file: {error}") from error
    try:
        data = ToolFile.model_validate(raw)
    except ValidationError as error:
        raise ObjectError(f"{path}: {faults_of(error, raw)}") from error
    shape, origin = _shape_of(path, data, scale)
    length = 2 * float(np.max(shape.half_extents))
    if length > LONGEST:
        raise ObjectError(
            f"{path}: the tool is {length:.3g} m long; tools up to {LONGEST:g} m are used with one "
            "hand: lengths are in m, and scale is how many m the unit of a mesh has"
        )
    turn_shift = scale * np.array(data.tip.position_m) - origin
    far, most = float(np.linalg.norm(turn_shift)), shape.bounding_radius
    if far > most + TIP_BESIDE:
        raise ObjectError(
            f"{path}: the tip is {far:g} m from the centre of mass, and nothing of the tool beyond "
            f"{most:.3g} m; give tip.position_m where it works, in metres"
        )
    needed = []
    for one in data.needed:
        force = np.array(one.force_N)
        torque = np.array(one.torque_N_m) + np.cross(turn_shift, force)
        needed.append(NeededWrench(name=one.name, force=_three(force), torque=_three(torque)))
    return Tool(
        name=data.name,
        shape=shape,
        mass=data.mass_kg,
        touch=TouchRegion(
            allowed=_regions("handle", data.handle, scale, origin),
            forbidden=_regions("forbidden", data.forbidden, scale, origin),
        ),
        tip=turn_shift,
        axis=np.array(data.tip.axis),
        needed=tuple(needed),
        use=data.use,
        grip_force=data.grip_N,
        scale=scale,
    )


def _shape_of(path: Path, data: ToolFile, scale: float) -> tuple[Shape, FloatArray]:
    """The shape, and where its centre of mass is in the file's frame (3,), m."""
    given = [name for name in ("mesh", "shape", "section") if getattr(data, name) is not None]
    if len(given) != 1:
        raise ObjectError(
            f"{path}: it has {' and '.join(given) or 'no shape'}; give one of mesh, shape, section"
        )
    if data.scale != 1.0 and data.mesh is None:
        raise ObjectError(
            f"{path}: scale is {data.scale:g}, but {given[0]} is in metres; leave it out, it "
            "is for the unit of a mesh"
        )
    if data.section is not None:
        made = sections_mesh(str(path), data.section, scale)
        return made, made.offset
    if data.mesh is not None:
        loaded = Mesh.load(path.parent / data.mesh, scale=scale * data.scale)
        return loaded, loaded.offset
    if scale != 1.0:
        raise ObjectError(f"{path}: a shape has its sizes and takes no scale; leave it at 1")
    kind = str(data.shape).partition(":")[0].strip().lower()
    if kind not in SIZED_SHAPES:
        raise ObjectError(
            f"{path}: shape is {shown(data.shape)}; give one of {', '.join(SIZED_SHAPES)} with its "
            'sizes, or a file by mesh = "NAME.stl", beside the tool file'
        )
    return parse_object(str(data.shape)).shape, np.zeros(3)


def sections_mesh(what: str, sections: Sequence[SectionData], scale: float = 1.0) -> Mesh:
    """A solid through sections along z, straight between two of them.

    Args:
        what: What errors call it.
        sections: From below upwards; two at one height are a step.
        scale: All lengths are multiplied by it (-).

    Raises:
        ObjectError: Fewer than two sections, not upwards, without an outline, or no solid.
    """
    if len(sections) < 2 or any(b.z_m < a.z_m for a, b in pairwise(sections)):
        raise ObjectError(f"{what}: give two sections or more, from below upwards")
    outlines = [_outline(what, one) for one in sections]
    rings = [outlines[0]]
    for a, b in pairwise(outlines):
        count = max(1, int(np.ceil((b[0, 2] - a[0, 2]) / ROW - 1e-9)))
        rings += [a + (b - a) * k / count for k in range(1, count + 1)]
    points = scale * np.vstack([*rings, rings[0].mean(axis=0), rings[-1].mean(axis=0)])
    faces = [stacked(np.array(rings)), fans(len(rings), AROUND)]
    return Mesh.from_triangles(points, np.vstack(faces), name=what)


def _outline(what: str, section: SectionData) -> FloatArray:
    """Points (AROUND, 3), m, counter-clockwise from the corner at -45 degrees."""
    if (section.radius_m is None) == (section.size_m is None):
        raise ObjectError(
            f"{what}: the section at z_m = {section.z_m:g} needs one of radius_m and size_m"
        )
    if section.radius_m is not None:
        angle = -np.pi / 4 + 2 * np.pi * np.arange(AROUND) / AROUND
        flat = section.radius_m * np.column_stack([np.cos(angle), np.sin(angle)])
    else:
        half = np.array(section.size_m) / 2
        if (half <= 0).any():
            raise ObjectError(f"{what}: size_m {section.size_m} needs two lengths > 0")
        corners = half * np.array([[1, -1], [1, 1], [-1, 1], [-1, -1], [1, -1]])
        share = np.arange(AROUND // 4)[:, None] / (AROUND // 4)
        flat = np.vstack([a + share * (b - a) for a, b in pairwise(corners)])
    return np.column_stack([flat, np.full(AROUND, section.z_m)])


def _regions(
    name: str, boxes: Sequence[BoxData], scale: float, origin: FloatArray
) -> tuple[Region, ...]:
    return tuple(
        Region(
            name=f"{name} {k + 1}",
            lower=_corner(box.lower_m, -np.inf, scale, origin),
            upper=_corner(box.upper_m, np.inf, scale, origin),
        )
        for k, box in enumerate(boxes)
    )


def _corner(given: Vector3 | None, without: float, scale: float, origin: FloatArray) -> Vector3:
    """A corner about the centre of mass; ``without`` along every axis where none is given."""
    return _three(np.full(3, without) if given is None else scale * np.array(given) - origin)


def _three(values: FloatArray) -> Vector3:
    x, y, z = values.tolist()
    return x, y, z


def _turn_between(a: FloatArray, b: FloatArray) -> FloatArray:
    """The least turn (3, 3) that puts unit vector a onto b."""
    v, c = np.cross(a, b), float(a @ b)
    if c < -1.0 + 1e-12:  # half a turn about any axis across
        across = np.cross(a, np.eye(3)[int(np.argmin(np.abs(a)))])
        across /= np.linalg.norm(across)
        return np.asarray(2 * np.outer(across, across) - np.eye(3))
    k = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.asarray(np.eye(3) + k + k @ k / (1.0 + c))


# ---- planning


def use_task(
    hand: Hand | str | Path,
    tool: Tool,
    T_world_object: SE3,
    *,
    obstacles: Sequence[Obstacle] = (),
    **changes: Any,
) -> GraspTask:
    """The task of grasping a tool that is offered at a pose, for its use.

    Args:
        hand: A hand, its name, or the path of its description.
        tool: The tool.
        T_world_object: Where it is offered; the support releases it when the fingers press.
        obstacles: What the hand must not touch.
        changes: Further arguments of ``GraspTask.create``.

    Raises:
        ObjectError: The tool has no handle, or needs no wrench.
        TaskError: A wrench that the hand cannot produce, with the actuator that ends it.
    """
    checked_kind("tool", tool, Tool)
    if not tool.needed or tool.touch is None or not tool.touch.allowed:
        raise ObjectError(
            f"{tool.name} needs no wrench or has no handle; a tool that is to be used needs both"
        )
    task = GraspTask.create(
        hand,
        tool,
        T_world_object=T_world_object,
        table_height=None,
        obstacles=obstacles,
        **{
            "needed": tool.needed,
            "needed_margin": USE_MARGIN,
            "grip_force": tool.grip_force,
            **changes,
        },
    )
    check_strength(task)
    return task


def check_strength(task: GraspTask) -> None:
    """Refuse needed wrenches far beyond a hand's strength, before anything is searched.

    The bound is generous: every finger presses ``STRONGER`` times what it can in the pinch posture,
    along friction that all helps, at the farthest place that may be touched. The search finds
    out which grasp produces them.

    Raises:
        TaskError: A wrench needs more; names the largest there is and the actuator that ends it.
    """
    hand, item = task.hand, task.object
    if PINCH not in hand.description.postures:
        return
    pressed = [_press(hand, finger) for finger in task.fingers]
    total = STRONGER * sum(force for force, _ in pressed) * float(np.hypot(1.0, task.mu))
    lever = item.shape.bounding_radius
    limit = min(pressed, key=lambda p: p[0])[1]
    for one in task.needed:
        for what, vector, most, unit in (
            ("force", one.force, total, "N"),
            ("torque", one.torque, total * lever, "N m"),
        ):
            wanted = task.needed_margin * float(np.linalg.norm(vector))
            if wanted > most:
                raise TaskError(
                    f"needed wrench {one.name!r} of {item.name} takes a {what} of {wanted:.3g} "
                    f"{unit} (margin {task.needed_margin:g}); {hand.name} is estimated to have "
                    f"at most {most:.3g} {unit} with {len(pressed)} contacts, ended by {limit}: "
                    "take a stronger hand, or ask for less"
                )


def _press(hand: Hand, finger: Finger) -> tuple[float, str]:
    """Force (N) with which a finger can press in the pinch posture, and what ends it."""
    q = hand.posture(PINCH)
    state = HandState(hand, q)
    jacobian = state.point_jacobian(finger.pad.joint_id, state.pad_center(finger))[:3]
    rotation = state.joint_pose(finger.pad.joint_id).rotation
    torque = jacobian.T @ (rotation @ finger.pad.axis)
    low, high, ends = 0.0, MOST_PRESS, "nothing"
    for _ in range(30):
        middle = (low + high) / 2
        beyond = hand.actuation.short_of(q, middle * torque, 1e-9)
        if beyond.any():
            high, ends = middle, hand.actuation.names[int(np.flatnonzero(beyond)[0])]
        else:
            low = middle
    return low, ends


def plan_use(
    task: GraspTask,
    way: Callable[[GraspPlan], Sequence[SE3]] | None = None,
    *,
    seed: int = 0,
    max_attempts: int = DEFAULT_MAX_ATTEMPTS,
    best_of: int = BEST_OF,
    options: SynthesisOptions | None = None,
    progress: Callable[[Attempt[GraspPlan]], object] | None = None,
    fit: Callable[[GraspPlan, GraspTask], GraspPlan | Failure] | None = None,
    gives_way: float = 0.0,
    rehearse: Callable[[GraspPlan], float | Failure] | None = None,
) -> GraspPlan:
    """A grasp for the use of a tool: needed wrenches with margin, and a way that is free.

    Args:
        task: From ``use_task``.
        way: Of a grasp, the base poses through which the use takes the hand, close together; at
            each of them the hand must keep ``WAY_CLEARANCE`` from the obstacles. None for none. A
            ``TaskError`` of it fails that grasp.
        seed: Same seed, same plan.
        max_attempts: Budget in attempts.
        best_of: Grasps to find, of which that with the largest proven margin is taken.
        options: Margins, weights and objectives; the needed wrenches join the objectives. Fingers
            ``ASKED_CLEARANCE`` apart if None.
        progress: Called after every attempt.
        fit: What makes of a grasp without needed wrenches one of the task, or says why it cannot;
            grasps are searched with needed wrenches if None.
        gives_way: How far the tool may give way before the fingers for a moment, m: see
            ``followed``.
        rehearse: Tries a grasp that is proven and free, and returns the share (-) of the allowed
            slip that it took, or what it fails by. The first with at most ``GOOD_ENOUGH`` is taken,
            or that with the least of ``best_of``. None: grasps are not tried.

    Raises:
        NoGraspFoundError: The budget ended; says which needed wrench failed, and by which limit.
        TaskError: The task cannot work.
    """
    hand = task.hand
    hand.require_one("the use of a tool")
    came: dict[int, float] = {}  # by the id of a plan; ``search`` keeps all plans

    def worth(plan: GraspPlan) -> float:
        return needed_margin(plan) if rehearse is None else -came[id(plan)]

    def told(attempt: Attempt[GraspPlan]) -> bool:
        stops = progress is not None and progress(attempt) is True
        best = None if rehearse is None else attempt.best
        return stops or (best is not None and -best <= GOOD_ENOUGH)

    def judged() -> Iterator[Attempt[GraspPlan]]:
        asked = options or SynthesisOptions(clear_fingers=ASKED_CLEARANCE)
        searched = task if fit is None else replace(task, needed=())
        for attempt in attempts(searched, seed=seed, options=asked):
            plan, begun = attempt.plan, planning_time()
            near = plan and _too_near(plan, gives_way)
            found = plan and (near or (plan if fit is None else fit(plan, task)))
            if isinstance(found, GraspPlan) and way is not None:
                try:
                    poses = way(found)
                except TaskError as error:
                    found = Failure(kind="use_way", text=str(error))
                else:
                    found = way_blocked(found, poses) or found
            if isinstance(found, GraspPlan) and rehearse is not None:
                tried = rehearse(found)
                if isinstance(tried, Failure):
                    found = tried
                else:
                    came[id(found)] = tried
            failure = found if isinstance(found, Failure) else attempt.failure
            yield replace(
                attempt,
                plan=found if isinstance(found, GraspPlan) else None,
                failure=failure,
                cpu_s=attempt.cpu_s + planning_time() - begun,
            )

    plan, made = search(
        judged(),
        max_attempts=max_attempts,
        best_of=best_of,
        merit=worth,
        progress=told,
    )
    if plan is None:
        weak = [f"{f.text}. " for a in made if (f := a.failure) and f.kind == NO_NEEDED]
        raise nothing_found(
            f"grasp of {task.object.name} for its use with {hand.name}",
            made,
            f"{''.join(weak[:1])}Try more attempts, a longer handle, a smaller margin, or ask "
            "for less force",
        )
    metric = "needed_margin" if rehearse is None else "rehearsal"
    return best_of_made(plan, made, metric=metric, value=abs(worth(plan)))


def _too_near(plan: GraspPlan, gives_way: float = 0.0) -> Failure | None:
    """Which links come nearer than ``LOADED_CLEARANCE``; None if none do."""
    near = min(plan.verification.closest, key=lambda pair: pair.distance, default=None)
    if near is not None and near.distance < LOADED_CLEARANCE:
        text = f"{near} apart; fingers that bear the use yield, {1e3 * LOADED_CLEARANCE:g} mm are"
        return Failure(kind="use_clearance", text=f"{text} kept")
    if gives_way == 0.0:
        return None
    q = followed(plan, gives_way)
    near = CollisionWorld(plan.task).between_fingers(plan.T_world_base, q, LOADED_CLEARANCE)
    if near is None:
        return None
    text = f"{near} apart where the tool gives way by {1e3 * gives_way:g} mm"
    return Failure(kind="use_clearance", text=text)


def followed(plan: GraspPlan, way: float) -> FloatArray:
    """Joints (nq,) with every finger moved on along its contact's normal, to first order.

    A blow takes the tool away from fingers, which then follow with the force that they pressed
    with, and nothing holds them aside: fingers that press from two sides of a ridge come together.

    Args:
        plan: The grasp.
        way: How far, m.
    """
    state, q = HandState(plan.task.hand, plan.q), plan.q.copy()
    contacts = plan.contacts.transformed(plan.T_world_base.inverse())
    for finger, point, normal in zip(
        plan.task.fingers, contacts.positions, contacts.normals, strict=True
    ):
        own = finger.q_index
        jac = state.point_jacobian(finger.pad.joint_id, point)[:3, own]
        q[own] += jac.T @ np.linalg.solve(jac @ jac.T + FLAT * np.eye(3), way * normal)
    return q


def needed_margin(plan: GraspPlan) -> float:
    """How many times the grasp can surely produce each of its needed wrenches at least (-)."""
    return min(
        breaking_along(plan.forces.problem, plan.task.needed_load(one)).lower
        for one in plan.task.needed
    )


def way_blocked(plan: GraspPlan, way: Sequence[SE3]) -> Failure | None:
    """What the hand comes too near to on a way of its base; None if nothing.

    Args:
        plan: The grasp; its fingers stay as they are.
        way: Poses of the base.
    """
    names = {obstacle.name for obstacle in plan.task.obstacles}
    if not names:
        return None
    world = CollisionWorld(plan.task)
    for k, pose in enumerate(way):
        for near in world.distances(pose, plan.q):
            if near.second in names and near.distance < WAY_CLEARANCE:
                return Failure(
                    kind="use_collision",
                    text=f"the way of the use is not free, at pose {k + 1} of {len(way)}: {near}",
                    numbers={"distance": near.distance},
                )
    return None


def use_data(tool: Tool) -> UseData:
    """What is done with a tool.

    Raises:
        ObjectError: Its file does not say.
    """
    if tool.use is None:
        raise ObjectError(f"{tool.name} says no use; add a table [use] with a kind to its file")
    return tool.use


def use_numbers(tool: Tool, known: Mapping[str, float]) -> Mapping[str, float]:
    """Numbers of a tool's use, with defaults for those that its file leaves out.

    Args:
        tool: The tool.
        known: Name -> default of the numbers that its kind has.

    Raises:
        ObjectError: The tool has no use, or a number that its kind has not.
    """
    use = use_data(tool)
    if unknown := sorted(set(use.numbers) - set(known)):
        raise ObjectError(
            f"{tool.name}: use.numbers has {', '.join(map(shown, unknown))}; kind "
            f"{use.kind!r} has {', '.join(known)}"
        )
    return MappingProxyType({**known, **use.numbers})
