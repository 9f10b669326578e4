"""``learn``: a policy by imitation of the planner's closed loop, and what is kept of it on disk.

    round 0       the playback drives, and the teacher says what it would do
    round i > 0   the policy of the round before drives, and the teacher likewise (DAgger)

Each round's policy is fitted anew to the episodes of all rounds so far. A folder keeps them:

    learn.json           what was asked for
    plans/               plans
    episodes/NNNNN.npz   samples and verdict of one episode
    rounds/NN.npz        policy after a round
    progress.csv         a row for each episode, curves.png a picture of it
    policy.npz           the newest policy

An episode depends on the seed, its number and the policy that drove it; a fit on the episodes. So
what was interrupted goes on from its folder, and ends as if it had not been.

Episodes to learn from: which trial each one is, how it is run, and its file.

``draw_curves``: how often each round succeeded and how far it turned, as a picture.

``fit``: a policy from samples, by scikit-learn's multilayer perceptron.

scikit-learn is the smallest of the well-kept trainers (10 MB; PyTorch for the CPU takes 200, JAX
with optax 100), and a network of 10,000 weights needs nothing that it lacks. The same samples and
seed give the same policy on one machine.
"""

from __future__ import annotations

import csv
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.arrays import check_fields
from planner.errors import FileFormatError, TaskError
from planner.files import read_json, write_json
from planner.files.disk import refuse_other_request, whole_file
from planner.motion.verify import ASKED_SHARE
from sim.learning.controller import Demonstrator
from sim.learning.policy import (
    ACTION_SCALE,
    RATE_HZ,
    Policy,
    PolicyFor,
    error_numbers,
    normalised,
    physics_numbers,
)
from sim.learning.senses import checked_senses, columns
from sim.learning.trials import Conditions, Plans, TurnTask
from sim.manipulation import ManipulationReport
from sim.manipulation.log import force_limit
from sim.sensing.estimation import NONE, check_estimator

_DAMAGED = (OSError, ValueError, KeyError, EOFError)


