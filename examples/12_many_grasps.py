"""Plan many grasps on all cores into a Parquet dataset, and see how different they are.

Interrupt it and start it again: it goes on. Grasp k of an object is the same however many workers
there are and whatever else is in the batch. Prints what was found, how diverse it is beside as many
random starts of the search, what is left without near-duplicates, and one plan made whole again.
Needs pyarrow: pip install 'opposable[batch]'. On a cluster: make a dask.distributed.Client first,
and say backend="dask".
"""

from __future__ import annotations

from collections import Counter

from planner import write_plan
from planner.batch import BatchProgress, GraspFeatures, diversity, plan_grasps

HAND = "allegro_hand"
OBJECTS = ["sphere", "cylinder:0.03x0.1"]
N = 12
SEED = 0


def show(now: BatchProgress) -> None:
    """Say how far it is, now and then."""
    if now.done % 8 == 0:
        print(f"{now.done} of {now.total} planned")


if __name__ == "__main__":  # workers import this file
    grasps = plan_grasps(HAND, OBJECTS, N, seed=SEED, out="grasps", progress=show)
    print(f"found {sum(1 for _ in grasps.found())} of {grasps.manifest.total}")

    table = grasps.table(["object", "attempts", "epsilon"])
    print(f"columns {table.column_names}, {table.num_rows} rows")
    reasons = Counter(a["reason"].split(":")[0] for a in grasps.attempts().to_pylist())
    print(f"attempts by reason: {dict(reasons)}")  # no reason: it was found

    for label in grasps.labels:
        found = grasps.diversity(label)
        task = grasps.task(label)
        starts = GraspFeatures.of_random_starts(task, max(1, found.n), seed=SEED)
        random = diversity(starts, task.object.shape)
        print(
            f"{label}: {found.n_distinct} of {found.n} distinct; directions "
            f"{found.approach_entropy:.2f} nats ({random.approach_entropy:.2f} of random starts); "
            f"surface touched {found.surface_share:.2f} ({random.surface_share:.2f})"
        )

    best = int(grasps.thinned(grasps.labels[0])[0])
    plan = grasps.plan(best)
    write_plan(plan, "plan.json")
    print(f"row {best} is a plan again: {plan.quality.closure.reason}")
