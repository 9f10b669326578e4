"""How a plan is executed in MuJoCo: the options, and what they name."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.markup import escape

from sim.cli.common import check_films, err, out, say, tell
from sim.cli.options import (
    ArrowsOption,
    ControllerOption,
    ErrorModelOption,
    ErrorSeedOption,
    EstimateOption,
    PadsOption,
    PhysicsOption,
    SimMuOption,
    VerboseOption,
    VideoOption,
    ViewOption,
)

if TYPE_CHECKING:
    from planner.motion.plan import ManipulationPlan
    from sim.report import TrialReport
    from sim.scene.build import Truth
    from sim.trial import Trial

POLICY = "policy:"
"""What the name of a learned controller begins with."""


def physics_of(text: str, sim_mu: float | None = None) -> Any:
    """Physics as ``--physics`` and ``--sim-mu`` give it.

    Raises:
        NotFoundError: There is no such preset.
        FileFormatError: A file that cannot be read.
        TaskError: A field that there is not, or a value out of range.
    """
    from sim.scene.physics import PRESETS

    found = PRESETS.given(text)
    return found if sim_mu is None else replace(found, mu=sim_mu)


def controller_of(name: str) -> Any:
    """What ``--controller`` names: a name as it is, or what makes controllers of a policy.

    Raises:
        NotFoundError: No controller or policy has that name.
        FileFormatError: A policy that cannot be read.
    """
    from sim.controllers import CONTROLLERS

    if not name or name in CONTROLLERS:
        return name or None
    from sim.learning import named_driver

    return named_driver(name)


def error_model_of(
    text: str, seed: int | None = None, pads: str | None = None, *, draws: bool = False
) -> Any:
    """The error model as ``--error-model``, ``--error-seed`` and ``--pads`` give it.

    Args:
        text: Name of a preset, or a file.
        seed: Of what is drawn; that of the error model if None.
        pads: Sense of touch; that of the error model if None.
        draws: Whether something is drawn without ``--error-model`` too.

    Raises:
        NotFoundError: There is none of that name, or no such sense of touch.
        FileFormatError: A file that cannot be read.
        TaskError: A field that there is not, a value out of range, or a seed of nothing.
    """
    from planner.errors import TaskError
    from sim.sensing.errors import ERROR_MODELS

    found = ERROR_MODELS.given(text)
    found = found if pads is None else replace(found, touch=pads)
    if seed is None:
        return found
    if found.ideal and not draws:
        raise TaskError(
            f"--error-seed {seed} seeds errors, and the error model {found.name!r} has none; give "
            "--error-model lab, rough or a file, or leave the seed out"
        )
    return found.seeded(seed)


def estimate_of(name: str | None) -> str | None:
    """Estimator as ``--estimate`` gives it.

    Raises:
        NotFoundError: There is none of that name.
    """
    if name is not None:
        from sim.sensing.estimation import check_estimator

        check_estimator(name)
    return name


@dataclass(frozen=True, kw_only=True)
class ExecutionOptions:
    """What drives the fingers, and in which physics and sensor errors."""

    sim_mu: SimMuOption = None
    physics: PhysicsOption = "ours"
    error_model: ErrorModelOption = "ideal"
    error_seed: ErrorSeedOption = None
    estimate: EstimateOption = None
    pads: PadsOption = None
    controller: ControllerOption = "feedforward"
    view: ViewOption = False
    video: VideoOption = None
    arrows: ArrowsOption = False

    def parts(self, *, draws: bool = False) -> dict[str, Any]:
        """Arguments of an execution: controller, physics, error model and estimator.

        Raises:
            PlannerError: One of them that there is not.
        """
        return {
            "controller": controller_of(self.controller),
            "physics": physics_of(self.physics, self.sim_mu),
            "error_model": error_model_of(
                self.error_model, self.error_seed, self.pads, draws=draws
            ),
            "estimator": estimate_of(self.estimate),
        }

    def check_policy(self, hand: Any, item: Callable[[], Any], degrees: float | None) -> None:
        """Refuse another hand than a policy's, and say what else it was not trained for.

        Call it before anything is planned; other controllers are for every hand.

        Args:
            hand: Name or path of the hand, or the hand.
            item: Gives the object.
            degrees: Turn about the vertical that is asked for; None for another movement, or none.

        Raises:
            PlannerError: No such hand or object, or the policy is for another hand.
        """
        if not self.controller.startswith(POLICY):
            return
        from planner.hand_loading import load_hand

        about = controller_of(self.controller).policy.about
        about.check(load_hand(hand) if isinstance(hand, str) else hand)
        physics = physics_of(self.physics, self.sim_mu)
        error_model = error_model_of(self.error_model, pads=self.pads)
        if beyond := about.outside_training(item(), degrees, physics, error_model):
            say(err, escape(beyond))

    def reckoned(self, request: Any) -> Any:
        """A request that reckons with the encoders of the error model, unless it says how far off.

        Args:
            request: Options of planning, with ``joint_error``.

        Raises:
            PlannerError: See ``error_model_of``.
        """
        if request.joint_error is not None:
            return request
        offset = error_model_of(self.error_model).encoder_offset
        return replace(request, joint_error=math.degrees(offset))


def truth_of(scan: str | Path, *, needed: bool) -> Truth | None:
    """What a cloud of ``opposable scan`` was of, told on stderr; None where it does not say.

    Args:
        scan: The file.
        needed: Whether it has to say.

    Raises:
        ObjectError: The file cannot be read.
        TaskError: It does not say, and has to.
    """
    from planner.errors import TaskError
    from sim.scan import scanned_truth

    truth = scanned_truth(scan)
    if truth is None and needed:
        raise TaskError(f"{scan} does not say what there was; give a cloud of opposable scan")
    tell_truth(scan, truth)
    return truth


def tell_truth(scan: str | Path, truth: Truth | None) -> None:
    """Say on stderr what a plan of a cloud is executed on."""
    there = "the planned surface itself" if truth is None else f"a {truth.object.shape.spec}"
    why = "it does not say what was scanned" if truth is None else "what was scanned"
    say(err, escape(f"{scan}: executed on {there}, {why}"))


def print_report(report: TrialReport, verbose: bool) -> None:
    """Print the screen of a report, with ``--verbose`` what explains the verdict too."""
    out.print(report)
    for line in report.details() if verbose else ():
        out.print(line)


@contextmanager
def share_bar(title: str) -> Iterator[Callable[[float], None]]:
    """A bar on stderr: yields what shows the share in [0, 1] that is done."""
    from rich.progress import Progress

    with Progress(console=err, transient=True, disable=not err.is_terminal) as progress:
        bar = progress.add_task(title, total=1.0)
        yield lambda share: progress.update(bar, completed=share)


def trial_of(plan: ManipulationPlan) -> Callable[..., Trial]:
    """What executes a movement that is no turn in the hand: a handover, or the use of a tool."""
    if plan.handover is not None:
        from sim.handover import HandoverTrial

        return HandoverTrial
    from sim.tools import FingersTrial, UseTrial

    return FingersTrial if plan.tool_use is None else UseTrial


@dataclass(frozen=True, kw_only=True)
class TrialOptions(ExecutionOptions):
    """How ``run`` and ``test`` execute the plan of a grasp."""

    verbose: VerboseOption = False

    def show(self, report: TrialReport, *, picture: bool = False) -> None:
        """Print a report: verdict and contacts, with ``--verbose`` what explains them too.

        Args:
            report: What happened.
            picture: Whether a picture was asked for by name, so that its file is told.
        """
        print_report(report, self.verbose)
        if report.drawn and (self.verbose or self.video or picture):
            tell(report.drawn)

    def trial(
        self, truth: Truth | None = None, *, movement: bool = False
    ) -> Callable[[Any, Path | None], TrialReport]:
        """What executes a plan, with a progress bar on stderr, and draws it.

        Args:
            truth: What there really is; as planned if None.
            movement: Whether the plans are of handovers or uses of tools, not of grasps.

        Raises:
            PlannerError: A controller or physics that there is not, no display to view on, or a
                video that cannot be written; bad input ends before anything is planned.
        """
        from sim.trial import simulate

        parts: dict[str, Any] = {**self.parts(), "truth": truth}
        if movement and self.controller == ExecutionOptions.controller:
            parts["controller"] = None  # its own
        if self.view:
            from sim.show.painter import check_display

            check_display()
        check_films(self.video)

        def execute(plan: Any, picture: Path | None) -> TrialReport:
            with share_bar("simulating") as progress:
                shown: dict[str, Any] = {
                    **{"progress": progress, "view": self.view, "picture": picture},
                    **{"video": self.video, "arrows": self.arrows},
                }
                if movement:
                    return trial_of(plan)(plan, **parts).run(**shown)
                return simulate(plan, **parts, **shown)

        return execute
