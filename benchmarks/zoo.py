"""Describe, check and try every hand of the zoo: a grasp that held, or why none did.

A hand gets tries in a fixed order, objects that fit it by seeds, until a grasp has held. Attempts
per try are limited, so that a try is the same on every machine; CPU time only ends the tries. Hands
are shipped, in installed packages, and in clones of public repositories.
"""

from __future__ import annotations

import re
import time
import tomllib
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import typer
from PIL import Image

from benchmarks.bench import NumberOption
from benchmarks.bench import Options as Shared
from benchmarks.summary import table_data
from planner.describe import check_hand, propose, write_proposal
from planner.describe.proposal import fitting_objects
from planner.errors import FileFormatError, NoGraspFoundError, NotFoundError, PlannerError
from planner.hand_loading import load_hand
from planner.hands.catalog import foreign_hand_names, hand_names
from planner.hands.hand import Hand
from planner.plan import GraspPlan
from planner.search.grasp import plan_grasp
from planner.system.package import models_dir
from planner.task import GraspTask
from sim.cli.common import make_folder
from sim.cli.options import AttemptsOption
from sim.tables import Row, number
from sim.trial import simulate

FORMAT = "opposable-zoo"

MODELS_FILE = Path(__file__).resolve().parents[1] / "docs" / "zoo" / "models.toml"
"""The list of published models, in the checkout."""

THUMBNAIL, QUALITY = (320, 240), 70
"""Pixels and WebP quality of a picture: some 6 kB."""

TWO_FINGERS = ("a gripper", "two fingers take part")
"""What ``check_hand`` says of a gripper of two fingers, which is refused by design."""

NOTHING: Row = {
    "status": "not usable",
    "reason": "",
    "fingers": [],
    "joints": None,
    "actuators": None,
    "couplings": [],
    "warnings": [],
    "tries": [],
    "grasp": None,
    "picture": "",
}
"""The row of a hand that cannot be used."""


@dataclass(frozen=True, kw_only=True)
class Options(Shared):
    """Seeds per object and hand, tried until a grasp has held."""

    hands: Annotated[
        list[str] | None,
        typer.Argument(help="Hands of the zoo; all if none is named.", metavar="[HAND]..."),
    ] = None
    n: NumberOption = 3
    max_attempts: AttemptsOption = 25
    models: Annotated[
        Path,
        typer.Option(help="Folder of clones, OWNER/NAME, of the repositories in the list."),
    ] = Path("models-of-others")
    listed: Annotated[Path, typer.Option("--list", help="List of models.", show_default=False)] = (
        MODELS_FILE
    )
    pictures: Annotated[
        Path | None, typer.Option(help="Folder for thumbnails; no pictures if none.")
    ] = None
    cpu_s: Annotated[
        float, typer.Option(min=0.0, help="CPU seconds per hand, then no further try.")
    ] = 20.0
    every: Annotated[
        bool,
        typer.Option("--every-shape", help="Box, cylinder and sphere are to be held.", metavar=""),
    ] = False


@dataclass(frozen=True, kw_only=True)
class ZooModel:
    """A hand of the zoo.

    Attributes:
        name: What the zoo calls it.
        source: "shipped", "package" or "repository".
        reference: What ``load_hand`` takes; for a repository, relative to the folder of clones.
        url: Where a reader finds the model; "" for those that ship.
        base: The body that is the hand's base, where the model holds more; else "".
    """

    name: str
    source: str
    reference: str
    url: str = ""
    base: str = ""

    @property
    def slug(self) -> str:
        """The name in a file's name."""
        letters = "".join(c if c.isalnum() else " " for c in self.name.lower())
        return "-".join(letters.split())


def zoo_models(file: Path = MODELS_FILE) -> list[ZooModel]:
    """All hands: those that ship, those in packages, those of the list.

    Raises:
        FileFormatError: The list cannot be read, or names two hands alike.
    """
    models = [ZooModel(name=name, source="shipped", reference=name) for name in hand_names()]
    models += [
        ZooModel(
            name=name,
            source="package",
            reference=name,
            url=f"https://pypi.org/project/{name.partition(':')[0]}/",
        )
        for name in foreign_hand_names()
    ]
    for entry in _read(file):
        where, commit = entry["repository"], entry["commit"]
        models += [
            ZooModel(
                name=name,
                source="repository",
                reference=f"{where}/{path}",
                url=_url(where, commit, path),
                base="".join(base),
            )
            for name, path, *base in entry["hands"]
        ]
    slugs = [model.slug for model in models]
    twice = sorted({slug for slug in slugs if slugs.count(slug) > 1})
    if twice:
        raise FileFormatError(f"{file} names hands alike: {', '.join(twice)}; rename one of each")
    return models


