"""``run_trial_cost``: CPU time of a trial beside that of MuJoCo's steps alone.

The steps alone are the same model from the same state with the commands of the trial, so that the
contacts are the same; a row says whether they end in the same state. Trial and steps alternate.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import mujoco
import numpy as np
from rich.table import Table

from benchmarks.objects import BenchObject
from benchmarks.requests import Setting, check_tasks, task_for
from benchmarks.run import ObjectJob, measure, stated
from planner.errors import PlannerError
from planner.plan import GraspPlan
from planner.search import plan_grasp
from sim.reality import Reality
from sim.runner import Check, Runner
from sim.simulation import Simulation
from sim.tables import Row, grouped, table_of
from sim.trial import Trial

FORMAT = "opposable-bench-trials"


@dataclass(frozen=True, kw_only=True)
class TrialCostJob(ObjectJob):
    """One plan under one controller.

    Attributes:
        controller: Name of the controller.
        seed: Of planning.
        repeats: How often trial and steps are timed; the row has the medians.
        reality: Errors of sensors, drives and object, drawn from the seed.
    """

    SHOWN: ClassVar = ("hand", "label", "controller")

    controller: str
    seed: int
    repeats: int
    reality: Reality = field(default_factory=Reality)


class Replay:
    """The commands of a trial, and the steps with them alone.

    Attributes:
        inputs: Commands and active equalities of every step.
        same: Whether the steps alone have always ended in the state in which the trial ended.
    """

    def __init__(self, simulation: Simulation) -> None:
        """Begin at the state that a simulation is in; be called after each of its steps."""
        self._model = simulation.scene.model
        self._start = self._copy(simulation.data)
        self.inputs: list[tuple[Any, ...]] = []
        self._end = np.zeros(0)
        self.same = True

    def __call__(self, simulation: Simulation) -> None:
        """Keep what the step was given."""
        data = simulation.data
        self.inputs.append((data.ctrl.copy(), data.eq_active.copy()))
        self._end = data.qpos.copy()

    def cpu_s(self) -> float:
        """CPU time of the steps alone, s."""
        model, data = self._model, self._copy(self._start)
        begin = time.process_time()
        for ctrl, active in self.inputs:
            data.ctrl[:] = ctrl
            data.eq_active[:] = active
            mujoco.mj_step(model, data)
        spent = time.process_time() - begin
        self.same &= np.array_equal(data.qpos, self._end)
        return spent

    def __len__(self) -> int:
        """Number of steps."""
        return len(self.inputs)

    def _copy(self, data: Any) -> Any:
        made = mujoco.MjData(self._model)
        mujoco.mj_copyData(made, self._model, data)
        return made


def time_trial(
    plan: GraspPlan, controller: str, repeats: int = 3, reality: Reality | None = None
) -> Row:
    """Medians of CPU times, s: building, the trial, MuJoCo's steps alone, and the report's data.

    The first trial, which is not counted, warms up and gives the commands. The report's data are
    those of its file: closure, epsilon and min-weight of every sample are computed for it.
    """
    first = Trial(plan, controller=controller, reality=reality)
    replay = Replay(first.simulation)
    report = first.run(on_step=replay)
    spent: dict[str, list[float]] = {"build_s": [], "trial_s": [], "steps_s": [], "report_s": []}
    for _ in range(repeats):
        begin = time.process_time()
        trial = Trial(plan, controller=controller, reality=reality)
        built = time.process_time()
        again = trial.run()
        ran = time.process_time()
        again.to_dict()
        spent["build_s"].append(built - begin)
        spent["trial_s"].append(ran - built)
        spent["report_s"].append(time.process_time() - ran)
        spent["steps_s"].append(replay.cpu_s())
    medians = {name: statistics.median(values) for name, values in spent.items()}
    ratios = [t / s for t, s in zip(spent["trial_s"], spent["steps_s"], strict=True)]
    return {
        "steps": len(replay),
        **medians,
        "ratio": statistics.median(ratios),
        "end": report.reason or "held",
        "same_state": replay.same,
    }


def cost_of(job: TrialCostJob, check: Check) -> Row:
    """Plan and time one job; ``check`` is called between attempts and may raise."""
    task = task_for(job.hand, job.spec, Setting())
    if isinstance(task, str):
        return job.lost(task)
    try:
        plan = plan_grasp(task, seed=job.seed, progress=lambda _: check())
    except PlannerError as error:
        return job.lost(str(error))
    row = time_trial(plan, job.controller, job.repeats, job.reality.seeded(job.seed))
    check()
    return job.row(**row)


def run_trial_cost(
    hands: Sequence[str],
    objects: Sequence[BenchObject],
    controllers: Sequence[str],
    *,
    seed: int,
    repeats: int,
    runner: Runner,
    reality: Reality | None = None,
) -> Row:
    """Time the trials of hands x objects x controllers, under a reality if one is given."""
    reality = reality or Reality()
    check_tasks(hands, objects)
    cells = [(h, item, c) for c in controllers for h in hands for item in objects]
    jobs = [
        TrialCostJob(
            index=k,
            hand=hand,
            spec=item.spec,
            label=item.label,
            controller=controller,
            seed=seed,
            repeats=repeats,
            reality=reality,
        )
        for k, (hand, item, controller) in enumerate(cells)
    ]
    return measure(
        runner,
        cost_of,
        jobs,
        kind=FORMAT,
        title="time trials",
        lost=TrialCostJob.lost,
        **stated(reality),
    )


COLUMNS = ("steps", "steps alone, s", "trial, s", "trial / steps", "build, s", "report, s", "end")


def trial_cost_table(result: Row) -> Table:
    """A line per hand, object and controller, and the medians of each controller."""
    title = "CPU time of trials, one core; trial / steps: with the same commands, contacts, steps"
    table = table_of(title, ("controller", "hand", "object"), COLUMNS)
    for (controller,), rows in grouped(result["rows"], "controller").items():
        timed = [row for row in rows if "error" not in row]
        for row in rows:
            cells = _cells(row) if "error" not in row else ["-"] * 6 + [row["error"]]
            table.add_row(controller, row["hand"], row["object"], *cells)
        if timed:
            names = ("steps", "steps_s", "trial_s", "ratio", "build_s", "report_s")
            middle = {name: statistics.median(row[name] for row in timed) for name in names}
            table.add_row(
                controller, "all", "median", *_cells(middle | {"end": "", "same_state": True})
            )
            table.add_section()
    return table


def _cells(row: Row) -> list[str]:
    return [
        f"{row['steps']:.0f}",
        f"{row['steps_s']:.3f}",
        f"{row['trial_s']:.3f}",
        f"{row['ratio']:.2f}",
        f"{row['build_s']:.3f}",
        f"{row['report_s']:.3f}",
        row["end"] if row["same_state"] else "the steps alone end in another state",
    ]
