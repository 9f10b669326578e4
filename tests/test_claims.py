"""Plan files that claim figures which their grasp lacks, and other doors of hostile data."""

from __future__ import annotations

import json
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner import GraspTask, plan_grasp
from planner.contacts import ContactSet
from planner.errors import ContactError, FileFormatError, ObjectError, PlannerError, TaskError
from planner.files import plan_from_dict, plan_to_dict
from planner.hand_loading import load_hand
from planner.quality import analyse
from planner.search.metrics import resisted_per_newton, robust_epsilon
from planner.shapes import Mesh, Sphere
from sim.cli import main
from sim.scene.physics import PhysicsOptions

LONG = 5000 * "x"

Change = Callable[[dict[str, Any]], object]


@pytest.fixture(scope="module")
def data() -> dict[str, Any]:
    plan = plan_grasp(GraspTask.create("allegro_hand", "sphere"), seed=0)
    stored: dict[str, Any] = json.loads(json.dumps(plan_to_dict(plan)))
    return stored


def first(distances: dict[str, float]) -> str:
    return next(iter(distances))


CLAIMS: dict[str, Change] = {
    "quality.epsilon": lambda d: d["quality"].update(epsilon=1.01 * d["quality"]["epsilon"]),
    "quality.volume": lambda d: d["quality"].update(volume=10**400),
    "quality.isotropy": lambda d: d["quality"].update(isotropy=None),
    "quality.epsilon_round": lambda d: d["quality"].update(epsilon_round=[0.0, 1.0]),
    "quality.epsilon_linf": lambda d: d["quality"].update(epsilon_linf=[0.5]),
    "list of figures in quality": lambda d: d["quality"].update(grip="iron"),
    "quality.closure": lambda d: d["quality"].update(closure=[]),
    "quality.closure.rank": lambda d: d["quality"]["closure"].update(rank=7),
    "quality.closure.closed": lambda d: d["quality"]["closure"].update(closed=1),
    "list of figures in quality.closure": lambda d: d["quality"]["closure"].pop("min_weight"),
    "quality.closure.weights": lambda d: d["quality"]["closure"]["weights"].reverse(),
    "quality.weakest_wrench_n_nm": lambda d: d["quality"].update(
        weakest_wrench_n_nm=[1, 0, 0, 0, 0, 0]
    ),
    "smallest_clearances_m": lambda d: d["smallest_clearances_m"].clear(),
    "smallest_clearances_m, ": lambda d: d["smallest_clearances_m"].update(
        {first(d["smallest_clearances_m"]): 0.5}
    ),
    "pad_gaps_m, 'thumb'": lambda d: d.update(pad_gaps_m=[1.0, *d["pad_gaps_m"][1:]]),
    "pad_gaps_m are not one per finger": lambda d: d["pad_gaps_m"].pop(),
}


@pytest.mark.parametrize("said", CLAIMS)
def test_a_plan_cannot_claim_figures_that_it_does_not_have(data: dict[str, Any], said: str) -> None:
    changed = deepcopy(data)
    CLAIMS[said](changed)
    with pytest.raises(
        FileFormatError, match=f"p.json(: its {said}.*damaged| is damaged: .*{said})"
    ):
        plan_from_dict(changed, "p.json")


def test_what_rounding_or_another_solver_gives_is_believed(data: dict[str, Any]) -> None:
    changed = deepcopy(data)
    quality = changed["quality"]
    quality["epsilon"] *= 1 + 1e-9
    low, high = quality["epsilon_round"]
    quality["epsilon_round"] = [low, high - 0.1 * (high - low)]
    changed["pad_gaps_m"] = [gap + 1e-9 for gap in changed["pad_gaps_m"]]
    plan_from_dict(changed, "p.json")


@pytest.mark.parametrize("mu", [1e7, 1e300, float("nan"), -1.0, 1000.5])
def test_a_task_says_which_friction_there_may_be(mu: float) -> None:
    with pytest.raises(TaskError, match=r"mu is .*; give a finite number from 0 to 1000"):
        GraspTask.create("allegro_hand", "sphere", mu=mu)
    with pytest.raises(TaskError, match=r"mu_torsion is .*; give a finite number from 0 to 1000"):
        GraspTask.create("allegro_hand", "sphere", mu_torsion=mu)