def chosen(models: list[ZooModel], names: list[str]) -> list[ZooModel]:
    """Those of some names, or of some references; all if none is named.

    Raises:
        NotFoundError: No hand of the zoo is called so.
    """
    by_name = {m.name: m for m in models} | {m.slug: m for m in models}
    by_name |= {m.reference: m for m in models}
    for name in names:
        if name not in by_name:
            raise NotFoundError("hand of the zoo", name, [m.name for m in models])
    return [by_name[name] for name in names] or models


def _url(repository: str, commit: str, path: str) -> str:
    """Where a file of a commit is read, or the release of a package of the owner ``pypi``."""
    owner, _, package = repository.partition("/")
    if owner == "pypi":
        return f"https://pypi.org/project/{package}/{commit}/"
    return f"https://github.com/{repository}/blob/{commit}/{path}"


def _read(file: Path) -> list[dict[str, Any]]:
    try:
        with file.open("rb") as stream:
            entries: list[dict[str, Any]] = tomllib.load(stream)["repositories"]
    except (OSError, KeyError, tomllib.TOMLDecodeError) as error:
        raise FileFormatError(f"cannot read the list of models {file}: {error}") from error
    wrong = [e for e in entries if {"repository", "commit", "hands"} - set(e)]
    if wrong:
        raise FileFormatError(f"{file}: an entry lacks repository, commit or hands: {wrong[0]}")
    return entries


def cases(options: Options) -> Iterator[Row]:
    """The hands that were asked for."""
    if options.pictures is not None:
        make_folder(options.pictures)
    asked: Row = {"n": options.n, "seed": options.seed, "max_attempts": options.max_attempts}
    asked |= {"cpu_limit_s": options.cpu_s, "every": options.every}
    for model in chosen(zoo_models(options.listed), options.hands or []):
        folders = {"folder": str(options.models), "pictures": str(options.pictures or "")}
        yield {**asdict(model), **folders, **asked, "slug": model.slug}


def without_folders(case: Row, text: object) -> str:
    """A message without the folders of this machine."""
    plain, folder = str(text), Path(case["folder"])
    for one in (folder.absolute(), folder, models_dir()):
        plain = plain.replace(f"{one}/", "")
    return re.sub(r"/[^\s'\"]*/site-packages/", "", plain)


def measure(case: Row) -> Row:
    """Load and check a hand, and let it grasp."""
    begin = time.process_time()
    row: Row = {**NOTHING, "model": case["reference"]}
    try:
        hand = _hand(case)
        report = check_hand(hand)
    except PlannerError as error:
        spent = round(time.process_time() - begin, 2)
        return row | {"reason": without_folders(case, error), "cpu_s": spent}
    row |= {
        "fingers": [{"name": f.name, "joints": len(f.joints)} for f in hand.fingers.values()],
        "joints": hand.nq,
        "actuators": len(hand.actuation.names),
        "couplings": list(report.couplings),
        "warnings": [
            {
                "level": f.level,
                "what": without_folders(case, f.what),
                "what_to_do": without_folders(case, f.what_to_do),
            }
            for f in report.findings
        ],
    }
    errors = [f.what for f in report.findings if f.level == "error"]
    if errors:
        refused = any(words in errors[0] for words in TWO_FINGERS)
        row |= {"status": "refused" if refused else row["status"]}
        row |= {"reason": without_folders(case, errors[0])}
    else:
        row |= _tried(case, hand, fitting_objects(report))
    return row | {"cpu_s": round(time.process_time() - begin, 2)}


def _hand(case: Row) -> Hand:
    """The hand; where its base has to be said, from the file that ``describe`` writes."""
    path = case["reference"]
    if case["source"] == "repository":
        path = str(Path(case["folder"]) / path)
    if not case["base"]:
        return load_hand(path)
    with TemporaryDirectory() as folder:
        file = Path(folder) / "hand.toml"
        write_proposal(propose(Path(path).absolute(), base_body=case["base"]), file)
        return load_hand(file)


