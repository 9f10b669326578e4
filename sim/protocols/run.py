"""``run_protocol``: all trials of a protocol, on all cores, with what is done kept.

Trials are independent of each other and of the number of workers: every one begins with the plan as
it is in its file, and one that cannot be run is an outcome with the reason "not run".
"""

from __future__ import annotations

import json
import logging
import os
import time
from collections.abc import Callable, Collection, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import mujoco
import numpy as np
from rich.console import Console

from planner.errors import ModelError, NotFoundError, PlannerError, TaskError
from planner.files import given_plan, plan_from_dict, plan_to_dict
from planner.files.disk import Journal
from planner.hands.hand import Hand
from planner.plan import GraspPlan
from planner.registry import Registry
from planner.task import GraspTask
from sim.controllers import AnyController, controller_maker, controller_name
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
from sim.protocols.variations import error_cases, robust_cases, with_errors
from sim.recording import Samples
from sim.runner import Runner, made_with
from sim.scene.build import build_scene
from sim.scene.physics import PRESETS, AnyPhysics, PhysicsOptions
from sim.sensing.errors import ERROR_MODELS, AnyErrorModel, Drawn, drawn_numbers, drawn_text
from sim.sensing.estimation import NONE, AnyEstimator, estimator_name
from sim.simulation import filmed
from sim.verdict import Fault

MakeCases: TypeAlias = Callable[[Settings, int], Sequence[Case]]


@dataclass(frozen=True, kw_only=True)
class Protocol:
    """A test of plans.

    An installed package brings one of these, or a function that makes trials with the attributes
    ``unsuitable`` and ``in_all`` where they are to be others than the defaults here.

    Attributes:
        cases: Makes the trials out of settings and the seed of random directions and errors.
        unsuitable: Why it cannot take a task; "" if it can.
        in_all: Whether "all" stands for it too.
        replayed: Whether commands and numbers are its own, whatever controller and settings are.
        draws_anew: Whether its trials each draw errors anew; those of others all have the same.
    """

    cases: MakeCases
    unsuitable: Callable[[GraspTask], str] = lambda task: ""
    in_all: bool = False
    replayed: bool = False
    draws_anew: bool = False


PROTOCOLS: Registry[Protocol | MakeCases] = Registry("protocol", group="protocols")
"""Name -> protocol; installed packages bring more (``planner.registry``). "drake", which
needs another package, and "errors" and "pushes", which test the controller more than the grasp,
are run by their names alone."""

PROTOCOLS.update(
    dexgraspbench=Protocol(
        cases=lambda settings, seed: dexgraspbench_cases(),
        unsuitable=lambda task: unsuitable_for_dexgraspbench(task.hand),
        in_all=True,
        replayed=True,
    ),
    forces=Protocol(cases=forces_cases, in_all=True),
    shake=Protocol(
        cases=lambda settings, seed: shake_cases(settings),
        unsuitable=lambda task: on_an_arm(task.hand),
        in_all=True,
    ),
    robust=Protocol(cases=robust_cases, in_all=True),
    drake=Protocol(
        cases=lambda settings, seed: drake_cases(),
        unsuitable=lambda task: unsuitable_for_drake(task.hand),
        replayed=True,
    ),
    errors=Protocol(cases=error_cases, draws_anew=True),
    pushes=Protocol(cases=pushes_cases, draws_anew=True),
)


def protocol_named(name: str) -> Protocol:
    """The protocol of a name.

    Raises:
        NotFoundError: There is none.
        ModelError: A package brings it that cannot be imported.
    """
    found = PROTOCOLS.named(name)
    if isinstance(found, Protocol):
        return found
    never = Protocol(cases=found)
    return replace(
        never,
        unsuitable=getattr(found, "unsuitable", never.unsuitable),
        in_all=bool(getattr(found, "in_all", never.in_all)),
    )


def in_all() -> tuple[str, ...]:
    """Names of the protocols that "all" stands for; those that cannot be imported are left out.

    They are named in a warning of this module's logger.
    """
    found = []
    for name in PROTOCOLS:
        try:
            if protocol_named(name).in_all:
                found.append(name)
        except ModelError as error:
            logging.getLogger(__name__).warning("left out of 'all': %s", error)
    return tuple(found)


def cases_of(protocol: str, settings: Settings, seed: int) -> tuple[Case, ...]:
    """The trials of a protocol, in order.

    Raises:
        NotFoundError: There is no such protocol.
    """
    return tuple(protocol_named(protocol).cases(settings, seed))


def unsuitable(protocol: str, task: GraspTask) -> str:
    """Why a protocol cannot take a task; "" if it can."""
    return protocol_named(protocol).unsuitable(task)


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
    error_model: AnyErrorModel | None = None,
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
        error_model: Errors of sensors, drives and object, or their name; none if None, or those of
            a laboratory in the protocol ``errors``, which draws them anew for every trial.
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
    begin, about = time.perf_counter(), protocol_named(protocol)
    if workers == 0:
        raise TaskError("workers is 0; give the number of processes, or -1 for one per core")
    settings, plan = settings or Settings(), given_plan(plan)
    physics = benchmark_physics() if protocol == "dexgraspbench" else PRESETS.given(physics)
    (names,) = trials_of([protocol], only, settings, seed).values()
    cases = [case for case in cases_of(protocol, settings, seed) if case.name in names]
    make = controller_maker(controller)
    if reason := about.unsuitable(plan.task):
        raise TaskError(reason)
    if protocol == "drake" and (reason := drake_missing()):
        raise TaskError(reason)
    label = "replay" if about.replayed else controller_name(controller)
    text = json.dumps(plan_to_dict(plan))
    error_model = ERROR_MODELS.given(error_model)
    if protocol == "errors":
        error_model = with_errors(error_model)  # the report then names what was drawn from
    conditions = Conditions(
        physics=physics, controller=make, error_model=error_model, estimator=estimator
    )
    jobs = [
        _Job(plan=text, case=case, conditions=conditions, video=_film(video, case))
        for case in cases
    ]
    _plan_of(text, plan.task.hand)
    outcomes: list[Outcome] = []
    journal = None if file is None else Journal(file, anew=True)

    def keep(outcome: Outcome) -> None:
        outcomes.append(outcome)
        if journal is not None:
            head = {"plan": name, "protocol": protocol, "controller": label}
            journal.add({**head, **outcome.to_dict()})

    with nullcontext() if journal is None else journal:
        Runner(
            console=console or Console(quiet=True),
            check=check,
            workers=(os.cpu_count() or 1) if workers < 0 else workers,
        ).run(_run, jobs, title=f"{protocol} {name}".strip(), keep=keep, given_up=_not_run)
    if outcomes and all(o.reason == "not run" for o in outcomes):  # a mistake that all share
        assert outcomes[0].fault is not None
        raise TaskError(f"no trial could be run: {outcomes[0].fault.detail}")
    task = plan.task
    own = {} if about.replayed else asdict(settings)
    if not (about.replayed or error_model.ideal):
        own["error_model"] = error_model.to_dict()
        if not about.draws_anew:
            drawn = drawn_numbers(Drawn.of(error_model, plan.task.hand), plan.task.hand)
            own["error_model"]["drawn_in_words"] = drawn_text([drawn])
    if not about.replayed and (used := estimator_name(estimator, error_model)) != NONE:
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
        samples=Samples.of({name: () for name in Samples.channels()}, len(fingers)),
        load=np.zeros(0),
    )


def _name(kind: Any, value: int) -> str:
    """Name of a value of one of MuJoCo's enumerations, without its prefix."""
    return str(kind(int(value)).name).split("_", 1)[1].lower()
