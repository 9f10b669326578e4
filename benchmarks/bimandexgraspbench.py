"""Have BimanDexGraspBench, unchanged, evaluate batches of grasps by two hands, at several masses.

Its model of two Shadow hands on arms is taken apart into two hands that plan as a pair; their
grasps are written for that model as it is (``planner.exchange.dexgraspbench.pairs``), and its test
``fc`` pushes the object from six sides with ten times its mass. Without a batch, the benchmark and
the pair's description are only set up.
"""

from __future__ import annotations

import copy
import shutil
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.markup import escape

from benchmarks.bench import Options as Shared
from benchmarks.dexgraspbench import Installed, evaluated, install
from benchmarks.summary import count, of, share, summary
from planner.batch import GraspSet
from planner.describe import propose, write_proposal
from planner.errors import TaskError
from planner.exchange.dexgraspbench.models import file_name, write_object
from planner.exchange.dexgraspbench.pairs import PairModel, pair_dict, pair_squeeze
from sim.cli.common import err, out, say
from sim.tables import Row

COMMIT = "48ef8a6"
"""Of https://github.com/DexGrasp-TH/BimanDexGraspBench."""

HAND = "dual_dummy_arm_shadow"
"""The benchmark's model of two Shadow hands on arms of three slides and three hinges."""

MODEL = Path("assets", "hand", HAND, f"{HAND}.xml")
"""Its file in a checkout."""

SIDES = {"right": "rh", "left": "lh"}
"""Names of the hands, and how names of their parts begin."""

SLICES = 5
"""Into how many the plates of a palm are cut: the same solid, of which the heel is then the largest
part, with which the planner's palm touches. It lies proud of the plates."""

PLATE = 0.04
"""Half length (m) above which a box of the palm is such a plate."""

PAIR = """schema = 1
name = "biman_shadow"
summary = "the two Shadow hands of BimanDexGraspBench"

[[hands]]
name = "right"
hand = "right.toml"
position = [0.0, -0.25, 0.0]
quaternion_wxyz = [0.0, 0.0, 0.0, 1.0]

[[hands]]
name = "left"
hand = "left.toml"
position = [0.0, 0.25, 0.0]
quaternion_wxyz = [1.0, 0.0, 0.0, 0.0]

# the servos of the benchmark's arms
[carriage]
stiffness = 1000.0
turn_stiffness = 100.0
"""


@dataclass(frozen=True, kw_only=True)
class Options(Shared):
    """All grasps of the batches; neither -n nor --seed counts."""

    batches: Annotated[
        list[Path] | None,
        typer.Argument(help="Folders of batches; without one, only sets up.", metavar="[BATCH]..."),
    ] = None
    benchmark: Annotated[
        str, typer.Option(help="Path or URL of BimanDexGraspBench's git repository.")
    ] = "https://github.com/DexGrasp-TH/BimanDexGraspBench"
    home: Annotated[
        Path, typer.Option(help="Folder for environment, checkout, export and results.")
    ] = Path("bimandexgraspbench")
    masses: Annotated[
        str, typer.Option(help="Masses of the object in its test, kg, comma separated.")
    ] = "0.1,3"


def cases(options: Options) -> Iterator[Row]:
    """The benchmark's verdicts, which go on where an evaluation ended.

    Raises:
        PlannerError: A batch cannot be read or exported, or the benchmark fails.
    """
    masses = _masses(options.masses)
    batches = {folder: GraspSet(folder) for folder in options.batches or ()}
    installed = install(options.home, options.benchmark, commit=COMMIT)
    pair = _write_pair(installed, options.home.resolve() / "pair")
    if not batches:
        say(out, escape(f"plan with: opposable batch {pair} ... --type palms --table none"))
    for folder, batch in batches.items():
        home = options.home.resolve() / file_name(folder.resolve().name)
        made = _export(batch, installed.checkout / MODEL, home / "export")
        told = [f"hand={HAND}", "setting=fc"]
        rows = {
            mass: evaluated(
                installed, home, HAND, f"{mass:g}kg", [*told, f"task.obj_mass={mass}"], options
            )
            for mass in masses
        }
        for file, (label, number) in made.items():
            here = {f"{mass:g}kg": rows[mass][file] for mass in masses}
            yield {
                "object": label,
                "batch": str(folder),
                "row": number,
                "penetration_mm": 1e3 * next(iter(here.values()))["ho_pene"],
                **{f"{name}_held": bool(row["succ_flag"]) for name, row in here.items()},
                **{f"{name}_moved_mm": 1e3 * row["delta_pos"] for name, row in here.items()},
                **{f"{name}_turned_deg": row["delta_angle"] for name, row in here.items()},
            }


def measure(case: Row) -> Row:
    """Nothing more: the benchmark has judged."""
    return {}


