"""``python -m tests.fuzz``: hostile inputs by class, a table of what became of them."""

from __future__ import annotations

import argparse
import sys
from contextlib import suppress
from pathlib import Path

from .harness import GOOD, Harness, Outcome, names, table

DEAR = ("caches", "models")
"""Classes whose inputs take seconds of processor time each."""


def main() -> int:
    """Run; 0 if every input got an answer or a named error, else 1. Ctrl-C ends with the table."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--class", dest="name", default="all", choices=["all", *names()])
    parser.add_argument("-n", type=int, default=1000, help="inputs per class")
    parser.add_argument("--dear", type=int, help=f"inputs of each of {', '.join(DEAR)}; else -n")
    parser.add_argument("--first", type=int, default=0, help="number of the first")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--replay", help="SEED:NUMBER of a single input of the class")
    parser.add_argument("--failures", type=Path, default=Path("fuzz-failures.txt"))
    parser.add_argument("--keep", type=Path, help="folder for what failing inputs consist of")
    given = parser.parse_args()
    seed, dear = given.seed, given.n if given.dear is None else given.dear
    chosen = names() if given.name == "all" else [given.name]
    cases = [
        (name, given.first + k) for name in chosen for k in range(dear if name in DEAR else given.n)
    ]
    if given.replay:
        seed, number = (int(part) for part in given.replay.split(":"))
        cases = [(name, number) for name in chosen]
    outcomes: list[Outcome] = []
    with Harness(seed, given.workers, given.keep) as harness, suppress(KeyboardInterrupt):
        for outcome in harness.run(cases):
            outcomes.append(outcome)
            if outcome.verdict not in GOOD or given.replay:
                head = f"{outcome.verdict}: --class {outcome.name} --replay {seed}:{outcome.number}"
                print(f"{head}\n{outcome.output}", flush=True)
                with given.failures.open("a", encoding="utf-8") as file:
                    file.write(f"{head}\n{outcome.output}\n")
    print(table(outcomes))
    return int(any(outcome.verdict not in GOOD for outcome in outcomes))


if __name__ == "__main__":
    sys.exit(main())