@pytest.mark.parametrize(
    "given",
    [
        {"noslip_iterations": float("nan")},
        {"iterations": 1e308},
        {"iterations": 10**400},
        {"timestep": 1e308},
        {"timestep": 10**400},
        {"timestep": np.array([0.002, 0.002])},
        {"mu": 1e300},
        {"impratio": 1e300},
        {"solref": (1e308, 1.0)},
        {"solimp": (0.5, 0.9, 1e-4, 0.5, 1e300)},
        {"cone": np.array(["elliptic", "pyramidal"])},
        {"condim": {3}},
        {"integrator": 1.5},
    ],
)
def test_physics_is_in_range(given: dict[str, Any]) -> None:
    with pytest.raises(TaskError, match="; give "):
        PhysicsOptions(**given)


def contacts(model: Any = "point") -> ContactSet:
    points = np.random.default_rng(0).normal(size=(4, 3))
    points /= np.linalg.norm(points, axis=1)[:, None]
    return ContactSet.from_arrays(0.03 * points, -points, model=model)


def test_a_flat_hull_resists_nothing() -> None:
    flat = contacts("frictionless")  # four primitive wrenches span no hull of six dimensions
    assert resisted_per_newton(flat, np.eye(6), length=0.03) == 0
    assert robust_epsilon(flat, length=0.03, position_error=0.002, normal_error=0.1) <= 0
    assert resisted_per_newton(contacts(), np.eye(6), length=0.03) > 0


@pytest.mark.parametrize("length", [1e-300, 1e300, 0.0, float("nan")])
def test_a_characteristic_length_is_in_range(length: float) -> None:
    for measure in (analyse, lambda c, length: resisted_per_newton(c, np.eye(6), length=length)):
        with pytest.raises(ContactError, match="from 1e-06 to 1e\\+06"):
            measure(contacts(), length=length)


@pytest.mark.parametrize("odd", [object(), {}, 10**400, [[1], [1, 2]], None])
def test_shapes_take_numbers(odd: Any) -> None:
    with pytest.raises(ObjectError, match="points"):
        Sphere(0.03).signed_distance(odd)
    with pytest.raises(ObjectError, match="vertices"):
        Mesh.from_triangles(odd, np.array([[0, 1, 2]]))
    with pytest.raises(ObjectError, match="faces"):
        Mesh.from_triangles(np.eye(3), odd)


def test_no_command_is_made_of_an_odd_file_name(tmp_path: Path) -> None:
    path = tmp_path / "a$(touch ran).off"
    path.write_text("OFF", encoding="utf-8")
    with pytest.raises(ObjectError, match=r"Convert it to \.ply") as told:
        Mesh.load(path)
    assert "python -c" not in str(told.value)


@pytest.mark.parametrize(
    "arguments",
    [
        ["plan", "allegro_hand", "sphere", "--out", LONG],
        ["hands", "hand.xml", "--describe", "--out", LONG],
        ["hands", LONG, "--check"],
        ["crosscheck", LONG],
        ["batch", LONG, "--extract", "0"],
        ["batch", "allegro_hand", "sphere", "-n", "1", "--out", LONG],
        ["test", "plan.json", "--protocol", "creep", "--budget", "nan"],
        ["analyse", "plan.json", "--forces", "--rate", "inf"],
        ["batch", "allegro_hand", "sphere", "-n", "1", "--workers", str(2**63), "--out", "b"],
    ],
)
def test_names_that_are_too_long_and_odd_numbers_are_refused(
    arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 3
    assert not list(tmp_path.iterdir())


def test_a_hand_that_mirrors_a_name_that_is_too_long(tmp_path: Path) -> None:
    file = tmp_path / "hand.toml"
    file.write_text(f'schema = 1\nname = "left"\nmirror_of = "{LONG}"\naxis = "y"\n', "utf-8")
    with pytest.raises(PlannerError):
        load_hand(file)
