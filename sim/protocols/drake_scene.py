"""An exported scene in Drake: what its MJCF parser reads, and what is added through its interface.

The parser of Drake 1.51 (pydrake, ``pip install drake``) reads bodies, masses, joints with limits
and damping, and geoms with sliding friction. It ignores key frames, tendons, dry friction of joints
and the bits that say which geoms may touch, and takes a servo's range of commands for a limit of
its torque. So these come from ``physics.json``:

- Servos of one joint: Drake's own PD law of a joint actuator, implicit in its solver.
- Servos of tendons, stops between joints and springs: torques of every time step, explicit.
- Couplings of two joints: Drake's coupler, of others: stiff springs.
- Reflected inertia of every joint, and which geoms may touch.

Several joints of one body, as a carriage of two hands has, it moves in another way than MuJoCo
does (hands stood up to 0.2 m from their place): such a body becomes a chain (``_chained``).

Dry friction of joints has no place in Drake and is left out.

Contacts are Drake's compliant hydroelastic patches: pressure fields inside of both bodies, whose
balance is a surface. Modulus, dissipation, friction's regularisation and solver are Drake's
defaults, which nobody here tuned; only the meshes inside are finer than its 20 mm, since they stand
for fingertips of 8 mm (``RESOLUTION``). Its other model, points of deepest penetration, cannot be
used here: its normals (FCL's EPA) are off by 9 to 19 degrees between a sphere and an ellipsoid that
overlap by 0.01 to 1 mm, and by up to 40 degrees at ends of capsules in a grasp, which then rolled
out of the hand. Two frictions mix as 2 a b / (a + b), which is mu where both are mu.

Drake fills convex meshes with tetrahedra and refuses a scene with a degenerate one: a decomposition
leaves faces of 1e-17 m2. The vertices of such a scene are rounded (``GRID``).
"""

from __future__ import annotations

import json
import logging
import shutil
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from planner.errors import FileFormatError, TaskError
from planner.shapes.hulls import hull_of
from planner.spatial import SE3, FloatArray, IntArray, pose_from_wxyz

INSTALL = 'pip install "opposable[drake]"'
"""Command that installs the package."""

TIME_STEP = 0.001
"""Drake's default for a discrete plant, s."""

RESOLUTION = 0.005
"""Edge length (m) of the meshes that carry pressure. A coarse mesh lies inside of its shape: at the
grasp a finger moves until the meshes touch: by 3 to over 10 mm at 20 mm (Drake's default), 0.2 to
0.7 mm at 5 mm, 0.1 to 0.3 mm at 2 mm, which takes four times as long."""

GRID = 1e-5
"""Step (m) to which vertices are rounded where Drake cannot fill a mesh: every face has at least
half of its square then, and the error is far below that of ``RESOLUTION``."""

LIGHT = {"pos": "0 0 0", "mass": "1e-6", "diaginertia": "1e-9 1e-9 1e-9"}
"""Mass (kg) and inertia (kg m2) of a body between two joints."""

STOP_STIFFNESS, STOP_DAMPING = 20.0, 0.1
"""Of a stop or tie between joints, N m/rad and N m s/rad: 0.2 N m, the torque of a firm grip, bends
it by 0.01 rad; explicit in time, it stays stable down to an inertia of 5e-5 kg m2 at 1 ms."""


def drake_missing() -> str:
    """Why Drake cannot be used; "" if it can."""
    try:
        import pydrake.multibody.plant  # noqa: F401
    except ImportError:
        return f"protocol drake needs the package drake, which is not installed: {INSTALL}"
    return ""


