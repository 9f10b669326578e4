"""Grasp from scans: found, held on the true object, abstained, beside meshes taken as if true.

Scan k of an object is drawn by seed, object and k, and is the same for every hand and way:

cloud    the uncertain surface, with its margins; abstains where none is kept
mesh     the true mesh at the pose that the scan gives: failures come from the calibration
hull     the convex hull of the seen points, taken as if it were true
poisson  their screened Poisson surface, likewise (pip install pymeshlab)
surface  no grasp: which share of the true surface that was seen is within one standard deviation of
         the believed one

Trials are on the true object, with the errors of ``--error-model``. "Right" abstentions are those
whose best plan, executed all the same, does not hold, or that have no plan at all.
"""

from __future__ import annotations

import io
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from itertools import product
from pathlib import Path
from typing import Annotated, Any
from zlib import crc32

import numpy as np
import trimesh
import typer
from PIL import Image

from benchmarks.bench import HandOptions, NumberOption
from benchmarks.common import checked_hand, known, objects_of
from benchmarks.summary import count, of, percentage, share, summary
from planner.clouds.belief import LEAST_SLOPE, Belief
from planner.clouds.cloud import PointCloud, prepared
from planner.clouds.files import DepthView, cloud_of_views
from planner.clouds.hollow import through
from planner.clouds.level import levelled
from planner.collision.world import TABLE_SIZE
from planner.errors import (
    FileFormatError,
    NoGraspFoundError,
    ObjectError,
    TaskError,
    UncertainError,
)
from planner.exchange.array_files import read_pickle
from planner.objects import GraspObject, parse_object
from planner.plan import GraspPlan
from planner.search.from_cloud import CloudPlan, plan_from_cloud
from planner.search.grasp import plan_grasp
from planner.search.in_the_way import CLEAR, clearance_of_points
from planner.shapes import Mesh
from planner.shapes.hulls import hull_of
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask, Obstacle
from sim.cli.execution import controller_of, error_model_of
from sim.cli.options import ControllerOption, ErrorModelOption
from sim.cli.tasks import error_of, length_of
from sim.scan import Calibration, Scan, scan
from sim.tables import Row
from sim.trial import simulate

WAYS = ("cloud", "mesh", "hull", "poisson", "surface")

DRAWN = "drawn"
"""Objects that are drawn by ``--seed``, ten of them: ``KINDS`` with other sizes."""

TABLE = 0.0
"""Height of the table's top, m, which planning knows."""

KINDS = (
    *("sphere", "box", "cylinder", "capsule", "ellipsoid"),
    *("superquadric", "mug", "lbracket", "torus", "cup"),
)

HUG, BY_CLASS = (
    "hug",
    {
        "round": ("sphere:0.0225", "ellipsoid:0.08x0.07x0.06", "ellipsoid:0.14x0.09x0.08"),
        "cuboid": ("box:0.045x0.035x0.03", "box:0.06x0.045x0.08", "box:0.09x0.06x0.14"),
        "cylinder": ("cylinder:0.016x0.045", "cylinder:0.028x0.08", "cylinder:0.035x0.14"),
        "flat": ("box:0.045x0.04x0.015", "box:0.08x0.06x0.02", "box:0.14x0.08x0.03"),
        "irregular": (
            "lbracket:0.045x0.04x0.025x0.014",
            "mug:0.038x0.08",
            "hammer:0.14x0.05x0.012",
        ),
    },
)
"""Five classes of form, each 4.5, 8 and 14 cm long: the table of HUG-Bench (Wu et al. 2026), whose
own meshes are not to be had here."""

LONGEST = (0.05, 0.10)
"""Between what the longest side of a drawn object is drawn, m; the others are 4 cm or less short of
it by the kind."""

STRETCH = (0.8, 1.25)
"""Between what each size is drawn, over the kind's own, before the longest side is set (-)."""

DEPTH = 6
"""Depth of the tree of the Poisson surface: cells of 1/64 of the object's length."""

