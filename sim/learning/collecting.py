"""Episodes to learn from: which trial each one is, how it is run, and its file."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.errors import FileFormatError
from planner.files.whole import whole_file
from sim.estimation import NONE
from sim.learning.policy import Policy
from sim.learning.teacher import Demonstrator
from sim.learning.trials import Conditions, Plans
from sim.manipulation import ManipulationReport
from sim.manipulation.pressing import ASKED_SHARE, force_limit

_DAMAGED = (OSError, ValueError, KeyError, EOFError)


@dataclass(frozen=True, kw_only=True, eq=False)
class Episode:
    """What was seen and wanted in one trial.

    Attributes:
        senses: (k, m), all that a policy can be told (``senses.SENSES``), at k decisions.
        wanted: (k, nu), the teacher's actions.
        success: Turned as far as asked for, and not dropped.
        strict: The same with closure: nothing of ``ManipulationReport.faults``.
        turned_deg: Turn at the end of the hold, degrees; NaN if it never came to that.
        reason: Why it is no strict success, "" if it is.
        cpu_s: CPU time that it took, with the plan where that was made for it, s.
    """

    senses: NDArray[np.float32]
    wanted: NDArray[np.float32]
    success: bool
    strict: bool
    turned_deg: float
    reason: str
    cpu_s: float

    @classmethod
    def of(cls, driver: Demonstrator, report: ManipulationReport, cpu_s: float) -> Episode:
        """What a demonstrator kept of a run that took some CPU time (s)."""
        n, nu = driver.history.size, len(driver.action)
        return cls(
            senses=np.array(driver.senses, dtype=np.float32).reshape(-1, n),
            wanted=np.array(driver.wanted, dtype=np.float32).reshape(-1, nu),
            success=report.success,
            strict=report.success_with_closure,
            turned_deg=float(np.rad2deg(report.turned)),
            reason=report.reason or report.faults,
            cpu_s=cpu_s,
        )

    def save(self, path: Path) -> None:
        """Write it: all of it or nothing.

        Raises:
            FileFormatError: The file cannot be written.
        """
        with whole_file(path) as stream:
            np.savez_compressed(
                stream,
                allow_pickle=False,
                senses=self.senses,
                wanted=self.wanted,
                verdict=np.array([self.success, self.strict]),
                turned_deg=np.array(self.turned_deg),
                reason=np.array(self.reason),
                cpu_s=np.array(self.cpu_s),
            )


def read_episode(path: Path) -> Episode:
    """Read one back.

    Raises:
        FileFormatError: The file is damaged.
    """
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
            data: dict[str, Any] = {name: stored[name] for name in stored.files}
        success, strict = data["verdict"].tolist()
        return Episode(
            senses=data["senses"],
            wanted=data["wanted"],
            success=success,
            strict=strict,
            turned_deg=float(data["turned_deg"]),
            reason=str(data["reason"]),
            cpu_s=float(data["cpu_s"]),
        )
    except _DAMAGED as error:
        raise FileFormatError(
            f"{path} is damaged ({error}); remove it: it is made again"
        ) from error


def run_episode(
    plans: Plans,
    number: int,
    *,
    count: int,
    policy: Policy | None,
    share: float,
    noise: float,
    estimator: str = NONE,
) -> Episode:
    """Run the episode of a number: the same one for the same policy and seed of the plans.

    Args:
        plans: Plans, of which the first ``count`` take turns.
        number: Of the episode.
        count: How many plans there are to learn from.
        policy: Which policy drives where the teacher does not; the playback alone if None.
        share: Share of the time in which the teacher drives, 0 to 1.
        noise: Noise on the teacher's actions while it drives (-).
        estimator: What tells where the object is, a name, where there is no policy yet.

    Raises:
        NoGraspFoundError: There is no plan for it.
    """
    begin, task = time.process_time(), plans.task
    rng = np.random.default_rng([task.seed, number])
    plan = plans(number % count)
    limit = ASKED_SHARE * force_limit(plan)
    driver = Demonstrator(
        plan.grasp, policy, share=share, noise=noise, rng=rng, max_normal=limit, estimator=estimator
    )
    run = Conditions.draw(rng).run(task, plan, driver)
    driver.simulation = run.sim.simulation
    report = run.perform()
    return Episode.of(driver, report, time.process_time() - begin)