@dataclass(frozen=True, kw_only=True, eq=False)
class Explicit:
    """Torques that are worked out from the state before every time step.

    Attributes:
        rows: (n, nq) lengths per joint.
        at_zero: (n,), length at q = 0.
        gain, bias: (n,) and (n, 3), as ``Actuation``.
        force_range: (n, 2).
        names: Of the actuators, n.
        stops: (m, nq) and ``at_least`` (m,): one-sided.
        ties: (k, nq) and ``equals`` (k,): both ways.
        stiffness, torque_at_zero: Springs, (nq, nq) and (nq,).
    """

    rows: FloatArray
    at_zero: FloatArray
    gain: FloatArray
    bias: FloatArray
    force_range: FloatArray
    names: tuple[str, ...]
    stops: FloatArray
    at_least: FloatArray
    ties: FloatArray
    equals: FloatArray
    stiffness: FloatArray
    torque_at_zero: FloatArray

    def torque(self, q: FloatArray, v: FloatArray, commands: FloatArray) -> FloatArray:
        """Joint torques (nq,) at joints and rates (nq,), for commands (n,)."""
        length, rate = self.rows @ q + self.at_zero, self.rows @ v
        law = self.gain * commands + self.bias[:, 0]
        force = law + self.bias[:, 1] * length + self.bias[:, 2] * rate
        force = np.clip(force, self.force_range[:, 0], self.force_range[:, 1])
        depth = self.at_least - self.stops @ q
        push = np.maximum(STOP_STIFFNESS * depth - STOP_DAMPING * (self.stops @ v), 0.0)
        push *= depth > 0
        tie = STOP_STIFFNESS * (self.equals - self.ties @ q) - STOP_DAMPING * (self.ties @ v)
        passive = self.torque_at_zero - self.stiffness @ q
        return np.asarray(self.rows.T @ force + self.stops.T @ push + self.ties.T @ tie + passive)


@dataclass(frozen=True, kw_only=True, eq=False)
class DrakeScene:
    """A scene that is ready to be simulated.

    Attributes:
        plant: ``MultibodyPlant``.
        simulator: Of the diagram of plant and scene graph.
        inspector: Of the scene graph: which geometry belongs to which frame.
        object_body: The object.
        q_index, v_index: (nq,), where the hand's joints stand in the plant's state.
        joints: Their names.
        key_frames: Of ``physics.json``: joints and commands by name.
        T_world_object: Where the object begins.
        wanted: Actuator that Drake drives -> its place in Drake's input, factor and offset: the
            wanted joint is factor ctrl + offset.
        explicit: The other actuators, stops, ties and springs.
        check: Of ``physics.json``: seconds and limits of the hold check.
    """

    plant: Any
    simulator: Any
    inspector: Any
    object_body: Any
    q_index: IntArray
    v_index: IntArray
    joints: tuple[str, ...]
    key_frames: Mapping[str, Mapping[str, Mapping[str, float]]]
    T_world_object: SE3
    wanted: Mapping[str, tuple[int, float, float]]
    explicit: Explicit
    check: Mapping[str, Any]


def load_drake_scene(folder: Path) -> DrakeScene:
    """Read an exported scene into Drake.

    Args:
        folder: As ``sim.scene.export.export_scene`` writes it.

    Raises:
        TaskError: Drake is not installed.
        FileFormatError: The folder is no export, or Drake cannot read its scene, not even with
            rounded meshes.
    """
    if reason := drake_missing():
        raise TaskError(f"{folder} is not executed: {reason}")
    with TemporaryDirectory() as made:
        chained = _chained(folder, Path(made) / "chained")
        try:
            return _loaded(chained)
        except RuntimeError:  # of Drake: one of its tetrahedra is degenerate
            copy = _rounded(chained, Path(made) / "scene")
            try:
                return _loaded(copy)
            except RuntimeError as error:
                raise FileFormatError(
                    f"Drake cannot compute the scene in {folder}: {error}; leave this plan out of "
                    "the protocol drake, or give the object a mesh without slivers"
                ) from error


