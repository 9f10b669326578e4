"""``certify`` on the plans of both hands and on bare contacts, its table and JSON, its command."""

from __future__ import annotations

import io
import json
import re
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import nnls
from test_certify_breaking import bears, bisected

from planner import GraspPlan, GraspTask, plan_grasp, write_plan
from planner.certify import Certificate, certify, certify_contacts
from planner.certify.breaking import without_grip
from planner.contacts import ContactSet
from planner.errors import ContactError, TaskError
from planner.forces import build_force_problem
from planner.objects import parse_object
from planner.quality import force_closure, primitive_wrenches
from planner.spatial import SE3, pose_from_wxyz
from sim.cli import main

TASKS = {"allegro": ("allegro_hand", "box"), "shadow": ("shadow_hand", "cylinder")}


@pytest.fixture(scope="session")
def plans() -> dict[str, GraspPlan]:
    return {
        name: plan_grasp(GraspTask.create(hand, item), seed=0)
        for name, (hand, item) in TASKS.items()
    }


@pytest.fixture(scope="session")
def certificates(plans: dict[str, GraspPlan]) -> dict[str, Certificate]:
    return {name: certify(plan) for name, plan in plans.items()}


@pytest.fixture(scope="session")
def plan_file(plans: dict[str, GraspPlan], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("certify") / "plan.json"
    write_plan(plans["allegro"], path)
    return path


def pairs_of_pushes() -> ContactSet:
    """Twelve frictionless contacts, two on each face of a cube, one length (m) off its middle.

    Each face gives the wrenches (+-1 along an axis, +-1 about the next one) of one plane, and
    the three planes are orthogonal.
    """
    positions, normals = [], []
    for axis in range(3):
        for side in (-1.0, 1.0):
            for off in (-1.0, 1.0):
                p, n = np.zeros(3), np.zeros(3)
                p[axis], p[(axis + 1) % 3] = side, off
                n[axis] = -side
                positions.append(p)
                normals.append(n)
    return ContactSet.from_arrays(positions, normals, model="frictionless")


@pytest.mark.slow
def test_epsilon_of_twelve_pushes_on_a_cube_is_known() -> None:
    # h(u) = max over planes k of |a_k| + |b_k| >= |(a_k, b_k)|, and the largest of three parts of
    # a unit vector is at least 1 / sqrt(3); (1, 0) / sqrt(3) in each plane attains it.
    got = certify_contacts(pairs_of_pushes(), length=1.0)
    assert got.closed
    assert got.epsilon.lower <= 1 / np.sqrt(3) <= got.epsilon.upper
    assert got.epsilon.width <= 0.01 * got.epsilon.upper


@pytest.mark.slow
@pytest.mark.parametrize("name", TASKS)
def test_a_plan_is_certified_narrowly_and_in_time(
    name: str, plans: dict[str, GraspPlan], certificates: dict[str, Certificate]
) -> None:
    got, plan = certificates[name], plans[name]
    assert got.closed
    assert got.cpu_s < 30.0
    for bounds in (got.epsilon, got.epsilon_linf, *(b.bounds for b in got.breaking)):
        assert 0 < bounds.lower <= bounds.upper
        assert bounds.width <= 0.011 * bounds.upper
    assert got.epsilon.upper >= plan.quality.epsilon
    assert [t.kind for t in got.tolerances] == [
        "position",
        "normal",
        "friction",
        "pose shift",
        "pose turn",
    ]
    for tolerance in got.tolerances:
        assert tolerance.promised is not None
        assert tolerance.promised > 0
        if tolerance.broken_at is not None:
            assert tolerance.promised < tolerance.broken_at < 2 * tolerance.promised


@pytest.mark.slow
@pytest.mark.parametrize("name", TASKS)
def test_breaking_wrenches_of_a_hand_agree_with_an_independent_programme(
    name: str, plans: dict[str, GraspPlan], certificates: dict[str, Certificate]
) -> None:
    problem = plans[name].forces.problem
    scale = np.array([1.0, 1, 1, *[certificates[name].length] * 3])
    free = without_grip(problem)
    rng = np.random.default_rng(0)
    for found in certificates[name].breaking:
        assert bisected(free, found.wrench, edges=64) == pytest.approx(1.0, abs=0.012)
        used = {"force": slice(0, 3), "torque": slice(3, 6), "wrench": slice(0, 6)}[found.kind]
        for _ in range(10):
            direction = np.zeros(6)
            direction[used] = rng.normal(size=len(direction[used]))
            size = found.bounds.lower / (found.length if found.kind == "torque" else 1.0)
            wrench = size * scale * direction / np.linalg.norm(direction)
            assert bears(free, 0.99 * wrench, edges=64)


@pytest.mark.slow
@pytest.mark.parametrize("name", TASKS)
def test_no_sampled_error_within_a_promise_loses_closure(
    name: str, certificates: dict[str, Certificate]
) -> None:
    # five kinds of error: 1,250 for each plan
    rng, draws = np.random.default_rng(7), 250
    for tolerance in certificates[name].tolerances:
        assert tolerance.promised is not None
        for _ in range(draws):
            contacts = tolerance.draw(tolerance.promised, rng)
            assert closed(contacts, certificates[name].length), tolerance.kind


def closed(contacts: ContactSet, length: float) -> bool:
    """Closure by nonnegative least squares; in doubt, by linear programme."""
    w = primitive_wrenches(contacts, 8, length=length)
    extra, left = nnls(w, -w.sum(axis=1))
    if left < 1e-9 and extra.max() < 1e4 and np.linalg.svd(w, compute_uv=False)[-1] > 1e-4:
        return True
    return force_closure(contacts, 8).closed


@pytest.mark.slow
def test_a_turned_grasp_has_the_same_certificate(plans: dict[str, GraspPlan]) -> None:
    contacts, length = plans["allegro"].contacts, 0.05
    turned = contacts.transformed(pose_from_wxyz(np.array([1.0, 2, 3]), np.array([0.3, 0.4, 0, 1])))
    one, two = (certify_contacts(c, length=length) for c in (contacts, turned))
    assert two.epsilon.upper == pytest.approx(one.epsilon.upper, rel=0.011)
    for a, b in zip(one.tolerances, two.tolerances, strict=True):
        assert b.promised == pytest.approx(a.promised, rel=0.06)


def test_what_is_not_closed_says_so_and_promises_nothing() -> None:
    points = ContactSet.from_arrays([[-0.03, 0, 0], [0.03, 0, 0]], [[1, 0, 0], [-1, 0, 0]])
    problem = build_force_problem(points, wrench=[0, 0, -1, 0, 0, 0], max_normal=10.0)
    got = certify_contacts(points, length=0.03, problem=problem)
    assert not got.closed
    assert got.reason.startswith("not closed")
    assert (got.epsilon.lower, got.tolerances) == (0.0, ())
    assert [b.bounds.lower > 0 for b in got.breaking] == [True, False, False]
    assert "not closed" in str(got)


@pytest.mark.slow
def test_the_table_and_the_data_say_the_same(certificates: dict[str, Certificate]) -> None:
    got = certificates["allegro"]
    data = json.loads(json.dumps(got.as_dict(), allow_nan=False))
    assert data["schema_version"] == 1
    assert data["epsilon_l1"] == [got.epsilon.lower, got.epsilon.upper]
    force = data["smallest_breaking"]["force"]
    assert np.linalg.norm(force["wrench_world_N_Nm"]) == pytest.approx(force["upper"])
    assert np.linalg.norm(force["wrench_object_N_Nm"]) == pytest.approx(force["upper"])
    table = str(got)
    assert len(table) < 3000 and len(repr(got)) < 200
    for row in ("epsilon, L1", "breaking torque", "  normal", "  pose turn"):
        assert row in table
    numbers = re.search(r"breaking force +(\S+) +(\S+) N", table)
    assert numbers is not None
    assert float(numbers[1]) == pytest.approx(force["lower"], rel=1e-3)


@pytest.mark.slow
def test_bad_arguments_are_refused(plans: dict[str, GraspPlan]) -> None:
    for width in (0.0, 1.0, -1.0):
        with pytest.raises(TaskError, match="width"):
            certify(plans["allegro"], width=width)
    with pytest.raises(TaskError, match="samples"):
        certify(plans["allegro"], samples=-1)
    with pytest.raises(ContactError, match="length"):
        certify_contacts(pairs_of_pushes(), length=0.0)
    with pytest.raises(ContactError, match="edges"):
        certify_contacts(pairs_of_pushes(), length=1.0, edges=2)


# ----------------------------------------------------------------------------------- the command


def command(*arguments: str | Path) -> tuple[int, str, str]:
    """Exit code, output and messages of ``opposable certify``."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err), pytest.raises(SystemExit) as ended:
        main(["certify", *map(str, arguments)])
    assert isinstance(ended.value.code, int)
    return ended.value.code, out.getvalue(), " ".join(err.getvalue().split())


@pytest.mark.slow
def test_the_command_prints_the_table(plan_file: Path) -> None:
    code, out, err = command(plan_file, "--samples", "5")
    assert (code, err) == (0, "")
    assert "breaking force" in out
    assert "0 of 5 samples lost closure" in out


@pytest.mark.slow
def test_the_command_prints_json(plan_file: Path) -> None:
    code, out, _ = command(plan_file, "--json")
    assert code == 0
    data = json.loads(out)
    assert data["closed"] is True
    assert {t["edges"] for t in data["tolerances"]} == {8}


@pytest.mark.slow
def test_the_command_refuses_bad_files_and_numbers(plan_file: Path, tmp_path: Path) -> None:
    code, _, err = command(tmp_path / "none.json")
    assert code == 3
    assert "none.json" in err
    wrong = tmp_path / "wrong.json"
    wrong.write_text(
        plan_file.read_text("utf-8").replace('"allegro_hand"', '"shadow_hand"'), "utf-8"
    )
    code, _, err = command(wrong)
    assert code == 3
    assert "error" in err


def test_breaking_wrenches_are_told_in_the_axes_of_an_object_that_is_turned() -> None:
    """It stands on its side, and by 40 degrees from the world's axes."""
    box = parse_object("box:0.05x0.05x0.08")
    stood = box.resting_pose(index=2)
    turned = SE3(pin.rpy.rpyToMatrix(0.0, 0.0, 0.7) @ stood.rotation, stood.translation)
    plan = plan_grasp(GraspTask.create("allegro_hand", box, T_world_object=turned), seed=0)
    made = certify(plan, width=0.5, max_points=200, samples=0)
    told = made.as_dict()["smallest_breaking"]
    for one in made.breaking:
        seen = np.array(told[one.kind]["wrench_object_N_Nm"])
        world = np.concatenate([turned.rotation @ seen[:3], turned.rotation @ seen[3:]])
        assert np.allclose(world, one.wrench, atol=1e-9)
        assert not np.allclose(seen, one.wrench, atol=1e-3)
