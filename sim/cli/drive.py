"""The command ``drive``: a plan on a hand, through the interface of a real one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sim.cli.common import (
    EXIT_INTERRUPTED,
    EXIT_NO,
    check_folder,
    err,
    heeding_ctrl_c,
    keep_inputs,
    out,
    print_json,
    tell,
)
from sim.cli.execution import controller_of
from sim.cli.options import (
    ControllerOption,
    JsonOption,
    PlanArgument,
    command,
    flag,
    names,
    option,
)
from sim.cli.reading import one_plan

if TYPE_CHECKING:
    from planner.plan import GraspPlan
    from sim.real_hand import Carry, Clock, HandInterface, LoopReport, OnStop
    from sim.report import TrialReport


RATE_HZ = 100.0
"""Rate of the loop unless another is asked for."""


@command
def drive(
    plan_file: PlanArgument,
    interface: Annotated[
        str | None,
        option(
            "module:factory or file.py:factory; a simulated hand if not given.",
            "NAME",
            None,
            "--hand-interface",
        ),
    ] = None,
    controller: ControllerOption = "feedforward",
    rate: Annotated[
        float | None, option("Rate of the loop, Hz; 100, or that of the log.", "HZ")
    ] = None,
    log: Annotated[Path | None, option("Readings and commands (.npz).", "FILE")] = None,
    replay: Annotated[Path | None, option("A log in place of a hand.", "FILE")] = None,
    dry_run: Annotated[bool, flag("--dry-run", "Read, compute, write nothing.")] = False,
    assume: Annotated[str | None, option("Planned, not read: object_pose,touch.", "NAMES")] = None,
    max_rate: Annotated[
        float | None, option("Fastest change of a command, rad/s.", "RAD/S")
    ] = None,
    on_stop: Annotated[str, option("At an emergency: torque-off, or hold.", "NAME")] = "torque-off",
    check: Annotated[bool, flag("--check-joints", "Move every joint a little instead.")] = False,
    fast: Annotated[bool, flag("--fast", "Simulate as fast as can be.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Execute a plan on a hand in real time, or on a simulated one.

    Ctrl-C is an emergency stop. Exit code 0 if all phases were run, and a simulated object held.
    """
    with heeding_ctrl_c() as pressed:
        from contextlib import closing

        from planner.errors import NotFoundError, TaskError
        from sim.controllers import controller_for
        from sim.real_hand import (
            CommandLimits,
            DryRun,
            RealClock,
            ReplayedHand,
            Safety,
            SimulatedHand,
            check_joints,
            checks_table,
            run_controller,
        )

        given = [n for n, v in (("--hand-interface", interface), ("--replay", replay)) if v]
        if len(given) > 1 or (fast and given):
            given += ["--fast"] * fast
            raise TaskError(f"{' and '.join(given)} exclude each other; give one")
        if check and replay:
            raise TaskError("--check-joints moves a hand, and a log has none; leave --replay out")
        check_folder(log)
        keep_inputs(log, plan_file, replay)
        if log is not None and log.suffix.lower() != ".npz":
            raise TaskError(f"--log {log} is no name of a log; let it end with .npz")
        plan = one_plan(plan_file)
        if on_stop not in STOPS:
            raise NotFoundError("way to stop", on_stop, STOPS)
        bounds = Safety(on_stop=STOPS[on_stop])
        limits = CommandLimits(rate=max_rate)
        named = controller_of(controller)
        driver = controller_for(plan, named)
        used = _open(plan, interface, replay, fast, named)
        if rate is None:
            rate = used.hand.log.rate_hz if isinstance(used.hand, ReplayedHand) else RATE_HZ
        pressed()  # a library swallows Ctrl-C while it is imported
        with closing(used.hand):
            hand = DryRun(used.hand) if dry_run else used.hand
            if check:
                checks, ran = check_joints(
                    hand,
                    plan.task.hand,
                    rate_hz=rate,
                    clock=used.clock,
                    limits=limits,
                    safety=bounds,
                )
                faults = [c.fault for c in checks if c.fault]
                if as_json:
                    rows = [vars(c) | {"fault": c.fault} for c in checks]
                    print_json({"loop": ran.to_dict(), "joints": rows})
                else:
                    out.print(checks_table(checks))
                    tell(str(ran))
                _leave(ran, good=not faults)
                return
            if isinstance(used.hand, SimulatedHand):
                driver = used.hand.controller
            real = isinstance(used.clock, RealClock)
            with err.status(
                f"driving: {plan.task.hand.name} ... (Ctrl-C stops it)" if real else ""
            ):
                ran = run_controller(
                    hand,
                    driver,
                    plan,
                    rate_hz=rate,
                    clock=used.clock,
                    limits=limits,
                    safety=bounds,
                    carry=used.carry,
                    assume=names(assume) if assume else (),
                    log=log,
                )
            judged: TrialReport | None = None
            if isinstance(used.hand, SimulatedHand) and not dry_run:
                judged = used.hand.report(interrupted=ran.reason == "interrupted")
        _tell(ran, judged, used, as_json)
        _leave(ran, good=judged is None or judged.success)


