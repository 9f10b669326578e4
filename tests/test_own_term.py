"""A new residual term is one object and one registration: two, added from outside."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from planner import GraspPlan, GraspTask, plan_grasp, plan_motion
from planner.errors import NoGraspFoundError, NotFoundError, TaskError
from planner.failure import Failure
from planner.hands.hand import Hand
from planner.motion.search import MOTION_OPTIONS
from planner.spatial import FloatArray
from planner.synthesis import (
    GraspPoint,
    GraspSymbols,
    Role,
    Rows,
    SynthesisOptions,
    Term,
    register_term,
)
from planner.synthesis.problem import GraspProblem, Start, build_problem, problems_for
from planner.synthesis.seeds import seeder_for
from planner.synthesis.terms import clearance
from planner.synthesis.terms.registry import STANDARD, TERMS


def options(*terms: str) -> SynthesisOptions:
    """Options without rounds, with these terms."""
    return SynthesisOptions(rounds=0, terms=terms)


OWN = ("above", "straight")

HEIGHT = 0.012
"""How far (m) the contacts' centroid is to be above the centre of mass."""

OFF = 1e-3
"""Error (m) of the centroid that the verdict allows."""


def _above(g: GraspSymbols) -> Iterator[Rows]:
    yield Rows(expression=sum(g.points[1:], g.points[0])[2] / len(g.points) - HEIGHT)


def _judge_above(grasp: GraspPoint) -> Failure | None:
    height = float(grasp.points[:, 2].mean())
    if height >= HEIGHT - OFF:
        return None
    text = f"the contacts' centroid is {1e3 * height:.1f} mm above the centre of mass"
    return Failure(kind="low_contacts", text=text, numbers={"height": height})


ABOVE = Term(
    name="above",
    meaning="height of the contacts' centroid over the centre of mass, less 12 mm",
    role=Role.INEQUALITY,
    unit="m",
    weight=1e3,
    margin=2e-4,
    write=_above,
    wording="contacts above the centre of mass",
    judged="the same on the true surface, to 1 mm",
    judge=_judge_above,
)


def _straight(g: GraspSymbols) -> Iterator[Rows]:
    for finger in g.fingers:
        last = int(finger.q_index[-1])
        yield Rows(expression=g.q[last] - g.hand.q_lower[last], about=(finger.name,))


STRAIGHT = Term(
    name="straight",
    meaning="angle of each last joint from its lower end",
    role=Role.COST,
    unit="rad",
    weight=2.0,
    write=_straight,
)


@pytest.fixture(autouse=True)
def registered() -> Iterator[None]:
    for term in (ABOVE, STRAIGHT):
        register_term(term)
    yield
    for term in (ABOVE, STRAIGHT):
        del TERMS[term.name]


def height_of(plan: GraspPlan) -> float:
    """Height (m) of the contacts' centroid over the object's centre of mass."""
    return float(plan.contacts.positions[:, 2].mean() - plan.task.T_world_object.translation[2])


@pytest.fixture(scope="module")
def task(allegro: Hand) -> GraspTask:
    return GraspTask.create(allegro, "cylinder:0.03x0.12")


def placed(task: GraspTask, asked: SynthesisOptions) -> tuple[GraspProblem, FloatArray]:
    """A problem with its parameters set, and the unknowns of a start."""
    problem, seeder = problems_for(task, asked.form).grasp, seeder_for(task)
    start = seeder.draw(np.random.default_rng(0))
    assert isinstance(start, Start)
    field = problem.surface.field_of(task.object.shape)
    parameters = problem.parameters(task, start, seeder.posture, asked)
    problem.residuals.set_parameters(parameters, field)
    return problem, problem.first(start)