def _loaded(folder: Path) -> DrakeScene:
    """The scene of a folder as it is.

    Raises:
        RuntimeError: Drake cannot fill one of its meshes.
    """
    from pydrake.geometry import SceneGraphConfig
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlantConfig
    from pydrake.systems.analysis import Simulator
    from pydrake.systems.framework import DiagramBuilder

    try:
        told = json.loads((folder / "physics.json").read_text(encoding="utf-8"))
        mjcf = ET.parse(folder / "scene.xml").getroot()
    except (OSError, ValueError, ET.ParseError) as error:
        raise FileFormatError(f"{folder} is no exported scene: {error}; export it again") from error
    builder = DiagramBuilder()
    plant, graph = AddMultibodyPlant(MultibodyPlantConfig(time_step=TIME_STEP), builder)
    contacts = SceneGraphConfig()
    contacts.default_proximity_properties.compliance_type = "compliant"
    contacts.default_proximity_properties.resolution_hint = RESOLUTION
    graph.set_config(contacts)
    with _quiet():
        try:
            Parser(plant).AddModels(folder / "scene.xml")
        except RuntimeError as error:
            raise FileFormatError(f"Drake cannot read {folder / 'scene.xml'}: {error}") from error
    names = [joint["name"] for joint in told["joints"]]
    wanted, explicit = _drive(plant, told, names)
    _may_touch(plant, graph, mjcf)
    plant.mutable_gravity_field().set_gravity_vector(told["gravity"])
    plant.Finalize()
    simulator = Simulator(builder.Build())
    hand = [plant.GetJointByName(name) for name in names]
    place = told["object"]["T_world_object"]
    return DrakeScene(
        plant=plant,
        simulator=simulator,
        inspector=graph.model_inspector(),
        object_body=plant.GetBodyByName(told["object"]["body"]),
        q_index=np.array([joint.position_start() for joint in hand]),
        v_index=np.array([joint.velocity_start() for joint in hand]),
        joints=tuple(names),
        key_frames=told["key_frames"],
        T_world_object=pose_from_wxyz(
            np.array(place["position"]), np.array(place["quaternion_wxyz"])
        ),
        wanted={
            name: (plant.GetJointActuatorByName(name).input_start(), factor, offset)
            for name, (factor, offset) in wanted.items()
        },
        explicit=explicit,
        check=told["check"],
    )


def _chained(folder: Path, copy: Path) -> Path:
    """A copy of an export in which every body has one joint; the folder itself if all have.

    A body with several becomes a chain of bodies that weigh next to nothing, one below the other in
    the order of its joints, as MuJoCo moves it.
    """
    try:
        tree = ET.parse(folder / "scene.xml")
    except (OSError, ET.ParseError):
        return folder  # the reader says what is wrong
    many = [body for body in tree.iter("body") if len(body.findall("joint")) > 1]
    if not many:
        return folder
    for body in many:
        name, joints = body.attrib["name"], body.findall("joint")
        rest = [child for child in body if child.tag != "joint"]
        body[:], last = [], body
        for k, joint in enumerate(joints):
            last.set("name", f"{name}/{k}")
            last.append(joint)
            if k + 1 < len(joints):
                ET.SubElement(last, "inertial", LIGHT)
                last = ET.SubElement(last, "body")
        last.set("name", name)
        last.extend(rest)
    shutil.copytree(folder, copy)
    tree.write(copy / "scene.xml", encoding="utf-8")
    return copy


def _rounded(folder: Path, copy: Path) -> Path:
    """A copy of an export in which meshes that may touch have vertices on a grid."""
    shutil.copytree(folder, copy)
    mjcf = ET.parse(copy / "scene.xml").getroot()
    touching = {
        geom.get("mesh")
        for geom in mjcf.iter("geom")
        if int(geom.get("contype", "1")) or int(geom.get("conaffinity", "1"))
    }
    for mesh in mjcf.iter("mesh"):
        if mesh.get("name") in touching:
            path = copy / mesh.attrib["file"]
            lines = path.read_text(encoding="utf-8").splitlines()
            vertices = np.array([line.split()[1:4] for line in lines if line[:2] == "v "], float)
            hull = hull_of(GRID * np.unique(np.round(vertices / GRID), axis=0))
            if hull is None:
                continue  # thinner than the grid
            text = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in hull.points.tolist()]
            text += [f"f {a} {b} {c}" for a, b, c in (hull.faces + 1).tolist()]
            path.write_text("\n".join(text) + "\n", encoding="utf-8")
    return copy


@contextmanager
def _quiet() -> Iterator[None]:
    """Drake warns of every attribute that it ignores; the module says which."""
    log = logging.getLogger("drake")
    level = log.level
    log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        log.setLevel(level)


def _limits(pair: Any) -> tuple[float, float]:
    low, high = pair
    return (-np.inf if low is None else low), (np.inf if high is None else high)