@dataclass(frozen=True, kw_only=True)
class _Used:
    """A hand, its clock, and what moves it as a whole."""

    hand: Any
    clock: Clock
    carry: Carry | None


def _open(
    plan: GraspPlan, interface: str | None, replay: Path | None, fast: bool, controller: Any
) -> _Used:
    """The hand that was asked for.

    Raises:
        PlannerError: There is none.
    """
    from sim.real_hand import RealClock, ReplayedHand, SimulatedHand
    from sim.trial import Trial

    if replay is not None:
        logged = ReplayedHand(replay, plan.task.hand)
        return _Used(hand=logged, clock=logged.clock, carry=None)
    if interface is not None:
        hand = _made_by(interface, plan)
        return _Used(hand=hand, clock=RealClock(), carry=getattr(hand, "carry", None))
    trial = Trial(plan, controller=controller)
    simulated = SimulatedHand(trial, clock=None if fast else RealClock())
    return _Used(hand=simulated, clock=simulated.clock, carry=simulated.carry)


def _made_by(text: str, plan: GraspPlan) -> HandInterface:
    """What a factory makes of the plan."""
    import importlib
    import importlib.util

    from planner.errors import HandError, NotFoundError

    home, _, name = text.rpartition(":")
    if not home or not name:
        raise HandError(
            f"--hand-interface is {text!r}; give module:factory or file.py:factory, where "
            "factory(plan) makes a sim.real_hand.HandInterface"
        )
    if home.endswith(".py"):
        if not Path(home).is_file():
            raise NotFoundError("file", home, (), "give the file of the driver", is_path=True)
        spec = importlib.util.spec_from_file_location(Path(home).stem, home)
        if spec is None or spec.loader is None:
            raise HandError(f"{home} cannot be read as Python; give a .py file")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    else:
        try:
            module = importlib.import_module(home)
        except ModuleNotFoundError as error:
            raise HandError(
                f"--hand-interface: {error}; install it, or give the file of the driver"
            ) from error
    if not hasattr(module, name):
        raise NotFoundError(f"factory in {home}", name, [n for n in dir(module) if n[0] != "_"])
    hand = getattr(module, name)(plan)
    missing = [part for part in PARTS if not hasattr(hand, part)]
    if missing:
        raise HandError(
            f"{text} made a {type(hand).__name__} without {', '.join(missing)}; see "
            "sim.real_hand.HandInterface"
        )
    made: HandInterface = hand
    return made


PARTS = (
    *("joint_names", "actuator_names", "finger_names", "rate_hz"),
    *("read", "write", "stop", "close"),
)
"""What a hand interface has."""


STOPS: dict[str, OnStop] = {"torque-off": "torque off", "hold": "hold"}
"""Ways to stop, by their names on the command line."""


def _tell(ran: LoopReport, judged: TrialReport | None, used: _Used, as_json: bool) -> None:
    from sim.real_hand import ReplayedHand

    compared = used.hand.comparison() if isinstance(used.hand, ReplayedHand) else None
    if as_json:
        data: dict[str, Any] = {"loop": ran.to_dict()}
        if judged is not None:
            data["trial"] = judged.to_dict()
        if compared is not None:
            data["comparison"] = vars(compared)
        print_json(data)
        return
    out.print(ran)
    if judged is not None:
        said = f"{judged.reason}: {judged.verdict.detail}" if judged.reason else "held"
        tell(f"simulated object: {said}")
    if compared is not None:
        tell(f"replayed: {compared}")
        if used.hand.log.plan is None:
            tell("the log is of version 1, which does not say of which plan it is")


def _leave(ran: LoopReport, *, good: bool) -> None:
    if ran.reason == "interrupted":
        raise typer.Exit(EXIT_INTERRUPTED)
    if not ran.done or not good:
        raise typer.Exit(EXIT_NO)
