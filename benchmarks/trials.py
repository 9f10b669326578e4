"""Time trials: CPU beside MuJoCo's steps alone with the same commands.

The steps alone are the same model from the same state with the commands of the trial, so that the
contacts are the same; a row says whether they end in the same state. Trial and steps alternate.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any

import mujoco
import numpy as np
import typer

from benchmarks.bench import HandOptions, ObjectsOption
from benchmarks.common import cells_of, plan_of
from benchmarks.summary import counted, of, summary
from planner.plan import GraspPlan
from sim.cli.execution import error_model_of
from sim.cli.options import ErrorModelOption, names
from sim.sensing.errors import ErrorModel
from sim.simulation import Simulation
from sim.tables import Row
from sim.trial import Trial


@dataclass(frozen=True, kw_only=True)
class Options(HandOptions):
    """Plans of the seed, under every controller; -n does not count."""

    objects: ObjectsOption = "sphere,box,cylinder"
    controllers: Annotated[str, typer.Option(help="Controllers, comma separated.")] = (
        "feedforward,impedance"
    )
    repeats: Annotated[int, typer.Option(min=1, help="Timings per cell; medians count.")] = 3
    error_model: ErrorModelOption = "ideal"


def cases(options: Options) -> Iterator[Row]:
    """Every controller with every hand and object."""
    given = {"seed": options.seed, "repeats": options.repeats}
    error_model = error_model_of(options.error_model)
    for controller in names(options.controllers):
        for cell in cells_of(options.hand_names, options.objects):
            yield {"controller": controller, **cell, **given, "error_model": error_model}


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
    plan: GraspPlan, controller: str, repeats: int = 3, error_model: ErrorModel | None = None
) -> Row:
    """Medians of CPU times, s: building, the trial, MuJoCo's steps alone, and the report's data.

    The first trial, which is not counted, warms up and gives the commands. The report's data are
    those of its file: closure, epsilon and min-weight of every sample are computed for it.
    """
    first = Trial(plan, controller=controller, error_model=error_model)
    replay = Replay(first.simulation)
    report = first.run(on_step=replay)
    spent: dict[str, list[float]] = {"build_s": [], "trial_s": [], "steps_s": [], "report_s": []}
    for _ in range(repeats):
        begin = time.process_time()
        trial = Trial(plan, controller=controller, error_model=error_model)
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
        "same_state": replay.same,
        "end": (report.reason or "held") if replay.same else "the steps alone end in another state",
    }


def measure(case: Row) -> Row:
    """Plan and time one cell."""
    plan = plan_of(case["hand"], case["spec"], case["seed"])
    return time_trial(
        plan, case["controller"], case["repeats"], case["error_model"].seeded(case["seed"])
    )


def tables(result: Row) -> Iterator[Row]:
    """A line per hand, object and controller, and the medians of each controller."""
    yield summary(
        "CPU time of trials, one core; trial / steps: with the same commands, contacts, steps",
        result["rows"],
        ("controller", "hand", "object"),
        {
            "steps": of("steps", digits=0),
            "steps alone, s": of("steps_s", digits=3),
            "trial, s": of("trial_s", digits=3),
            "trial / steps": of("ratio"),
            "build, s": of("build_s", digits=3),
            "report, s": of("report_s", digits=3),
            "end": counted("end"),
        },
        [(None, "all", "median")],
    )
