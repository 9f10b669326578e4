"""``run_zoo``: load, check, plan and execute for every hand of the zoo; facts and a small picture.

A hand gets tries in a fixed order, objects that fit it by seeds, until a grasp has held. Attempts
per try are limited, so that a try is the same on every machine; CPU time only ends the tries.
"""

from __future__ import annotations

import re
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar

from PIL import Image

from benchmarks.run import Job, measure
from benchmarks.zoo.models import ZooModel
from benchmarks.zoo.objects import fitting_objects, fitting_width
from planner.describe import check_hand, propose, write_proposal
from planner.errors import NoGraspFoundError, PlannerError
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.plan import GraspPlan
from planner.search import plan_grasp
from planner.system.package import models_dir
from planner.task import GraspTask
from sim.runner import Check, Runner
from sim.tables import Row
from sim.trial import simulate

FORMAT = "opposable-zoo"

MAX_ATTEMPTS = 25
"""Attempts per try."""

SEEDS = 3
"""Seeds per object."""

THUMBNAIL = (320, 240)
"""Pixels of a picture; WebP of quality ``QUALITY`` makes some 6 kB of it."""

QUALITY = 70

_TWO_FINGERS = ("a gripper", "two fingers take part")
"""What ``check_hand`` says of a gripper of two fingers, which is refused by design."""


@dataclass(frozen=True, kw_only=True)
class HandJob(Job):
    """One hand.

    Attributes:
        model: The hand.
        folder: Folder of the clones of repositories.
        pictures: Folder for pictures; None for none.
        cpu_s: CPU time (s) of tries after which no further one is begun.
        every: Whether a box, a cylinder and a sphere are to be held; else one of them.
    """

    model: ZooModel
    folder: Path
    pictures: Path | None
    cpu_s: float
    every: bool = False

    NOTHING: ClassVar[Row] = {"status": "not usable", "reason": "", "fingers": []} | {
        "joints": None,
        "actuators": None,
        "couplings": [],
        "warnings": [],
        "tries": [],
        "grasp": None,
        "picture": "",
        "cpu_s": None,
    }

    @property
    def path(self) -> str:
        """What ``load_hand`` takes here."""
        if self.model.source != "repository":
            return self.model.reference
        return str(self.folder / self.model.reference)

    def row(self, **values: Any) -> Row:
        """The row: what is not given stands for a hand that cannot be used."""
        m = self.model
        told = {"name": m.name, "slug": m.slug, "source": m.source, "model": m.reference}
        return super().row(**{**told, "url": m.url, **self.NOTHING, **values})

    def lost(self, reason: str) -> Row:
        """The row of a hand that could not be looked at."""
        return self.row(reason=reason)

    def told(self, text: object) -> str:
        """A message without the folders of this machine."""
        plain = str(text)
        for folder in (self.folder.absolute(), self.folder, models_dir()):
            plain = plain.replace(f"{folder}/", "")
        return re.sub(r"/[^\s'\"]*/site-packages/", "", plain)


def look_at(job: HandJob, check: Check) -> Row:
    """Load and check a hand, and let it grasp."""
    begin = time.process_time()
    try:
        hand = _hand(job)
        report = check_hand(hand)
    except PlannerError as error:
        return job.row(reason=job.told(error), cpu_s=round(time.process_time() - begin, 2))
    check()
    facts: Row = {
        "fingers": [{"name": f.name, "joints": len(f.joints)} for f in hand.fingers.values()],
        "joints": hand.nq,
        "actuators": len(hand.actuation.names),
        "couplings": list(report.couplings),
        "warnings": [
            {"level": f.level, "what": job.told(f.what), "what_to_do": job.told(f.what_to_do)}
            for f in report.findings
        ],
    }
    errors = [f.what for f in report.findings if f.level == "error"]
    if errors:
        refused = any(words in errors[0] for words in _TWO_FINGERS)
        status = "refused" if refused else "not usable"
        facts |= {"status": status, "reason": job.told(errors[0])}
    else:
        facts |= _grasp(job, hand, fitting_objects(fitting_width(report)), check)
    return job.row(**facts, cpu_s=round(time.process_time() - begin, 2))


def _hand(job: HandJob) -> Hand:
    """The hand; where its base has to be said, from the file that ``describe`` writes."""
    if not job.model.base:
        return load_hand(job.path)
    with TemporaryDirectory() as folder:
        file = Path(folder) / "hand.toml"
        write_proposal(propose(Path(job.path).absolute(), base_body=job.model.base), file)
        return load_hand(file)