def _drive(
    plant: Any, told: Mapping[str, Any], names: list[str]
) -> tuple[dict[str, tuple[float, float]], Explicit]:
    """Actuators by Drake's PD law where one joint has one; the others are explicit."""
    from pydrake.multibody.tree import PdControllerGains

    made = {plant.get_joint_actuator(i).name() for i in plant.GetJointActuatorIndices()}
    wanted: dict[str, tuple[float, float]] = {}
    driven: dict[str, str] = {}
    left = []
    for told_of in told["actuators"]:
        name, length = told_of["name"], told_of["length"]
        stiffness, damping = -told_of["bias"][1], -told_of["bias"][2]
        (joint, ratio), *others = length.items()
        alone = not others and joint not in driven and stiffness > 0 and damping >= 0
        if not alone:
            left.append(told_of)
            continue
        most = max(abs(x) for x in _limits(told_of["force_range"])) * abs(ratio)
        if name not in made:
            plant.AddJointActuator(name, plant.GetJointByName(joint))
        actuator = plant.GetJointActuatorByName(name)
        actuator.set_effort_limit(most)
        actuator.set_controller_gains(
            PdControllerGains(p=stiffness * ratio**2, d=damping * ratio**2)
        )
        offset = told_of["bias"][0] / stiffness - told_of["length_at_zero"]
        wanted[name] = told_of["gain"] / (stiffness * ratio), offset / ratio
        driven[joint] = name
    for joint in told["joints"]:
        name = driven.get(joint["name"])
        if name is None:
            name = f"{joint['name']}/armature"
            plant.AddJointActuator(name, plant.GetJointByName(joint["name"]))
        actuator = plant.GetJointActuatorByName(name)
        actuator.set_default_rotor_inertia(joint["armature"])
        actuator.set_default_gear_ratio(1.0)
    return wanted, _explicit(plant, told, names, left)


def _explicit(
    plant: Any, told: Mapping[str, Any], names: list[str], actuators: list[Mapping[str, Any]]
) -> Explicit:
    """What Drake has no element for."""
    ties = [c for c in told["couplings"] if not _coupled(plant, c)]
    return Explicit(
        names=tuple(a["name"] for a in actuators),
        rows=_rows([a["length"] for a in actuators], names),
        at_zero=np.array([a["length_at_zero"] for a in actuators], dtype=float),
        gain=np.array([a["gain"] for a in actuators], dtype=float),
        bias=np.array([a["bias"] for a in actuators], dtype=float).reshape(-1, 3),
        force_range=np.array([_limits(a["force_range"]) for a in actuators]).reshape(-1, 2),
        stops=_rows([stop["row"] for stop in told["stops"]], names),
        at_least=np.array([stop["at_least"] for stop in told["stops"]], dtype=float),
        ties=_rows([tie["row"] for tie in ties], names),
        equals=np.array([tie["equals"] for tie in ties], dtype=float),
        stiffness=np.array(told["springs"]["stiffness"]),
        torque_at_zero=np.array(told["springs"]["torque_at_zero"]),
    )


def _rows(rows: list[Mapping[str, float]], names: list[str]) -> FloatArray:
    out = np.zeros((len(rows), len(names)))
    for i, row in enumerate(rows):
        for name, x in row.items():
            out[i, names.index(name)] = x
    return out


def _coupled(plant: Any, coupling: Mapping[str, Any]) -> bool:
    """Tie two joints by Drake's coupler; False where more than two are tied."""
    if len(coupling["row"]) != 2:
        return False
    (first, a), (second, b) = coupling["row"].items()
    plant.AddCouplerConstraint(
        plant.GetJointByName(first),
        plant.GetJointByName(second),
        -b / a,
        coupling["equals"] / a,
    )
    return True


def _may_touch(plant: Any, graph: Any, mjcf: ET.Element) -> None:
    """Let only those geoms touch that touch in MuJoCo: contype against conaffinity."""
    from pydrake.geometry import CollisionFilterDeclaration, GeometrySet

    bits = {
        geom.attrib["name"]: (
            int(geom.attrib.get("contype", "1")),
            int(geom.attrib.get("conaffinity", "1")),
        )
        for geom in mjcf.iter("geom")
    }
    inspector = graph.model_inspector()
    geoms = [
        (geometry, *bits[inspector.GetName(geometry).split("::", 1)[-1]])
        for body in plant.GetBodyIndices(plant.GetModelInstanceByName(mjcf.attrib["model"]))
        for geometry in plant.GetCollisionGeometriesForBody(plant.get_body(body))
    ]
    apart = CollisionFilterDeclaration()
    for k, (first, type_1, affinity_1) in enumerate(geoms):
        kept = [
            second
            for second, type_2, affinity_2 in geoms[k + 1 :]
            if not (type_1 & affinity_2 or type_2 & affinity_1)
        ]
        if kept:
            apart.ExcludeBetween(GeometrySet(first), GeometrySet(kept))
    graph.collision_filter_manager().Apply(apart)
