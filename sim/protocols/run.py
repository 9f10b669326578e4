"""``run_protocol``: all trials of a protocol, on all cores, with what is done kept.

Trials are independent of each other and of the number of workers: every one begins with the plan as
it is in its file, and one that cannot be run is an outcome with the reason "not run".
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeAlias

import mujoco
import numpy as np
from rich.console import Console

from planner.errors import FileFormatError, NotFoundError, PlannerError, TaskError
from planner.files import given_plan, plan_from_dict, plan_to_dict
from planner.hands.hand import Hand
from planner.plan import GraspPlan
from planner.system.plugins import plugin, plugin_names
from planner.task import GraspTask
from sim.controllers import AnyController, controller_maker, controller_name
from sim.estimation import NONE, AnyEstimator, estimator_name
from sim.physics import PRESETS, AnyPhysics, PhysicsOptions
from sim.protocols.dexgraspbench import (
    benchmark_contacts,
    benchmark_physics,
    dexgraspbench_cases,
    unsuitable_for_dexgraspbench,
)
from sim.protocols.disturbance import Settings
from sim.protocols.drake import drake_cases, drake_physics, unsuitable_for_drake
from sim.protocols.drake_scene import drake_missing
from sim.protocols.forces import forces_cases
from sim.protocols.outcome import Case, Conditions, Outcome
from sim.protocols.report import ProtocolReport
from sim.protocols.shake_pushes import on_an_arm, pushes_cases, shake_cases
from sim.protocols.variations import reality_cases, robust_cases, with_errors
from sim.reality import REALITIES, AnyReality, Drawn, drawn_numbers, drawn_text
from sim.recording import CHANNELS, Samples
from sim.runner import Runner, made_with
from sim.scene import build_scene
from sim.simulation import filmed
from sim.verdict import Fault

MakeCases: TypeAlias = Callable[[Settings, int], Sequence[Case]]

PROTOCOLS: Mapping[str, MakeCases] = MappingProxyType(
    {
        "dexgraspbench": lambda settings, seed: dexgraspbench_cases(),
        "forces": forces_cases,
        "shake": lambda settings, seed: shake_cases(settings),
        "robust": robust_cases,
        "drake": lambda settings, seed: drake_cases(),
        "reality": reality_cases,
        "pushes": pushes_cases,
    }
)
"""Name -> what makes the trials out of settings and the seed of random directions and errors.

