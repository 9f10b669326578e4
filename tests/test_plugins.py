"""A package of others brings a hand, a format, a protocol and more, by its entry points alone."""

from __future__ import annotations

import importlib
import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planner.errors import ModelError, NotFoundError, TaskError
from planner.exchange.formats import FORMATS, Reading, format_of, writable_format
from planner.hand_loading import load_hand
from planner.hands.catalog import foreign_hand_names
from planner.objects import parse_object
from planner.plan import GraspPlan
from planner.registry import forget_plugins
from planner.search.grasp import plan_grasp
from planner.system.package import models_dir
from planner.task import GraspTask
from sim.controllers import GraspController, controller_maker
from sim.protocols import in_all, run_protocol, unsuitable
from sim.protocols.disturbance import Settings
from sim.protocols.run import cases_of
from sim.sensing.touch.senses import check_touch

PACKAGE = '''"""What a laboratory brings for Opposable."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from planner.exchange import ImportedGrasp, ImportedGrasps, GraspFormat
from planner.spatial import SE3
from sim.controllers import GraspController
from sim.protocols.forces import forces_cases

HAND = Path(__file__).parent / "hand.toml"


def read(path, hand, reading):
    """Joints alone, the hand a tenth of a metre above the object."""
    rows = json.loads(path.read_text())["lab_grasps"]
    place = SE3(np.eye(3), np.array([0.0, 0.0, 0.1]))
    grasps = tuple(
        ImportedGrasp(name=f"row {i}", T_object_base=place, q=np.array(row))
        for i, row in enumerate(rows)
    )
    return ImportedGrasps(source=path, format="lab", hand="", grasps=grasps)


FORMAT = GraspFormat(
    name="lab",
    title="grasps of our laboratory",
    suffixes=(".lab",),
    loses="",
    recognises=lambda path: path.suffix == ".lab",
    read=read,
)


def upwards(settings, seed):
    """The first of the trials of "forces"."""
    return forces_cases(settings, seed)[:1]


upwards.in_all = True
upwards.unsuitable = lambda task: "boxes only" if "sphere" in task.object.name else ""

class Driver(GraspController):
    """Drives as the usual one does."""


def skin(context):
    """No sense at all."""
'''

ENTRY_POINTS = """
[opposable.hands]
lab_hand = lab_of_ours:HAND
[opposable.formats]
lab = lab_of_ours:FORMAT
[opposable.protocols]
upwards = lab_of_ours:upwards
torn = no_such_package:cases
[opposable.controllers]
lab_driver = lab_of_ours:Driver
[opposable.senses]
lab_skin = lab_of_ours:skin
broken = lab_of_ours:nothing_of_the_kind
"""


@pytest.fixture
def laboratory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The package, installed in a folder of its own."""
    package, told = tmp_path / "lab_of_ours", tmp_path / "lab_of_ours-1.0.dist-info"
    package.mkdir()
    told.mkdir()
    (package / "__init__.py").write_text(PACKAGE, encoding="utf-8")
    shipped = models_dir() / "hands" / "allegro_hand"
    text = (shipped / "hand.toml").read_text(encoding="utf-8")
    model = next(line for line in text.splitlines() if line.startswith("model = "))
    whole = f"model = {json.dumps(str(shipped / json.loads(model.partition(' = ')[2])))}"
    (package / "hand.toml").write_text(text.replace(model, whole), encoding="utf-8")
    (told / "METADATA").write_text("Metadata-Version: 2.1\nName: lab_of_ours\nVersion: 1.0\n")
    (told / "entry_points.txt").write_text(ENTRY_POINTS, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    importlib.invalidate_caches()
    forget_plugins()
    yield tmp_path
    monkeypatch.undo()
    forget_plugins()
    sys.modules.pop("lab_of_ours", None)
    FORMATS.pop("lab", None)


@pytest.fixture(scope="module")
def plan() -> GraspPlan:
    return plan_grasp(GraspTask.create("allegro_hand", "box"), seed=0)


def test_a_hand(laboratory: Path) -> None:
    hand = load_hand("lab_hand")
    assert hand.path == laboratory / "lab_of_ours" / "hand.toml"
    assert "lab_hand" in foreign_hand_names()
    np.testing.assert_array_equal(hand.q_lower, load_hand("allegro_hand").q_lower)
    task = GraspTask.create("lab_hand", parse_object("box"))
    assert task.hand.reference == "lab_hand", "plan files name it so"


def test_a_format(laboratory: Path) -> None:
    file, hand = laboratory / "a.lab", load_hand("allegro_hand")
    file.write_text(json.dumps({"lab_grasps": [[0.1] * hand.nq]}), encoding="utf-8")
    found = format_of(file)
    assert found.read is not None
    (grasp,) = found.read(file, hand, Reading()).grasps
    np.testing.assert_array_equal(grasp.q, np.full(hand.nq, 0.1))
    with pytest.raises(TaskError, match=r"lab is read only; formats that are written: .*table"):
        writable_format("lab")


@pytest.mark.slow
def test_a_protocol(laboratory: Path, plan: GraspPlan) -> None:
    assert len(cases_of("upwards", Settings(), 0)) == 1
    assert "upwards" in in_all()
    report = run_protocol(plan, "upwards")
    assert (report.protocol, report.asked, len(report.outcomes)) == ("upwards", 1, 1)


def test_a_protocol_refuses_a_plan_and_stays_out_of_all(laboratory: Path, plan: GraspPlan) -> None:
    task = replace(plan.task, object=parse_object("sphere"), table_height=None)
    ball = replace(plan, task=task)
    with pytest.raises(TaskError, match="boxes only"):
        run_protocol(ball, "upwards")
    assert unsuitable("upwards", plan.task) == ""
    import lab_of_ours  # type: ignore[import-not-found]

    assert "torn" not in in_all()  # it cannot be imported, which a warning says
    with pytest.raises(ModelError, match="no_such_package"):
        run_protocol(plan, "torn")
    lab_of_ours.upwards.in_all = False
    assert "upwards" not in in_all()


def test_a_controller_and_a_sense(laboratory: Path, plan: GraspPlan) -> None:
    made = controller_maker("lab_driver")(plan)
    assert (type(made).__name__, isinstance(made, GraspController)) == ("Driver", True)
    assert check_touch("lab_skin") == "lab_skin"


def test_what_nobody_brings_is_not_there(laboratory: Path) -> None:
    for ask in (
        lambda: load_hand("lab_foot"),
        lambda: cases_of("downwards", Settings(), 0),
        lambda: check_touch("skin"),
        lambda: controller_maker("driver"),
    ):
        with pytest.raises(NotFoundError):
            ask()
    with pytest.raises(NotFoundError, match="upwards"):
        cases_of("upward", Settings(), 0)


def test_what_cannot_be_imported_names_its_package(laboratory: Path) -> None:
    with pytest.raises(ModelError, match=r"lab_of_ours brings 'broken'.*mend or uninstall"):
        check_touch("broken")