def test_it_is_printed_with_its_role_unit_weight_and_margin(task: GraspTask) -> None:
    shape = task.object.shape
    with_terms = build_problem(task.hand, task.fingers, shape, terms=OWN)
    line, other = (
        next(row for row in str(with_terms).splitlines() if f" {name} " in row)
        for name in ("above", "straight")
    )
    assert line.split()[:7] == ["above", "1", ">=", "0", "m", "1000", "0.0002"]
    assert ABOVE.meaning in line and ABOVE.judged in line
    assert other.split()[:5] == ["straight", "4", "cost", "rad", "2"]
    assert "above" not in str(build_problem(task.hand, task.fingers, shape))


def test_its_rows_are_weighed_and_have_exact_derivatives(task: GraspTask) -> None:
    problem, x = placed(task, options(*OWN))
    unknowns = problem.formulation.unknowns
    unknowns.points(x)[:, 2] = -0.01
    values, jacobian = (a.copy() for a in problem.residuals(x))
    names = problem.residuals.row_names()
    at = next(k for k, row in enumerate(names) if row.term is ABOVE)
    assert at < problem.residuals.n_terms
    assert values[at] == pytest.approx(1e3 * (-0.01 - HEIGHT - ABOVE.margin))
    assert np.flatnonzero(jacobian[at]).tolist() == [
        unknowns.point_columns.start + 3 * i + 2 for i in range(4)
    ]
    np.testing.assert_allclose(jacobian[at][jacobian[at] != 0], 1e3 / 4)
    straight = [k for k, row in enumerate(names) if row.term is STRAIGHT]
    assert [str(names[k]) for k in straight] == [f"straight of {f.name}" for f in task.fingers]
    last = [int(f.q_index[-1]) for f in task.fingers]
    bent = unknowns.q(x)[last] - task.hand.q_lower[last]
    np.testing.assert_allclose(values[straight], 2.0 * bent, atol=1e-12)
    assert problem.residuals.violations()["above"] == pytest.approx(0.01 + HEIGHT)
    assert "straight" not in problem.residuals.violations(), "a cost is not violated"
    unknowns.points(x)[:, 2] = 0.02
    problem.residuals(x)
    assert all(row.term is not ABOVE for row in problem.residuals.row_names())


