"""Numbers on the command line. What would be sound and only long is not asked for."""

from __future__ import annotations

import math
from random import Random
from shutil import copy

from ..hostile import number_text, text
from ..samples import Samples

PLAN = ["plan", "allegro_hand", "sphere", "--max-attempts", "1", "--rounds", "0"]
BATCH = ["batch", "allegro_hand", "sphere", "-n", "1", "--max-attempts", "1", "--workers", "1"]
TEST = ["test", "plan.json", "--protocol", "forces", "--only", "force +z", "--workers", "1"]
TURN = ["manipulate", "allegro_hand", "cylinder", "--plan-only", "--max-attempts", "1"]
MOTION, GAIT = [*TURN, "--rotate", "3"], [*TURN, "--gait", "--rotate", "3"]

OPTIONS: tuple[tuple[list[str], tuple[str, ...]], ...] = (
    (PLAN, ("--mu", "--mass", "--density", "--stand", "--seed", "--pose", "--rounds")),
    (PLAN, ("--max-attempts", "--max-cpu-s", "--objective", "--task-wrench", "--touch")),
    (PLAN, ("--avoid", "--fingers", "--out", "--best-of", "--keep", "--metric", "-n")),
    (BATCH, ("--mu", "--mass", "--seed", "--workers", "-n", "--max-attempts")),
    (BATCH, ("--out",)),
    (["analyse", "plan.json", "--forces"], ("--rate", "--solvers", "--steps")),
    (["certify", "plan.json"], ("--samples", "--seed")),
    (["test", "plan.json"], ("--sim-mu", "--controller")),
    (TEST, ("--workers", "--seed", "--only", "--protocol", "--out")),
    (MOTION, ("--rotate", "--shift", "--mu", "--mass", "--seed", "--best-of")),
    (GAIT, ("--rotate", "--shift", "--mu", "--mass", "--seed")),
    (["crosscheck", "allegro_hand", "--no-own-reader", "--configurations", "1"],
     ("--kinematics", "--dynamics", "--distance", "--seed", "--timeout", "--normal")),
)  # fmt: skip

LONG = {
    "--max-attempts": 3, "--rounds": 3, "-n": 2, "--workers": 2, "--steps": 20, "--samples": 5,
    "--best-of": 2, "--rate": math.inf, "--max-cpu-s": 3,
}  # fmt: skip
"""Options whose large numbers are sound and take long: the largest that is asked for."""

SIZES = "sphere:{}", "box:{}x0.04x0.05", "cylinder:0.03x{}", "capsule:{}", "superquadric:{}", "{}"


def case(rng: Random, samples: Samples) -> list[str]:
    copy(samples.folder / "plan.json", "plan.json")
    if rng.random() < 0.2:
        shape = rng.choice(SIZES).format(number_text(rng))
        return [PLAN[0], PLAN[1], _clean(shape), *PLAN[3:]]
    command, options = rng.choice(OPTIONS)
    option = rng.choice(options)
    given = ",".join(number_text(rng) for _ in range(rng.choice([1, 1, 1, 3, 6])))
    if rng.random() < 0.1:
        given = text(rng)
    try:
        if not math.isnan(float(given)) and option in LONG:
            given = given if float(given) <= LONG[option] else "1"
            given = str(2**63) if option == "--workers" and rng.random() < 0.3 else given
    except (ValueError, OverflowError):
        pass
    if option == "--rate" and rng.random() < 0.5:
        command = [*command, "--solvers", "daqp", "--steps", "10"]
    return [*command, f"{option}={_clean(given)}" if option[1] == "-" else option, *(
        [] if option[1] == "-" else [_clean(given)]
    )]  # fmt: skip


def _clean(given: str) -> str:
    """As a shell can give it: no null characters."""
    return given.replace("\0", "").encode(errors="replace").decode()
