"""What a command loads before it does anything: time from Enter to the file."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from conftest import PlanOf

from planner.system import scipy_parts

MODULES_OF = """
import sys
from sim.cli import main
sys.argv[0] = "opposable"
if sys.argv[1] == "run":  # a trial is no shorter on the command line
    from sim.scene.carrier import Timeline
    Timeline.__init__.__kwdefaults__ |= {"approach": 0.3, "squeeze": 0.4, "lift": 0.3, "hold": 0.1}
try:
    main()
except SystemExit as end:
    assert not end.code, end.code
print("\\n".join(sys.modules), file=sys.stderr)
"""

SLOW = {
    *("scipy.optimize", "scipy.spatial", "scipy.linalg", "scipy.sparse", "scipy.special"),
    *("matplotlib", "numba", "trimesh", "glfw", "joblib", "pandas", "qpsolvers"),
    *(
        "sim.learning",
        "sim.sensing.touch",
        "sim.manipulation",
        "sim.sensing.estimation",
        "planner.motion",
    ),
    *(
        "planner.search.refine",
        "planner.describe",
        "planner.synthesis.loops.solver",
        "planner.batch",
    ),
}
"""What a plan of a known hand and a known object has no use for."""

TOO_MUCH_TO_RUN = {
    *("sim.learning", "sim.sensing.touch", "sim.manipulation", "sim.sensing.estimation"),
    *("planner.motion", "planner.batch", "planner.shapes.pieces", "matplotlib", "numba"),
}
"""What a trial has no use for."""

MOST_TO_PLAN, MOST_TO_RUN = 122, 160
"""Modules of ours that the commands load, at most."""


def modules_of(*words: str) -> set[str]:
    """What is loaded when a command has ended."""
    done = subprocess.run(
        [sys.executable, "-c", MODULES_OF, *words], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return set(done.stderr.split())


def ours(modules: set[str]) -> set[str]:
    """Modules of both packages."""
    return {m for m in modules if m.split(".")[0] in ("planner", "sim")}


@pytest.mark.slow
def test_a_plan_loads_little(plan_of: PlanOf, tmp_path: Path) -> None:
    plan_of("allegro_hand", "mug")  # the mug's field is on disk from now on
    loaded = modules_of("plan", "allegro_hand", "mug", "-o", str(tmp_path / "plan.json"))
    assert "planner.search.grasp" in loaded  # it did plan
    assert not loaded & SLOW
    assert len(ours(loaded)) <= MOST_TO_PLAN


@pytest.mark.slow
def test_a_trial_loads_what_a_trial_needs(tmp_path: Path) -> None:
    loaded = modules_of("run", "allegro_hand", "sphere", "--out", str(tmp_path / "run"))
    assert "sim.trial" in loaded
    commands = {m.split(".")[2] for m in loaded if m.startswith("sim.cli.")}
    assert commands == {"common", "execution", "grasp", "listing", "options", "search", "tasks"}
    assert not loaded & TOO_MUCH_TO_RUN
    assert len(ours(loaded)) <= MOST_TO_RUN


WHOLE_AFTERWARDS = """
from threading import Thread
found = []
def whole():
    from scipy.spatial import cKDTree
    from scipy.linalg import null_space
    found.append(cKDTree)
threads = [Thread(target=whole) for _ in range(4)]
for thread in threads:
    thread.start()
from planner.system.scipy_parts import ConvexHull, QhullError, dposv, nnls
for thread in threads:
    thread.join()
assert len(found) == 4, found
import scipy.linalg.lapack, scipy.optimize, scipy.spatial, scipy.sparse.csgraph
from scipy.linalg import cython_lapack
from scipy.spatial.transform import Rotation
assert scipy.spatial.ConvexHull is ConvexHull and scipy.spatial.QhullError is QhullError
assert scipy.linalg.lapack.dposv is dposv and scipy.optimize.nnls is nnls
assert scipy.optimize.linprog([1.0], bounds=[(2.0, 3.0)]).x[0] == 2.0
assert scipy.optimize.minimize(lambda x: (x[0] - 1) ** 2, [0.0], method="SLSQP").success
"""


@pytest.mark.parametrize("first", ["", "import scipy.spatial\n", "import scipy.optimize\n"])
def test_scipy_is_whole_for_everyone_else(first: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", first + WHOLE_AFTERWARDS],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


def test_where_scipy_has_moved_a_module_its_public_name_is_taken() -> None:
    source = Path(scipy_parts.__file__).read_text(encoding="utf-8")
    moved = source.replace("_nnls", "_moved") + (
        "import numpy as np\n"
        "assert len(ConvexHull(np.random.default_rng(0).normal(size=(9, 3))).vertices)\n"
        "assert nnls(np.eye(2), np.ones(2))[0].sum() == 2.0\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", moved], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