def _masses(text: str) -> list[float]:
    try:
        masses = [float(word) for word in text.split(",")]
    except ValueError:
        masses = []
    if not masses or not all(np.isfinite(m) and m > 0 for m in masses):
        raise TaskError(f"--masses {text!r} are no masses in kg; give for example 0.1,3")
    return masses


def _write_pair(installed: Installed, folder: Path) -> Path:
    """The description of the pair, with its two hands out of the benchmark's model."""
    described = folder / "hand.toml"
    if described.exists():
        return described
    folder.mkdir(parents=True, exist_ok=True)
    for side, prefix in SIDES.items():
        model = folder / f"{side}.xml"
        model.write_text(_one_hand(installed.checkout / MODEL, prefix), encoding="utf-8")
        write_proposal(propose(model), folder / f"{side}.toml")
    described.write_text(PAIR, encoding="utf-8")
    return described


def _one_hand(path: Path, prefix: str) -> str:
    """MJCF of one hand of the benchmark's model, without its arm."""
    root = ET.parse(path).getroot()
    world, asset = _part(root, "worldbody"), _part(root, "asset")
    palm = next(b for b in world.iter("body") if b.get("name") == f"{prefix}_palm")
    world[:] = [palm]
    for plate in [g for g in palm.findall("geom") if _is_plate(g)]:
        at = list(palm).index(plate)
        palm[at : at + 1] = list(_sliced(plate))
    for name in ("contact", "actuator"):
        part = _part(root, name)
        part[:] = [
            one for one in part if str(one.get("joint", one.get("body1"))).startswith(f"{prefix}_")
        ]
    asset[:] = [
        one for one in asset if one.tag != "mesh" or str(one.get("name")).startswith(prefix)
    ]
    _part(root, "compiler").set("meshdir", str(path.parent.resolve()))
    return ET.tostring(root, encoding="unicode")


def _part(root: ET.Element, name: str) -> ET.Element:
    found = root.find(name)
    if found is None:
        raise TaskError(f"BimanDexGraspBench's model has no <{name}>; is it commit {COMMIT}?")
    return found


def _is_plate(geom: ET.Element) -> bool:
    size = [float(v) for v in str(geom.get("size", "0")).split()]
    return geom.get("type") == "box" and geom.get("quat") is None and size[-1] > PLATE


def _sliced(plate: ET.Element) -> Iterator[ET.Element]:
    x, y, z = (float(v) for v in str(plate.get("size")).split())
    left, front, middle = (float(v) for v in str(plate.get("pos")).split())
    for k in range(SLICES):
        piece = copy.deepcopy(plate)
        piece.set("size", f"{x} {y} {z / SLICES:.9g}")
        piece.set("pos", f"{left} {front} {middle + z * ((2 * k + 1) / SLICES - 1):.9g}")
        yield piece


def _export(batch: GraspSet, model: Path, folder: Path) -> dict[str, tuple[str, int]]:
    """Write the grasps of a batch; file, OBJECT/K.npy -> object and row.

    Raises:
        TaskError: The hand is not the pair.
    """
    shutil.rmtree(folder, ignore_errors=True)
    made: dict[str, tuple[str, int]] = {}
    left_out: Counter[str] = Counter()
    arms = PairModel.of(model, batch.task(batch.labels[0]).hand)
    for label in batch.labels:
        task, place = batch.task(label), folder / "object" / file_name(label)
        write_object(task, place)
        target = folder / "graspdata" / HAND / file_name(label)
        target.mkdir(parents=True)
        for number, row in batch.found(label):
            plan = batch.plan(number)
            squeeze = pair_squeeze(plan, task.object.mass)
            if squeeze.reason:
                left_out[squeeze.reason.split(";")[0]] += 1
                continue
            file = target / f"{row['k']}.npy"
            np.save(file, np.array(pair_dict(plan, squeeze, arms, place)), allow_pickle=True)
            made[f"{target.name}/{file.name}"] = label, number
    for reason, n in left_out.items():
        say(err, escape(f"{n} grasps left out: {reason}"))
    return made


def tables(result: Row) -> Iterator[Row]:
    """Shares that hold, movement and penetration per object."""
    names = [f"{mass:g}kg" for mass in _masses(result["setting"]["masses"])]
    columns: dict[str, Any] = {"grasps": count}
    for name in names:
        columns[f"{name} held"] = share(f"{name}_held")
        columns[f"{name} mm"] = of(f"{name}_moved_mm")
        columns[f"{name} deg"] = of(f"{name}_turned_deg")
    yield summary(
        "BimanDexGraspBench, fc: grasps that hold at each mass, and how far the object moved and "
        "turned at the end of the last push, median; mm of hand in object, worst",
        result["rows"],
        ("object",),
        columns | {"mm in object": of("penetration_mm", "max")},
        [("all",)],
    )