@dataclass(frozen=True, kw_only=True, eq=False)
class Episode:
    """What was seen and wanted in one trial.

    Attributes:
        senses: (k, m), all inputs that a policy can have (``senses.SENSES``), at k decisions.
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


SIZE, DPI = (7.0, 5.0), 100
"""Of the picture, inches, and dots per inch."""


def draw_curves(rows: Sequence[dict[str, Any]], path: Path) -> bool:
    """Draw the rows of ``progress.csv``; returns whether matplotlib is there to draw them.

    Args:
        rows: A row for each episode.
        path: The picture (PNG).
    """
    if find_spec("matplotlib") is None:
        return False
    from matplotlib.figure import Figure

    figure = Figure(figsize=SIZE, dpi=DPI, layout="constrained")
    rates, turns = figure.subplots(2, 1, sharex=True)
    numbers = sorted({row["round"] for row in rows})
    for key, label in (("success", "turned, not dropped"), ("strict", "with closure")):
        share = [np.mean([row[key] for row in rows if row["round"] == k]) for k in numbers]
        rates.plot(numbers, 100.0 * np.array(share), "o-", label=label)
    teacher = [next(row["teacher_share"] for row in rows if row["round"] == k) for k in numbers]
    rates.plot(numbers, 100.0 * np.array(teacher), ":", color="gray", label="teacher drives")
    rates.set(ylabel="% of episodes, or of time", ylim=(-3, 103))
    rates.legend(loc="lower left")
    rates.grid(alpha=0.3)
    known = [row for row in rows if np.isfinite(row["turned_deg"])]
    spread = [0.6 * (row["episode"] % 7 / 7.0 - 0.5) for row in known]
    turns.scatter(
        [row["round"] + s for row, s in zip(known, spread, strict=True)],
        [row["turned_deg"] for row in known],
        s=9,
        c=["C2" if row["strict"] else "C3" for row in known],
    )
    turns.set(
        xlabel="round; 0 is the playback alone",
        ylabel="turned, degrees\n(green: with closure)",
        xticks=numbers,
    )
    turns.grid(alpha=0.3)
    figure.savefig(path)
    return True


HIDDEN = (64, 64)
"""Units of the hidden layers."""

STAGES = ((1e-3, 0.6), (3e-4, 0.25), (1e-4, 0.15))
"""Learning rates, and the share of the epochs with each."""

BATCH, DECAY = 256, 30.0
"""Samples per step of Adam, and scikit-learn's ``alpha``, which it divides by them. So strong a
decay explains 0.5 of the squares of the actions wanted in unseen episodes, 1.0 only 0.3 (33
episodes of round 0: errors of joints are drawn once per episode, and so few are learned by
heart)."""

LEAST_SCALE = 1e-2
"""Least standard deviation by which a sense is divided: one that never changed stays near 0."""

NEEDS_SKLEARN = (
    'training needs scikit-learn: pip install "opposable[learn]"; running a policy does not'
)


def fit(
    about: PolicyFor,
    senses: NDArray[np.float32],
    wanted: NDArray[np.float32],
    *,
    epochs: int,
    seed: int,
) -> Policy:
    """A policy that gives the wanted actions for the senses, least squares.

    Args:
        about: What it is for.
        senses: (k, m).
        wanted: (k, nu), in [-1, 1].
        epochs: Passes over all samples.
        seed: Of first weights and order.

    Raises:
        TaskError: scikit-learn is not installed, or there are no samples.
    """
    if len(senses) == 0:
        raise TaskError("there are no samples to learn from; collect episodes first")
    mean, scale = senses.mean(axis=0), np.maximum(senses.std(axis=0), np.float32(LEAST_SCALE))
    # actions are a few hundredths, and first weights are made for outputs of size 1
    unit = max(float(wanted.std()), LEAST_SCALE)
    inputs = normalised(senses, mean, scale)
    network = trained_network(inputs, wanted / unit, epochs=epochs, seed=seed)
    weights, biases = list(network.coefs_), list(network.intercepts_)
    weights[-1], biases[-1] = unit * weights[-1], unit * biases[-1]
    return Policy(
        about=about,
        mean=mean,
        scale=scale,
        weights=tuple(w.astype(np.float32) for w in weights),
        biases=tuple(b.astype(np.float32) for b in biases),
    )


def trained_network(
    inputs: NDArray[np.float32], wanted: NDArray[np.float32], *, epochs: int, seed: int
) -> Any:
    """scikit-learn's ``MLPRegressor`` after so many passes over the samples, at falling rates.

    Raises:
        TaskError: scikit-learn is not installed.
    """
    try:
        from sklearn.exceptions import ConvergenceWarning
        from sklearn.neural_network import MLPRegressor
    except ImportError as error:
        raise TaskError(NEEDS_SKLEARN) from error
    network = MLPRegressor(
        hidden_layer_sizes=HIDDEN,
        batch_size=min(BATCH, len(inputs)),
        alpha=DECAY,
        random_state=seed,
        warm_start=True,
        tol=0.0,
        n_iter_no_change=epochs + 1,
    )
    for rate, share in STAGES:
        network.set_params(learning_rate_init=rate, max_iter=max(1, round(share * epochs)))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)  # the epochs are what was asked for
            network.fit(inputs, wanted)
    return network


LEARN_FORMAT, LEARN_VERSION = "opposable-learn", 2
"""What ``learn.json`` says it is."""


DEFAULT_SENSES = ("touch", "clock", "object")
"""Senses of a policy if none are given. In unseen episodes they explain 0.5 of the squares of the
actions wanted, the clock alone 0.3, and joints and plan add nothing (33 episodes of round 0)."""

ERROR_SAMPLES = 2000
"""Samples, about, by which the error of a fit is estimated."""


@dataclass(frozen=True, kw_only=True)
class Course:
    """How much is trained.

    Attributes:
        plans: Different plans that episodes draw from, in turn.
        demonstrations: Episodes of round 0.
        rounds: Rounds after it.
        episodes: Episodes of each of these.
        share: Share of the time in which the teacher drives in round 0; it halves from round to
            round. Where only the teacher drives, joints deviate because of its actions, and a
            policy learns the feedback with the wrong sign.
        noise: Noise on the teacher's actions while it drives (-).
        epochs: Passes over all samples in the fit of a round.
        senses: Inputs of the policy beside the plan.
        estimator: What tells it where the object is, a name out of ``sim.sensing.estimation``.
    """

    plans: int = 40
    demonstrations: int = 40
    rounds: int = 3
    episodes: int = 20
    share: float = 0.0
    noise: float = 0.0
    epochs: int = 16
    senses: tuple[str, ...] = DEFAULT_SENSES
    estimator: str = "touch"

    def __post_init__(self) -> None:
        """Check every number.

        Raises:
            PlannerError: Counts below 1 (rounds: 0), noise below 0, or no sense of a name.
        """
        check_fields(self, ("plans", "demonstrations", "episodes", "epochs"), least=1)
        check_fields(self, ("rounds",))
        check_fields(self, ("noise",), least=0.0, most=np.nextafter(1.0, 0.0))
        check_fields(self, ("share",), least=0.0, most=1.0)
        checked_senses(self.senses)
        check_estimator(self.estimator)

    def begins(self, number: int) -> int:
        """The first episode of a round."""
        return 0 if number == 0 else self.demonstrations + (number - 1) * self.episodes

    def teaches(self, number: int) -> float:
        """Share of the time in which the teacher drives in a round: it halves, and ends at 0."""
        return 0.0 if 0 < number == self.rounds else self.share * 0.5**number


@dataclass(frozen=True, kw_only=True)
class Progress:
    """What is done now.

    Attributes:
        round: Which round.
        episode: Episodes done.
        of: Episodes in all.
        strict: Successes with closure in this round so far.
        in_round: Episodes of this round so far.
        round_ends: Whether this was the last of them.
        fitted: Mean squared error of the newest fit; NaN before the first.
    """

    round: int
    episode: int
    of: int
    strict: int
    in_round: int
    round_ends: bool
    fitted: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Learned:
    """What came of it.

    Attributes:
        policy: The newest policy; None if it was interrupted before there was one.
        folder: Where everything is.
        rows: A row for each episode, as in ``progress.csv``.
        complete: Whether all rounds were made.
    """

    policy: Policy | None
    folder: Path
    rows: tuple[dict[str, Any], ...]
    complete: bool

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        by_round: dict[int, list[dict[str, Any]]] = {}
        for row in self.rows:
            by_round.setdefault(row["round"], []).append(row)
        return {
            "folder": str(self.folder),
            "policy": str(self.folder / POLICY) if self.policy is not None else None,
            "complete": self.complete,
            "rounds": [
                {
                    "round": number,
                    "teacher_share": rows[0]["teacher_share"],
                    "episodes": len(rows),
                    "success": sum(row["success"] for row in rows),
                    "success_with_closure": sum(row["strict"] for row in rows),
                }
                for number, rows in by_round.items()
            ],
        }


POLICY = "policy.npz"
"""The newest policy in a folder."""


def learn(
    task: TurnTask,
    course: Course,
    folder: Path,
    *,
    command: str = "",
    progress: Callable[[Progress], None] | None = None,
) -> Learned:
    """Train a policy, or go on with what a folder has.

    Ctrl-C (``KeyboardInterrupt``) leaves the folder as after the last episode.

    Args:
        task: What is to be learned.
        course: How much is trained.
        folder: Keeps everything; made if it is not there.
        command: What the policy's file says made it.
        progress: Called after every episode and fit.

    Raises:
        FileFormatError: The folder was begun with another task or course, or is damaged.
        TaskError: A trainer is not installed.
        NoGraspFoundError: There is no plan.
    """
    _begin(task, course, folder)
    plans = Plans(task, folder / "plans")
    about = PolicyFor.of(
        plans.hand,
        objects=task.objects,
        angle_deg=float(np.rad2deg(task.angle)),
        error_model=task.error_model.name,
        errors=error_numbers(task.error_model),
        physics=physics_numbers(task.physics),
        rate_hz=RATE_HZ,
        senses=checked_senses(course.senses),
        action_scale=ACTION_SCALE,
        estimator=course.estimator,
        command=command,
    )
    used = columns(plans.hand, about.senses)
    rows: list[dict[str, Any]] = []
    samples: list[Episode] = []
    policy: Policy | None = None
    error = float("nan")
    total = course.begins(course.rounds + 1)
    for number in range(course.rounds + 1):
        strict, begin, share = 0, course.begins(number), course.teaches(number)
        for k in range(begin, course.begins(number + 1)):
            episode = _episode(plans, k, course, folder, policy, share)
            samples.append(episode)
            strict += episode.strict
            rows.append(_row(number, k, share, episode))
            if progress is not None:
                progress(
                    Progress(
                        round=number,
                        episode=k + 1,
                        of=total,
                        strict=strict,
                        in_round=k + 1 - begin,
                        round_ends=k + 1 == course.begins(number + 1),
                        fitted=error,
                    )
                )
        _write_rows(rows, folder)
        policy, error = _fitted(about, samples, course, folder, number, task.seed, used)
        policy.save(folder / POLICY)
        draw_curves(rows, folder / "curves.png")
    return Learned(policy=policy, folder=folder, rows=tuple(rows), complete=True)


def _begin(task: TurnTask, course: Course, folder: Path) -> None:
    """Make the folder, or check that it was begun with the same.

    Raises:
        FileFormatError: It was not, or it cannot be made.
    """
    physics, error_model = task.physics.to_dict(), task.error_model.to_dict()
    request = {
        "format": LEARN_FORMAT,
        "version": LEARN_VERSION,
        "task": asdict(task) | {"physics": physics, "error_model": error_model},
        "course": asdict(course) | {"senses": list(checked_senses(course.senses))},
    }
    file = folder / "learn.json"
    if file.exists():
        there = read_json(file, "record of a training")
        refuse_other_request(folder, "training", there, request)
        return
    try:
        for name in ("plans", "episodes", "rounds"):
            (folder / name).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileFormatError(f"cannot make the folder {folder}: {error.strerror}") from error
    write_json(request, file)


def _episode(
    plans: Plans, number: int, course: Course, folder: Path, policy: Policy | None, share: float
) -> Episode:
    """The episode of a number: read, or run and kept."""
    file = folder / "episodes" / f"{number:05d}.npz"
    if file.exists():
        return read_episode(file)
    episode = run_episode(
        plans,
        number,
        count=course.plans,
        policy=policy,
        share=share,
        noise=course.noise,
        estimator=course.estimator,
    )
    episode.save(file)
    return episode


def _fitted(
    about: PolicyFor,
    samples: list[Episode],
    course: Course,
    folder: Path,
    number: int,
    seed: int,
    used: NDArray[np.intp],
) -> tuple[Policy, float]:
    """The policy of a round: read, or fitted and kept; and its mean squared error."""
    file = folder / "rounds" / f"{number:02d}.npz"
    senses = np.concatenate([e.senses for e in samples])[:, used]
    wanted = np.concatenate([e.wanted for e in samples])
    if file.exists():
        policy = Policy.load(file)
    else:
        policy = fit(about, senses, wanted, epochs=course.epochs, seed=seed + number)
        policy.save(file)
    some = slice(None, None, max(1, len(senses) // ERROR_SAMPLES))
    return policy, float(((policy.act(senses[some]) - wanted[some]) ** 2).mean())


def _row(number: int, k: int, share: float, episode: Episode) -> dict[str, Any]:
    return {
        "round": number,
        "episode": k,
        "teacher_share": share,
        "success": episode.success,
        "strict": episode.strict,
        "turned_deg": episode.turned_deg,
        "decisions": len(episode.senses),
        "reason": episode.reason,
        "cpu_s": episode.cpu_s,
    }


def _write_rows(rows: list[dict[str, Any]], folder: Path) -> None:
    with (folder / "progress.csv").open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