def _grasp(job: HandJob, hand: Hand, objects: Sequence[str], check: Check) -> Row:
    """Tries until a grasp holds: status, reason, tries, and the grasp."""
    begin = time.process_time()
    tries: list[Row] = []
    picture = ""
    missing = {_shape(o) for o in objects} if job.every else set()
    for seed, item in ((s, o) for s in range(SEEDS) for o in objects):
        if job.every and _shape(item) not in missing:
            continue
        if tries and time.process_time() - begin > job.cpu_s:
            break
        one: Row = {"object": item, "seed": seed, "found": False, "held": False, "reason": ""}
        tries.append(one)
        before = time.process_time()
        try:
            plan = plan_grasp(
                GraspTask.create(hand, item),
                seed=seed,
                max_attempts=MAX_ATTEMPTS,
                progress=lambda _: check(),
            )
        except PlannerError as error:
            made = error.attempts if isinstance(error, NoGraspFoundError) else ()
            one |= {"attempts": len(made), "reason": job.told(error)}
            one["cpu_s"] = round(time.process_time() - before, 2)
            continue
        one |= {"found": True, "attempts": plan.record.attempts}
        one["cpu_s"] = round(time.process_time() - before, 2)
        try:
            held, reason, slip, picture = _execute(job, plan)
        except PlannerError as error:
            one["reason"] = job.told(error)
            continue
        one |= {"held": held, "reason": reason}
        check()
        if held:
            missing.discard(_shape(item))
        if held and not missing:
            return {
                "status": "held",
                "tries": tries,
                "grasp": _facts(job, plan, one, slip),
                "picture": picture,
            }
    failed = [t for t in tries if not job.every or _shape(t["object"]) in missing]
    found = [t for t in failed if t["found"]]
    status = "did not hold" if found else "no grasp found"
    last = (found or failed)[0]["reason"] if failed else "not tried in the CPU time"
    reason = ", ".join([*sorted(missing), last])
    return {"status": status, "reason": reason, "tries": tries, "picture": picture}


def _shape(specification: str) -> str:
    """The shape of an object: "box" of "box:0.05x0.05x0.08"."""
    return specification.partition(":")[0]


def _facts(job: HandJob, plan: GraspPlan, tried: Row, slip: tuple[float, float]) -> Row:
    """What the zoo tells of a grasp that held."""
    item, seed = tried["object"], tried["seed"]
    return {
        "object": item,
        "seed": seed,
        "attempts": tried["attempts"],
        "cpu_s": tried["cpu_s"],
        "fingers": list(plan.task.finger_names),
        "epsilon": float(plan.quality.epsilon),
        "slip_mm": slip[0],
        "slip_deg": slip[1],
        "command": f"opposable run {job.model.reference} {item} --seed {seed}",
    }


def _execute(job: HandJob, plan: GraspPlan) -> tuple[bool, str, tuple[float, float], str]:
    """Whether a plan held, why not, how far the object moved (mm, degrees), and the picture."""
    with TemporaryDirectory() as folder:
        file = None if job.pictures is None else Path(folder) / "end.png"
        report = simulate(plan, picture=file)
        reason = "" if report.success else f"{report.reason}: {report.verdict.detail}"
        name = ""
        if job.pictures is not None and report.picture is not None:
            name = f"{job.model.slug}.webp"
            save_thumbnail(report.picture, job.pictures / name)
        return report.success, job.told(reason), report.largest_slip, name


def save_thumbnail(picture: Path, target: Path, size: tuple[int, int] = THUMBNAIL) -> None:
    """A small WebP of a picture."""
    with Image.open(picture) as image:
        small = image.convert("RGB").resize(size, Image.Resampling.LANCZOS)
        small.save(target, "WEBP", quality=QUALITY, method=6)


def run_zoo(
    models: Sequence[ZooModel],
    *,
    folder: Path,
    pictures: Path | None,
    cpu_s: float,
    file: Path,
    runner: Runner,
    every: bool = False,
) -> Row:
    """Look at all hands that the file does not have yet.

    Args:
        models: The hands.
        folder: Folder of the clones of repositories.
        pictures: Folder for pictures; None for none.
        cpu_s: CPU time (s) per hand after which no further try is begun.
        file: Of the rows, one per hand.
        runner: Who works.
        every: Whether a box, a cylinder and a sphere are to be held; else one of them.
    """
    jobs = [
        HandJob(index=k, model=model, folder=folder, pictures=pictures, cpu_s=cpu_s, every=every)
        for k, model in enumerate(models)
    ]
    asked = {"format": f"{FORMAT}-rows", "version": 1, "cpu_s": cpu_s}
    asked["hands"] = [model.name for model in models]
    asked |= {"every": True} if every else {}
    return measure(
        runner,
        look_at,
        jobs,
        kind=FORMAT,
        title="hands",
        lost=HandJob.lost,
        file=file,
        asked=asked,
        attempts_per_try=MAX_ATTEMPTS,
        seeds=SEEDS,
        cpu_s=cpu_s,
    )
