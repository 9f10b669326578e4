"""The course of a manipulation: all transitions of the state machine, by a scripted situation."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice

import numpy as np
import pytest
from manipulations import task_of

from planner.failure import Failure
from planner.kinematics import HandState
from planner.motion.manipulation import ManipulationPlan, plan_single_stroke
from planner.motion.phase import Ending, Handover, Relocation, Stroke, ToolUse
from planner.tools import load_tool
from sim.manipulation.driver import FingerSwing
from sim.manipulation.machine import PhaseCall, StateMachine
from sim.report import PhaseResult


@pytest.fixture(scope="module")
def plan() -> ManipulationPlan:
    """A turn in one stroke."""
    return plan_single_stroke(task_of("cylinder:0.03x0.08"), angle=math.radians(30.0))


@pytest.fixture(scope="module")
def strokes(plan: ManipulationPlan) -> ManipulationPlan:
    """A turn in two strokes, between which all fingers move on."""
    moves = tuple(_move(plan, finger) for finger in plan.task.finger_names)
    first, second = (Stroke(cycle=cycle, knots=plan.knots) for cycle in (0, 1))
    phases: tuple[Stroke | Relocation, ...] = (first, *moves, second)
    return replace(plan, phases=phases)


def _move(plan: ManipulationPlan, finger: str) -> Relocation:
    knot = plan.motion.knots[-1]
    return Relocation(
        cycle=0,
        finger=finger,
        T_world_object=knot.T_world_object,
        postures=np.array([knot.q, knot.q]),
        before=knot.contacts,
        during=knot.contacts,
        after=knot.contacts,
        margin=0.1,
        grip=1.5,
    )


def test_a_tip_that_seeks_the_object_goes_inwards_and_no_faster_than_asked(
    plan: ManipulationPlan,
) -> None:
    """Whatever its posture: where joints can hardly move it that way, damping slows it."""
    grasp = plan.motion.grasp
    for finger in plan.task.finger_names:
        move = _move(plan, finger)
        landing, pad = move.landing, grasp.task.hand.fingers[finger].pad
        state = HandState(grasp.task.hand, move.postures[-1])
        base = grasp.T_world_base
        place = base.actInv(landing.position)
        index = grasp.task.hand.fingers[finger].q_index
        jacobian = state.point_jacobian(pad.joint_id, place)[:3, index]
        moved = base.rotation @ jacobian @ FingerSwing(grasp, move, 4.0)._inwards
        assert 0.2 < landing.frame[:, 0] @ moved < 1.0


FEW = Failure(kind="few_fingers", text="too few fingers")
NO_ORDER = Failure(kind="no_order", text="no other order")
FALLS = Failure(kind="falls", text="it stands nowhere")


@dataclass
class Script:
    """A situation that is told in advance."""

    lefts: list[float] = field(default_factory=lambda: [0.0])
    touched: bool = True
    back: tuple[Relocation, ...] | Failure = FEW
    others: tuple[Relocation, ...] | Failure = NO_ORDER
    down: Ending | Failure = FALLS
    moved: list[tuple[str, ...]] = field(default_factory=list)

    @property
    def left(self) -> float:
        """What is left of the turn after each stroke in turn; then always the last."""
        return self.lefts.pop(0) if len(self.lefts) > 1 else self.lefts[0]

    def fingers_back(self) -> tuple[Relocation, ...] | Failure:
        return self.back

    def other_order(self, moved: Iterable[str]) -> tuple[Relocation, ...] | Failure:
        self.moved.append(tuple(moved))
        return self.others

    def put_down(self) -> Ending | Failure:
        return self.down


def run(
    plan: ManipulationPlan, situation: Script, fails: Iterable[str] = (), *, retry: bool = False
) -> tuple[list[str], StateMachine, list[str]]:
    """Phases of a run whose phases fail once each as told, the machine, and what it did then."""
    machine, seen, then, left = StateMachine(plan, situation, retry=retry), [], [], list(fails)
    while (call := machine.next) is not None:
        name = f"{call.phase} {call.about}".strip()
        seen.append(name)
        if name in left:
            left.remove(name)
            then.append(machine.failed())
        else:
            machine.passed()
    assert not left, "these phases never came"
    return seen, machine, then


PICK = ["stand", "approach", "close", "squeeze", "verify", "lift"]
PLACE = ["verify again", "carry", "lower", "release", "open", "retreat"]
DOWN = [f"{phase} half-way" for phase in ("lower", "release", "open", "retreat")]


def test_a_turn_that_goes_as_planned(plan: ManipulationPlan) -> None:
    seen, machine, _ = run(plan, Script())
    assert seen == [*PICK, "turn", "hold", *PLACE]
    assert machine.complete and not machine.put_down and machine.state == "end"


def test_what_does_not_stand_is_brought_back_before_it_is_carried(plan: ManipulationPlan) -> None:
    backwards = replace(plan, ending=replace(plan.ending, back="it does not stand"))
    seen, _, _ = run(backwards, Script())
    assert seen[-6:] == ["back", *PLACE[1:]]


def test_strokes_go_on_until_the_object_has_turned(strokes: ManipulationPlan) -> None:
    moves = [f"regrasp {finger}" for finger in strokes.task.finger_names]
    seen, _, _ = run(strokes, Script(lefts=[0.4, 0.2, 0.0]))
    turns = ["turn stroke 1", *moves, "turn stroke 2", *moves, "turn stroke 3"]
    assert seen == [*PICK, *turns, "hold", *PLACE]


def test_strokes_end_where_nothing_turns(strokes: ManipulationPlan) -> None:
    seen, machine, _ = run(strokes, Script(lefts=[0.2]))
    assert sum(name.startswith("turn") for name in seen) == 2 + 3
    assert machine.complete, "whether it has turned far enough is for the hold to tell"


@pytest.mark.parametrize("phase", [*PICK, "turn", "hold", *PLACE])
def test_a_failure_ends_a_run_without_a_retry(plan: ManipulationPlan, phase: str) -> None:
    seen, machine, then = run(plan, Script(down=plan.ending), [phase])
    assert seen[-1] == phase and then == [""]
    assert not machine.complete and not machine.put_down


@pytest.mark.parametrize("phase", [*PICK, *PLACE])
def test_failures_before_and_after_the_turn_are_not_made_up_for(
    plan: ManipulationPlan, phase: str
) -> None:
    seen, _, then = run(plan, Script(down=plan.ending), [phase], retry=True)
    assert seen[-1] == phase and then == [""]


def test_a_lost_object_is_not_put_down(plan: ManipulationPlan) -> None:
    seen, _, then = run(plan, Script(touched=False, down=plan.ending), ["turn"], retry=True)
    assert seen[-1] == "turn" and then == [""]


def test_a_stalled_turn_goes_on_after_the_fingers_went_back_once(plan: ManipulationPlan) -> None:
    back = tuple(_move(plan, finger) for finger in ("thumb", "index"))
    seen, machine, then = run(plan, Script(back=back), ["turn"], retry=True)
    turns = ["turn", "regrasp thumb", "regrasp index", "turn again"]
    assert seen == [*PICK, *turns, "hold", *PLACE] and machine.complete
    assert then == ["the fingers move on, and it is turned again"]
    twice = ["turn", "turn again"]
    seen, _, then = run(plan, Script(back=back), twice, retry=True)
    assert seen[-1] == "turn again"
    assert then[1].startswith("no regrasp (regrasps were made already); it cannot be put down")


@pytest.mark.parametrize("phase", ["turn", "hold"])
def test_what_cannot_be_turned_further_is_put_down_half_way(
    plan: ManipulationPlan, phase: str
) -> None:
    """After a hold that failed it was carried to its target and put down twice."""
    other = replace(plan.ending, T_world_target=plan.motion.knots[0].T_world_object)
    seen, machine, then = run(plan, Script(down=other), [phase], retry=True)
    assert seen[-5:] == [phase, *DOWN]
    assert machine.put_down and not machine.complete and machine.ending is other
    assert then[0].endswith("it is put down")


def test_what_is_moved_is_not_regrasped(plan: ManipulationPlan) -> None:
    back = (_move(plan, "thumb"),)
    moved = replace(plan, shift=np.array([0.0, 0.0, 0.005]))
    _, _, then = run(moved, Script(back=back), ["turn"], retry=True)
    assert "it is to be moved, or turned back" in then[0]


def test_putting_down_backwards_goes_back_first(plan: ManipulationPlan) -> None:
    backwards = replace(plan.ending, back="half-way it does not stand")
    seen, _, _ = run(plan, Script(down=backwards), ["turn"], retry=True)
    assert seen[-5:] == ["back half-way", *DOWN]


def test_fingers_that_cannot_be_lifted_let_others_go_first(strokes: ManipulationPlan) -> None:
    first, second, *rest = strokes.task.finger_names
    others = tuple(_move(strokes, finger) for finger in (*rest, second))
    situation = Script(lefts=[0.2], others=others)
    seen, _, then = run(strokes, situation, [f"regrasp {second}"], retry=True)
    assert situation.moved == [(first,)]
    assert then == ["the fingers move on in another order"]
    at = seen.index(f"regrasp {second}")
    assert seen[at + 1 :][: len(others)] == [f"regrasp {move.finger}" for move in others]
    assert seen[at + 1 + len(others)] == "turn stroke 2"


def test_a_failure_while_putting_down_is_the_end(plan: ManipulationPlan) -> None:
    fails = ["turn", "open half-way"]
    seen, machine, _ = run(plan, Script(down=plan.ending), fails, retry=True)
    assert seen[-1] == "open half-way"
    assert not machine.put_down


def test_a_tool_is_used_and_an_object_handed_over_before_it_is_held_at_last(
    plan: ManipulationPlan,
) -> None:
    """Both end in the hand; a tool is not lifted before."""
    use = ToolUse(way=(plan.T_world_base,), finger="", postures=np.zeros((0, 16)))
    tool = load_tool("key")
    used = ManipulationPlan.of_held(plan.grasp, plan.knots[:2], use, tool=tool)
    machine, seen = StateMachine(used), []
    while (call := machine.next) is not None:
        seen.append(call.phase)
        machine.passed()
    assert seen == [*PICK[:-1], "engage", "use", "withdraw", "hold"]
    assert machine.complete
    handover = Handover(
        both=plan.grasp,
        take=plan.grasp,
        way_in=np.zeros((2, 16)),
        way_out=np.zeros((2, 16)),
        giver="first",
        taker="second",
        lift_height=0.2,
        task=plan.task,
        alone=(plan.grasp, plan.grasp),
    )
    given = ManipulationPlan.of_held(plan.grasp, plan.knots[:2], handover)
    for fails in ("", "take", "hold"):
        machine, made = StateMachine(given), list[PhaseResult]()

        def perform(call: PhaseCall, fails: str = fails) -> tuple[str, dict[str, float]]:
            return "it fails" if call.phase == fails else "", {"n": 1.0}

        for result in machine.run(perform, partial(count, made)):
            made.append(result)
        phases = [*PICK, "reach", "take", "transfer", "open", "retreat", "hold"]
        ended = phases.index(fails) + 1 if fails else len(phases)
        assert [r.phase for r in made] == phases[:ended]
        assert machine.complete == (not fails)
        assert made[-1].reason == ("it fails" if fails else "")
        assert (made[1].begin, made[1].numbers) == (1.0, {"n": 1.0})


def count(made: list[PhaseResult]) -> float:
    """A clock that goes on by one with every phase."""
    return float(len(made))


def test_ctrl_c_ends_a_run_after_the_phase_that_it_struck(plan: ManipulationPlan) -> None:
    def perform(call: PhaseCall) -> tuple[str, dict[str, float]]:
        if call.phase == "turn":
            raise KeyboardInterrupt
        return "", {}

    machine = StateMachine(plan, Script(), retry=True)
    seen = list(islice(machine.run(perform, lambda: 0.0), 20))  # it ends by itself
    assert [r.phase for r in seen] == [*PICK, "turn"]
    assert (seen[-1].reason, seen[-1].then) == ("interrupted", "")
    assert not machine.complete