def _tried(case: Row, hand: Hand, objects: Sequence[str]) -> Row:
    """Tries until a grasp holds: status, reason, tries, and the grasp."""
    begin = time.process_time()
    tries: list[Row] = []
    picture = ""
    missing = {_shape(o) for o in objects} if case["every"] else set()
    for seed, item in ((case["seed"] + s, o) for s in range(case["n"]) for o in objects):
        if case["every"] and _shape(item) not in missing:
            continue
        if tries and time.process_time() - begin > case["cpu_limit_s"]:
            break
        one: Row = {"object": item, "seed": seed, "found": False, "held": False, "reason": ""}
        tries.append(one)
        before = time.process_time()
        try:
            task, most = GraspTask.create(hand, item), case["max_attempts"]
            plan = plan_grasp(task, seed=seed, max_attempts=most)
            spent = round(time.process_time() - before, 2)
            one |= {"found": True, "attempts": plan.record.attempts, "cpu_s": spent}
            held, reason, slip, picture = _execute(case, plan)
        except PlannerError as error:
            made = error.attempts if isinstance(error, NoGraspFoundError) else ()
            spent = round(time.process_time() - before, 2)
            one |= {"reason": without_folders(case, error)}
            tries[-1] = {"attempts": len(made), "cpu_s": spent, **one}
            continue
        one |= {"held": held, "reason": reason}
        if held:
            missing.discard(_shape(item))
        if held and not missing:
            command = f"opposable run {case['reference']} {item} --seed {seed}"
            grasp = {
                **{name: one[name] for name in ("object", "seed", "attempts", "cpu_s")},
                "fingers": list(plan.task.finger_names),
                "epsilon": float(plan.quality.epsilon),
                "slip_mm": slip[0],
                "slip_deg": slip[1],
                "command": command,
            }
            return {"status": "held", "tries": tries, "grasp": grasp, "picture": picture}
    failed = [t for t in tries if not case["every"] or _shape(t["object"]) in missing]
    found = [t for t in failed if t["found"]]
    status = "did not hold" if found else "no grasp found"
    last = (found or failed)[0]["reason"] if failed else "not tried in the CPU time"
    reason = ", ".join([*sorted(missing), last])
    return {"status": status, "reason": reason, "tries": tries, "picture": picture}


def _shape(specification: str) -> str:
    """The shape of an object: "box" of "box:0.05x0.05x0.08"."""
    return specification.partition(":")[0]


def _execute(case: Row, plan: GraspPlan) -> tuple[bool, str, tuple[float, float], str]:
    """Whether a plan held, why not, how far the object moved (mm, degrees), and the picture."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "end.png" if case["pictures"] else None
        report = simulate(plan, picture=file)
        reason = "" if report.success else f"{report.reason}: {report.verdict.detail}"
        name = ""
        if case["pictures"] and report.picture is not None:
            name = f"{case['slug']}.webp"
            with Image.open(report.picture) as image:
                small = image.convert("RGB").resize(THUMBNAIL, Image.Resampling.LANCZOS)
                small.save(Path(case["pictures"]) / name, "WEBP", quality=QUALITY, method=6)
        return report.success, without_folders(case, reason), report.largest_slip, name


def counts(rows: Sequence[Row]) -> str:
    """How many hands came to what: "61 hands: 50 held, 3 refused"."""
    by_status = Counter(row["status"] for row in rows)
    parts = ", ".join(f"{n} {status}" for status, n in by_status.most_common())
    described = sum(row["joints"] is not None for row in rows)
    cpu_s = sum(row["cpu_s"] or 0.0 for row in rows)
    return f"{len(rows)} hands, {described} described: {parts}; {cpu_s:.0f} s of CPU"


def tables(result: Row) -> Iterator[Row | str]:
    """A line per hand, then the counts."""
    rows = [row for row in result["rows"] if not row["error"]]
    lines = []
    for row in rows:
        grasp = row["grasp"]
        told = f"{grasp['object']}, seed {grasp['seed']}" if grasp else row["reason"][:70]
        line = [row["name"], row["status"], told, str(len(row["fingers"]))]
        line += [number(row["joints"], 0), str(len(row["tries"]))]
        lines.append([*line, number(grasp and grasp["epsilon"], 3), number(row["cpu_s"], 1)])
    yield table_data(
        "hands",
        ("hand", "status", "grasp, or why none"),
        ("fingers", "joints", "tries", "epsilon", "CPU s"),
        lines,
    )
    yield counts(rows)