PIECE = 1000
"""Triangles of a piece of the Poisson surface that is kept."""


@dataclass(frozen=True, kw_only=True)
class Options(HandOptions):
    """Scans of every object, planned on in several ways, for every hand."""

    n: NumberOption = 2
    objects: Annotated[
        str, typer.Option(help=f"Objects, folders of meshes, {HUG}, or {DRAWN}: ten by the seed.")
    ] = DRAWN
    ways: Annotated[str, typer.Option(help=f"{', '.join(WAYS)}, or all.")] = "cloud,mesh,hull"
    views: Annotated[str, typer.Option(help="Numbers of views, with commas.")] = "1,2"
    noise: Annotated[str, typer.Option(help="Standard deviation of depth.")] = "2mm"
    calibration: Annotated[str, typer.Option(help="Error of all views together.")] = "5mm,5"
    apart: Annotated[str, typer.Option(help="Error of each view beside that.")] = "0"
    error_model: ErrorModelOption = "lab"
    controller: ControllerOption = "feedforward"
    frames: Annotated[
        Path | None,
        typer.Option(help="Folder of real RGB-D frames (HUG-Bench, data/hug_bench) instead."),
    ] = None


def cases(options: Options) -> Iterator[Row]:
    """Every scan, way and hand; of frames, each with every hand."""
    if options.frames is not None:
        files = sorted(options.frames.glob("*.pkl"))
        if not files:
            raise TaskError(f"{options.frames} holds no .pkl file; name data/hug_bench of a clone")
        for hand in options.hand_names:
            checked_hand(hand)
            for file in files:
                yield {"hand": hand, "frame": str(file), "seed": options.seed}
        return
    ways = known("way", options.ways, WAYS)
    found = listed_objects(options)
    error_model = error_model_of(options.error_model)
    shared = {name: getattr(options, name) for name in ("noise", "calibration", "apart")}
    length_of("--noise", options.noise)
    for hand in options.hand_names:
        checked_hand(hand)
    # so that an interrupted run has some of everything
    for k, (label, spec), views, hand, way in product(
        range(options.n), found, options.views.split(","), options.hand_names, ways
    ):
        yield {
            **{"hand": hand, "object": label, "spec": spec, "way": way, "k": k},
            **{"views": _count(views), "seed": options.seed, **shared},
            **{"controller": options.controller, "error_model": error_model},
        }


def _count(text: str) -> int:
    if not text.strip().isdigit() or int(text) < 1:
        raise TaskError(f"--views {text!r} is no number of cameras; give 1, or 1,2")
    return int(text)


def listed_objects(options: Options) -> list[tuple[str, str]]:
    """Label and specification of the objects that were asked for."""
    if options.objects == DRAWN:
        return drawn_objects(options.seed)
    if options.objects == HUG:
        sizes = ("small", "medium", "large")
        return [
            (f"{kind} {size}", spec)
            for kind, specs in BY_CLASS.items()
            for size, spec in zip(sizes, specs, strict=True)
        ]
    return objects_of(options.objects)