@pytest.mark.parametrize("item", ["cylinder:0.03x0.12", "lbracket"])
@pytest.mark.parametrize("own", [(), OWN])
def test_what_is_printed_is_what_is_solved(
    allegro: Hand, item: str, own: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every row that ever counts is printed; every equality, cost and violated row is solved."""
    monkeypatch.setattr(clearance, "PRESSED", -0.5)  # pads too have clearance everywhere
    task = GraspTask.create(allegro, item)
    problem, first = placed(task, replace(options(*own), clear_object=0.5, clear_tip=0.5))
    residuals = problem.residuals
    residuals.set_directions(np.random.default_rng(1).normal(size=(5, 6)), 100.0)
    written = residuals.written
    printed = {(w.term.name, row.number) for w in written for row in w.rows}
    assert len(printed) == sum(len(w.rows) for w in written)
    rng, seen, seldom = np.random.default_rng(0), Counter[tuple[str, int]](), {"fingers", "table"}
    for k in range(60):
        x = first + rng.normal(0.0, 0.3 + 0.02 * k, len(first))
        if k % 3 == 0:  # within a mesh its smooth distance is flatter than on it
            problem.formulation.unknowns.points(x)[:] = rng.normal(0.0, 0.02, (4, 3))
        values, jacobian = residuals(x)
        names = residuals.row_names()
        assert len(names) == len(values) == len(jacobian)
        identities = [(row.term.name, row.number) for row in names]
        assert len(set(identities)) == len(identities)
        assert set(identities) <= printed
        seen.update(identities)
        for row, value in zip(names, values, strict=True):
            assert value < 0 or not row.term.role.one_sided
        for w in written:
            if not w.term.role.one_sided:
                assert sum(row.term is w.term for row in names) == len(w.rows), w.term.name
    missing = {name for name, _ in printed - set(seen)}
    assert missing <= seldom, "folded fingers and far tables are rare; all other rows were solved"
    text = str(problem)
    for w in problem.terms:
        assert f"{w.term.name:14s} {len(w.rows):5d}  {w.term.role.value}" in text
    assert set(own) | set(STANDARD) - {
        "arm",
        "stop",
        "coupling",
        "surface",
        "edge",
        "along",
        "effort",
    } <= {w.term.name for w in problem.terms}


def test_a_plan_satisfies_it_and_one_without_it_does_not(task: GraspTask) -> None:
    asked = [plan_grasp(task, seed=seed, options=options(*OWN)) for seed in range(2)]
    free = [plan_grasp(task, seed=seed, options=options()) for seed in range(2)]
    assert all(height_of(plan) >= HEIGHT - OFF for plan in asked)
    assert any(height_of(plan) < HEIGHT - OFF for plan in free)


def test_its_verdict_refuses_a_grasp_and_is_told_as_the_reason(
    task: GraspTask, monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(grasp: GraspPoint) -> Failure | None:
        assert grasp.points.shape == grasp.inward.shape == (len(grasp.task.fingers), 3)
        assert np.abs(grasp.task.object.shape.signed_distance(grasp.points)).max() < 1e-6
        return Failure(kind="never", text="this term is never content")

    monkeypatch.setitem(TERMS, "above", replace(ABOVE, judge=never))
    with pytest.raises(NoGraspFoundError, match="this term is never content"):
        plan_grasp(task, seed=0, options=options(*OWN), max_attempts=4)


def test_every_knot_of_a_motion_satisfies_it(
    allegro: Hand, monkeypatch: pytest.MonkeyPatch
) -> None:
    slim = GraspTask.create(allegro, "cylinder:0.03x0.12", fingers=["thumb", "index", "middle"])
    asked = replace(MOTION_OPTIONS, terms=("above",))
    motion = plan_motion(slim, angle=0.5, seed=0, options=asked)
    for knot in motion.knots:
        height = knot.T_world_object.actInv(knot.contacts.positions.mean(axis=0))[2]
        assert height >= HEIGHT - OFF

    def never(grasp: GraspPoint) -> Failure | None:
        return Failure(kind="never", text="this term is never content")

    monkeypatch.setitem(TERMS, "above", replace(ABOVE, judge=never))
    with pytest.raises(NoGraspFoundError, match=r"of the path: this term is never content"):
        plan_motion(slim, angle=0.5, seed=0, options=asked, max_attempts=4)


def test_options_with_terms_survive_plain_data() -> None:
    assert SynthesisOptions(**options(*OWN).to_dict()) == options(*OWN)
    assert "terms" not in SynthesisOptions().to_dict(), "files from before terms stay what they are"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"name": "touch"}, "is taken"),
        ({"name": "epsilon"}, "is taken"),
        ({"name": "two words"}, "one word"),
        ({"write": None}, "give it write="),
        ({"weight": 0.0}, "give a weight > 0"),
        ({"margin": -1.0}, "a margin >= 0"),
    ],
)
def test_what_cannot_be_registered_is_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(TaskError, match=message):
        register_term(replace(ABOVE, **{"name": "other", **changes}))  # type: ignore[arg-type]
    assert "other" not in TERMS


def test_only_registered_terms_can_be_asked_for() -> None:
    with pytest.raises(NotFoundError, match=r"no term is called 'abov'\. Did you mean 'above'"):
        SynthesisOptions(terms=("abov",))
    with pytest.raises(TaskError, match="every problem has the term 'touch'"):
        SynthesisOptions(terms=("touch",))
    with pytest.raises(TaskError, match="name one twice"):
        SynthesisOptions(terms=("above", "above"))
    with pytest.raises(TaskError, match="give a tuple of names"):
        SynthesisOptions(terms="above")  # type: ignore[arg-type]