Installed packages bring more (``planner.system.plugins``)."""

IN_ALL = tuple(name for name in PROTOCOLS if name not in ("drake", "reality", "pushes"))
"""Protocols that "all" stands for: "drake" needs another package, "reality" and "pushes" test the
controller more than the grasp; these are run by their names."""

REPLAYED = ("dexgraspbench", "drake")
"""Protocols with commands and numbers of their own, whatever controller and settings are."""

DRAWN_ANEW = ("reality", "pushes")
"""Protocols whose trials each draw errors anew; those of the others all have the same."""

_UNSUITABLE: Mapping[str, Callable[[GraspTask], str]] = {
    "dexgraspbench": lambda task: unsuitable_for_dexgraspbench(task.hand),
    "drake": lambda task: unsuitable_for_drake(task.hand),
    "shake": lambda task: on_an_arm(task.hand),
}
"""Name -> why the protocol cannot take a task, of those that cannot take every one."""


def cases_of(protocol: str, settings: Settings, seed: int) -> tuple[Case, ...]:
    """The trials of a protocol, in order.

    Raises:
        NotFoundError: There is no such protocol.
    """
    make = PROTOCOLS.get(protocol) or plugin("protocols", protocol)
    if make is None:
        raise NotFoundError("protocol", protocol, (*PROTOCOLS, *plugin_names("protocols")))
    return tuple(make(settings, seed))


def unsuitable(protocol: str, task: GraspTask) -> str:
    """Why a protocol cannot take a task; "" if it can."""
    return _UNSUITABLE[protocol](task) if protocol in _UNSUITABLE else ""


def trials_of(
    protocols: Collection[str], only: Collection[str], settings: Settings, seed: int
) -> dict[str, tuple[str, ...]]:
    """Which of some trials each protocol has; protocols that have none are left out.

    Args:
        protocols: Names of protocols.
        only: Names of trials; all trials of all protocols if empty.
        settings: Numbers of the protocols.
        seed: Of random directions and pose errors.

    Raises:
        NotFoundError: There is no such protocol, or none of them has a trial of a name.
    """
    there = {p: tuple(case.name for case in cases_of(p, settings, seed)) for p in protocols}
    known = [name for names in there.values() for name in names]
    for name in only:
        if name not in known:
            raise NotFoundError("trial", name, known)
    if not only:
        return there
    asked = {p: tuple(n for n in names if n in only) for p, names in there.items()}
    return {p: names for p, names in asked.items() if names}


@dataclass(frozen=True, kw_only=True, eq=False)
class _Job:
    """A case with what it needs in another process; plan is the text of a plan file."""

    plan: str
    case: Case
    conditions: Conditions
    video: Path | None


def run_protocol(
    plan: GraspPlan | Path | str,
    protocol: str,
    *,
    controller: AnyController | None = None,
    physics: AnyPhysics | None = None,
    settings: Settings | None = None,
    reality: AnyReality | None = None,
    estimator: AnyEstimator | None = None,
    seed: int = 0,
    workers: int = 1,
    only: Collection[str] = (),
    name: str = "",
    file: Path | None = None,
    video: Path | None = None,
    console: Console | None = None,
    check: Callable[[], None] = lambda: None,
) -> ProtocolReport:
    """Run a protocol; Ctrl-C ends it with what is done.

    Args:
        plan: What to test, or the path of its file.
        protocol: One of ``PROTOCOLS``, or one that an installed package brings.
        controller: A name ("feedforward", "impedance"), a controller, of which every trial gets a
            copy, or a class or function that makes one from the plan; "feedforward" if None.
            ``dexgraspbench`` and ``drake`` are always run by replayed postures.
        physics: How MuJoCo computes, or the name of a preset; defaults if None. ``dexgraspbench``
            has its own, and ``drake`` takes the friction alone.
        settings: Numbers of the protocols; defaults if None.
        reality: Errors of sensors, drives and object, or their name; none if None, or those of a
            laboratory in the protocol ``reality``, which draws them anew for every trial.
            ``dexgraspbench`` and ``drake`` have none.
        estimator: What tells the controller where the object is: a name, or what makes one; see
            ``sim.simulation.Simulation``.
        seed: Of random directions and pose errors.
        workers: Processes; 1 for this one, -1 for one per core. With more than one, the hand
            must be one that its plan file can name.
        only: Names of the trials to run, as a report has them; all if empty.
        name: What to call the plan in the report.
        file: JSON lines, one per trial, are written here as trials are finished.
        video: Film every trial into files of this name with the trial's number and name in it,
            such as ``films/box-003-force-+z.mp4`` for ``films/box.mp4``.
        console: Where the progress bar goes; none without.
        check: Called between trials; what it raises ends the run.

    Returns:
        The report; not ``complete`` after Ctrl-C.

    Raises:
        NotFoundError: There is no such protocol, controller or trial.
        TaskError: The protocol is not for this hand, the controller is none, ``workers`` is 0, or
            the protocol needs a package that is not installed.
        FileFormatError: ``file`` cannot be written.
    """
    begin = time.perf_counter()
    if workers == 0:
        raise TaskError("workers is 0; give the number of processes, or -1 for one per core")
    settings, plan = settings or Settings(), given_plan(plan)
    physics = benchmark_physics() if protocol == "dexgraspbench" else PRESETS.given(physics)
    (names,) = trials_of([protocol], only, settings, seed).values()
    cases = [case for case in cases_of(protocol, settings, seed) if case.name in names]
    make = controller_maker(controller)
    if reason := unsuitable(protocol, plan.task):
        raise TaskError(reason)
    if protocol == "drake" and (reason := drake_missing()):
        raise TaskError(reason)
    label = "replay" if protocol in REPLAYED else controller_name(controller)
    text = json.dumps(plan_to_dict(plan))
    reality = REALITIES.given(reality)
    if protocol == "reality":
        reality = with_errors(reality)  # the report then names what was drawn from
    conditions = Conditions(physics=physics, controller=make, reality=reality, estimator=estimator)
    jobs = [
        _Job(plan=text, case=case, conditions=conditions, video=_film(video, case))
        for case in cases
    ]
    _plan_of(text, plan.task.hand)
    outcomes: list[Outcome] = []
    lines = _Lines(file)

    def keep(outcome: Outcome) -> None:
        outcomes.append(outcome)
        lines.write({"plan": name, "protocol": protocol, "controller": label, **outcome.to_dict()})

    with lines:
        Runner(
            console=console or Console(quiet=True),
            check=check,
            workers=(os.cpu_count() or 1) if workers < 0 else workers,
        ).run(_run, jobs, title=f"{protocol} {name}".strip(), keep=keep, given_up=_not_run)
    if outcomes and all(o.reason == "not run" for o in outcomes):  # a mistake that all share
        assert outcomes[0].fault is not None
        raise TaskError(f"no trial could be run: {outcomes[0].fault.detail}")
    task = plan.task
    own = {} if protocol in REPLAYED else asdict(settings)
    if not (protocol in REPLAYED or reality.ideal):
        own["reality"] = reality.to_dict()
        if protocol not in DRAWN_ANEW:
            drawn = drawn_numbers(Drawn.of(reality, plan.task.hand), plan.task.hand)
            own["reality"]["drawn_in_words"] = drawn_text([drawn])
    if protocol not in REPLAYED and (used := estimator_name(estimator, reality)) != NONE:
        own["estimator"] = used
    stated = drake_physics(physics.mu) if protocol == "drake" else physics_of(plan, physics)
    if protocol == "dexgraspbench":
        stated |= benchmark_contacts()
    return ProtocolReport(
        protocol=protocol,
        plan=name,
        hand=task.hand.name,
        object=task.object.shape.spec,
        mass_kg=task.object.mass,
        controller=label,
        seed=seed,
        physics=stated,
        settings=own,
        epsilon_planned=plan.quality.epsilon,
        grip_N=tuple(float(f) for f in plan.forces.forces[:, 0]),
        asked=len(cases),
        outcomes=tuple(sorted(outcomes, key=lambda o: o.index)),
        wall_s=time.perf_counter() - begin,
    )


def physics_of(plan: GraspPlan, physics: PhysicsOptions) -> dict[str, Any]:
    """How MuJoCo computes, read from a compiled scene, and what it is computed with."""
    scene = build_scene(plan.task, T_world_base=plan.T_world_base, q=plan.q, physics=physics)
    option = scene.model.opt
    return {
        "name": physics.label,
        "timestep_s": float(option.timestep),
        "integrator": _name(mujoco.mjtIntegrator, option.integrator),
        "solver": _name(mujoco.mjtSolver, option.solver),
        "cone": _name(mujoco.mjtCone, option.cone),
        "jacobian": _name(mujoco.mjtJacobian, option.jacobian),
        "impratio": float(option.impratio),
        "noslip_iterations": int(option.noslip_iterations),
        "iterations": int(option.iterations),
        "friction": physics.mu,
        "torsional_friction_m": physics.mu_torsion,
        "rolling_friction_m": physics.mu_rolling,
        "condim": physics.condim,
        "solref": [physics.time_constant, physics.solref[1]],
        "solimp": list(physics.solimp),
        "mujoco": mujoco.__version__,
        **{k: v for k, v in made_with().items() if k in ("written_by", "machine", "cores")},
    }


def _film(video: Path | None, case: Case) -> Path | None:
    """File of the film of a trial."""
    if video is None:
        return None
    name = case.name.replace(" ", "-").replace("/", "-")
    return video.with_name(f"{video.stem}-{case.index:03d}-{name}{video.suffix}")


class _Lines:
    """A file of JSON lines that is written as results come; nothing without a path."""

    def __init__(self, path: Path | None) -> None:
        """Open it."""
        try:
            self._stream = None if path is None else path.open("w", encoding="utf-8")
        except OSError as error:
            raise FileFormatError(f"cannot write {path}: {error.strerror}") from error

    def __enter__(self) -> None:
        """It is open."""

    def __exit__(self, *_: object) -> None:
        """Close it."""
        if self._stream is not None:
            self._stream.close()

    def write(self, row: dict[str, Any]) -> None:
        """One more line, on disk at once."""
        if self._stream is not None:
            self._stream.write(json.dumps(row) + "\n")
            self._stream.flush()


_plans: dict[str, GraspPlan] = {}
"""The plan that this process works on, by its text."""


def _plan_of(text: str, hand: Hand | None = None) -> GraspPlan:
    """The plan that a text holds; only the last one is kept."""
    if text not in _plans:
        plan = plan_from_dict(json.loads(text), "the plan", hand=hand)
        _plans.clear()
        _plans[text] = plan
    return _plans[text]


def _run(job: _Job, check: Callable[[], None]) -> Outcome:
    """One trial; one that cannot be run ends itself alone."""
    plan = _plan_of(job.plan)
    try:
        with filmed(job.video):
            outcome = job.case.run(plan, job.conditions)
    except PlannerError as error:
        outcome = _not_run(job, str(error))
    check()
    return outcome


def _not_run(job: _Job, reason: str) -> Outcome:
    """The outcome of a trial that came to no verdict: not held, without samples."""
    fingers = _plan_of(job.plan).task.finger_names
    return Outcome(
        index=job.case.index,
        name=job.case.name,
        held=False,
        fault=Fault(reason="not run", detail=reason, time=0.0),
        fingers=fingers,
        samples=Samples.of({name: () for name in CHANNELS}, len(fingers)),
        load=np.zeros(0),
    )


def _name(kind: Any, value: int) -> str:
    """Name of a value of one of MuJoCo's enumerations, without its prefix."""
    return str(kind(int(value)).name).split("_", 1)[1].lower()