def drawn_objects(seed: int) -> list[tuple[str, str]]:
    """Label and specification of ten objects of drawn sizes, 5 to 10 cm long."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, 3131]))
    found = []
    for kind in KINDS:
        sizes = np.array(parse_object(kind).shape.sizes)
        fixed = len(sizes) - (2 if kind == "superquadric" else kind == "cup")  # exponents, wall
        sizes[:fixed] *= rng.uniform(*STRETCH, fixed)
        spec = f"{kind}:{'x'.join(f'{v:.4g}' for v in sizes)}"
        factor = rng.uniform(*LONGEST) / (2.0 * parse_object(spec).shape.half_extents.max())
        sizes[:fixed] *= factor
        found.append((kind, f"{kind}:{'x'.join(f'{v:.4g}' for v in sizes)}"))
    return found


def scan_seed(case: Row) -> int:
    """Seed of a scan: by seed, object and number, whatever hand and way."""
    return crc32(f"{case['seed']} {case['spec']} {case['k']}".encode())


def scanned(case: Row) -> Scan:
    """The scan of a case."""
    (shift, turn), (own_shift, own_turn) = (
        error_of(name, case[name]) for name in ("calibration", "apart")
    )
    return scan(
        parse_object(case["spec"]),
        views=case["views"],
        noise=length_of("noise", case["noise"]),
        calibration=Calibration(shift=shift, turn=turn, view_shift=own_shift, view_turn=own_turn),
        seed=scan_seed(case),
    )


def believed_motion(before: FloatArray, after: FloatArray) -> SE3:
    """The rigid motion of points (n, 3) to others (n, 3)."""
    a, b = before.mean(axis=0), after.mean(axis=0)
    u, _, v = np.linalg.svd((before - a).T @ (after - b))
    turn = (u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v).T
    return SE3(turn, b - turn @ a)


SEEN = 1500
"""Points of the true surface by which a belief is judged."""


def within_one_deviation(case: Row, found: Scan, raw: PointCloud, cloud: PointCloud) -> float:
    """Share of the true surface in pixels that saw it that is within one standard deviation.

    Calibration is left out: what noise leaves open is judged, and ``pose_error`` is beside that. So
    are hollows, which count as filled.
    """
    exact = scanned({**case, "noise": "0mm"})
    pixels = zip(exact.views, found.views, exact.on_object, found.on_object, strict=True)
    moved = believed_motion(raw.points, cloud.points)
    belief = Belief.of(cloud).of_hypothesis(0)[0]
    lid, parts = belief.lid, []
    for view, noisy, mine, also in pixels:
        seen = view.points().reshape(*mine.shape, 3)[mine & also & np.isfinite(noisy.depth)]
        seen = np.vstack([seen, view.T_world_camera[:3, 3]]) @ moved.rotation.T + moved.translation
        points, eye = seen[:-1], seen[-1:]
        if len(lid):
            points = points[~through(lid[:, :2], lid[0, 2], points, eye)[0]]
        parts.append(points)
    points = np.random.default_rng(0).permutation(np.concatenate(parts))[:SEEN] - belief.offset
    slope = np.clip(np.linalg.norm(belief.gradient(points), axis=1), LEAST_SLOPE, 1.0)
    return float((np.abs(belief.mean(points)) / slope <= belief.deviation(points)).mean())


FRAME_NOISE = 0.002
"""Standard deviation (m) of a frame's depth at half a metre: 3 mm a pixel, learned stereo."""


def frame_view(file: Path) -> tuple[str, DepthView]:
    """Name of the object and the depth image of a frame of HUG-Bench, read without executing it.

    Raises:
        FileFormatError: It is none.
    """
    data = read_pickle(file)
    try:
        depth, mask = (
            np.asarray(Image.open(io.BytesIO(data[name]))) for name in ("depth", "object_mask")
        )
        K, pose, name = data["camera"]["K"], data["T_world_camera"], str(data["object_name"])
    except (KeyError, TypeError, OSError) as error:
        raise FileFormatError(f"{file} is no frame of HUG-Bench: {error}") from error
    metres = np.where(depth > 0, 1e-3 * depth, np.nan)
    fx, fy, cx, cy = (float(K[i, j]) for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return name, DepthView(
        depth=metres, intrinsics=(fx, fy, cx, cy), T_world_camera=pose, mask=mask > 0
    )


def measure_frame(case: Row) -> Row:
    """Plan on a real frame, and how clear of its points the hand is."""
    name, view = frame_view(Path(case["frame"]))
    seen = view.points().reshape(-1, 3)
    begin, plan, why = time.process_time(), None, ""
    raw = cloud_of_views([view], noise=FRAME_NOISE, table=None)
    cloud = levelled(raw)
    try:
        plan = plan_from_cloud(checked_hand(case["hand"]), cloud, seed=case["seed"], name=name).plan
    except (NoGraspFoundError, ObjectError, TaskError) as error:
        why = str(error)
    row = {"object": name, "cpu_s": time.process_time() - begin, "found": plan is not None}
    row |= {"why": why[:400], "points": len(raw), "clear_mm": None, "clear": None}
    if plan is not None:
        moved = believed_motion(raw.points, cloud.points)
        seen = seen[np.isfinite(seen).all(axis=1)] @ moved.rotation.T + moved.translation
        least = clearance_of_points(plan, seen)
        row |= {"clear_mm": 1e3 * min(least, 2.0 * CLEAR), "clear": least >= CLEAR}
    return row


def measure(case: Row) -> Row:
    """Plan on a scan and execute on the truth, or plan on a frame."""
    if "frame" in case:
        return measure_frame(case)
    found = scanned(case)
    raw = found.cloud(table=None)
    begin = time.process_time()
    cloud = levelled(raw, TABLE)
    level_s = time.process_time() - begin
    if case["way"] == "surface":
        return {"within": within_one_deviation(case, found, raw, cloud)}
    # where the first view, with its table, puts what it sees
    moved = believed_motion(raw.points, cloud.points)
    centre = SE3(np.eye(3), found.truth.T_world_object.translation)
    believed = moved * centre * found.calibration[0] * centre.inverse() * found.truth.T_world_object
    row: Row = {"found": False, "abstained": False, "held": None, "right": None, "reason": ""}
    error_model = case["error_model"].seeded(scan_seed(case))
    begin = time.process_time()
    plan: GraspPlan | CloudPlan | None = None
    why = ""
    try:
        plan = plan_of(case, cloud, found, believed, error_model.encoder_offset)
    except (NoGraspFoundError, ObjectError) as error:
        why = str(error)
        if isinstance(error, UncertainError):
            plan = error.best
    row["cpu_s"] = time.process_time() - begin + level_s
    row |= {"found": not why, "abstained": bool(why), "why": why[:300]}
    if plan is None:
        return row | {"right": True}
    if isinstance(plan, CloudPlan):
        row |= {"survival": plan.survival, "tipping": plan.tipping, "hidden": plan.hidden}
    report = simulate(
        plan,
        truth=found.truth,
        error_model=error_model,
        controller=controller_of(case["controller"]),
    )
    row |= {"tries": len(report.tries) or 1, "told": "; ".join(report.tries)}
    if why:
        return row | {"right": not report.success, "reason": f"abstained: {report.reason}"}
    off = [c.position_error_mm for c in report.comparison]
    return row | {
        "held": report.success,
        "reason": report.reason,
        "off_mm": float(np.nanmedian(off)) if np.isfinite(off).any() else None,
        "epsilon": report.plan.quality.epsilon,
    }


def plan_of(
    case: Row, cloud: PointCloud, found: Scan, believed: SE3, joint_error: float
) -> GraspPlan | CloudPlan:
    """A plan by the way of a case.

    Raises:
        NoGraspFoundError: None was found.
        ObjectError: The points are no object.
    """
    hand, seed = checked_hand(case["hand"]), scan_seed(case)
    if case["way"] == "cloud":
        shift, turn = error_of("calibration", case["calibration"])
        wanted: dict[str, Any] = {
            **{"seed": seed, "mass": found.truth.object.mass, "joint_error": joint_error},
            "pose_error": (shift / math.sqrt(3.0), turn / math.sqrt(3.0)),
        }
        return plan_from_cloud(hand, cloud, **wanted)
    if case["way"] == "mesh":
        item, pose = found.truth.object, believed
    else:
        surface = hull_surface if case["way"] == "hull" else poisson_surface
        shape = Mesh.from_triangles(*surface(prepared(cloud)), name=case["way"], repair=True)
        item = GraspObject(name=case["way"], shape=shape, mass=found.truth.object.mass)
        pose = SE3(np.eye(3), shape.offset)
    # the object of a scan may float, or be in the table by a little: the table is an obstacle then
    foot = pose.translation[2] - item.shape.support(-pose.rotation[2])
    top = min(TABLE, foot - 1e-4)
    place = SE3(np.eye(3), np.array([*pose.translation[:2], top - TABLE_SIZE[2] / 2]))
    table = Obstacle(name="table", size=np.array(TABLE_SIZE), T_world_obstacle=place)
    task = GraspTask.create(
        hand,
        item,
        T_world_object=pose,
        table_height=None,
        obstacles=(table,),
        joint_error=joint_error,
    )
    return plan_grasp(task, seed=seed)


def hull_surface(cloud: PointCloud) -> tuple[FloatArray, Any]:
    """The convex hull of the points."""
    hull = hull_of(cloud.points)
    if hull is None:
        raise ObjectError("the points have no hull; give more of them")
    return hull.points, hull.faces


def poisson_surface(cloud: PointCloud) -> tuple[FloatArray, Any]:
    """The screened Poisson surface (Kazhdan, Hoppe 2013) of the points and their normals."""
    try:
        pymeshlab = import_module("pymeshlab")
    except ImportError as error:
        raise TaskError("the way poisson needs: pip install pymeshlab") from error
    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(pymeshlab.Mesh(vertex_matrix=cloud.points, v_normals_matrix=cloud.normals))
    meshes.generate_surface_reconstruction_screened_poisson(depth=DEPTH, threads=1, preclean=True)
    meshes.meshing_remove_connected_component_by_face_number(mincomponentsize=PIECE)
    made = trimesh.Trimesh(
        meshes.current_mesh().vertex_matrix(), meshes.current_mesh().face_matrix()
    )
    lids, middles = trimesh.repair.stitch(made, insert_vertices=True)  # open behind
    return np.vstack([made.vertices, middles]), np.vstack([made.faces, lids[:, ::-1]])


def tables(result: Row) -> Iterator[Row | str]:
    """Held of those not abstained, abstained and whether rightly, CPU; why trials failed."""
    rows = [row for row in result["rows"] if not row["error"]]
    if any("frame" in row for row in rows):
        columns = {
            "plans": share("found"),
            f"clear by {1e3 * CLEAR:g} mm": share("clear", known="clear"),
            "clear mm": of("clear_mm", "min", 1),
            "points": of("points", digits=0),
            "CPU s": of("cpu_s"),
            "most": of("cpu_s", "max"),
        }
        yield summary("real frames", rows, ("hand", "object"), columns, [(None, "all")])
        yield from (f"{row['hand']} {row['object']}: {row['why']}" for row in rows if row["why"])
        return
    surfaces = [row for row in rows if row["way"] == "surface"]
    if surfaces:
        within = {"scans": count, "within one deviation": of("within", "mean")}
        yield summary("seen surface", surfaces, ("views", "object"), within, [(None, "all")])
        rows = [row for row in rows if row["way"] != "surface"]
        if not rows:
            return
    columns = {
        "not abstained": share("found"),
        "held of those": percentage("held", 0, known="held"),
        "held": share("held", known="held"),
        "abstained": percentage("abstained", 0),
        "rightly": share("right", known="right"),
        "contacts off mm": of("off_mm", digits=1),
        "CPU s": of("cpu_s"),
        "most": of("cpu_s", "max"),
    }
    yield summary(
        "held on the true object",
        rows,
        ("views", "way", "hand"),
        columns,
        [(None, None, "both")],
    )
    yield summary("by object", rows, ("views", "way", "object"), columns)
    failed = [row for row in rows if row["reason"]]
    yield from (
        f"{views} view(s), {way}: {counts_of(failed, views, way)}"
        for views, way in dict.fromkeys((row["views"], row["way"]) for row in failed)
    )


def counts_of(rows: Sequence[Row], views: int, way: str) -> str:
    """Why trials failed, each reason with its count."""
    there: dict[str, int] = {}
    for row in rows:
        if (row["views"], row["way"]) == (views, way):
            there[row["reason"]] = there.get(row["reason"], 0) + 1
    return ", ".join(f"{text} {n}" for text, n in sorted(there.items(), key=lambda x: -x[1]))
