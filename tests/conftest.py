"""Fixtures and meshes that several test modules share."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import brief
import numpy as np
import pytest
import trimesh
from hypothesis import settings

from planner.describe import postures
from planner.errors import ModelError
from planner.hand_loading import load_hand
from planner.hands.catalog import find_hand
from planner.hands.hand import Hand
from planner.numerics.kernels import COMPILE_VARIABLE
from planner.plan import GraspPlan
from planner.search.grasp import plan_grasp
from planner.shapes import Mesh
from planner.spatial import FloatArray
from planner.system.disk_cache import CACHE_VARIABLE
from planner.system.package import models_dir
from planner.task import GraspTask
from sim.controllers.base import Target
from sim.controllers.follow import MotionReference
from sim.real_hand import RealClock
from sim.report import TrialReport
from sim.scene.carrier import Timeline
from sim.trial import simulate

settings.register_profile("fixed", derandomize=True, deadline=None)  # busy machines are slow
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "fixed"))
# a run is what it was before: HYPOTHESIS_PROFILE=default draws afresh, and what that finds becomes
# an @example

RIGHT_HANDS = ("allegro_hand", "shadow_hand")


def of_trimesh(mesh: trimesh.Trimesh, *, repair: bool = False) -> Mesh:
    return Mesh.from_triangles(np.array(mesh.vertices), np.array(mesh.faces), repair=repair)


def box_mesh(size: Sequence[float] | FloatArray, halvings: int = 0) -> Mesh:
    """A box of triangles, each cut into four as often as said, so that it is no special case."""
    mesh = trimesh.creation.box(size)
    for _ in range(halvings):
        mesh = mesh.subdivide()
    return of_trimesh(mesh)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--write-missing",
        metavar="FILE",
        help="write the tests that are skipped for want of a package, one a line; pytest @FILE",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Run tests that are named, slow or not; let Ctrl-C be sent to what they start.

    What a shell starts in the background ignores it, and so would all that is started from there.
    """
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if config.option.markexpr == "not slow" and any("::" in name for name in config.args):
        config.option.markexpr = ""


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """Write which tests a missing package has skipped; alone or as the head of workers."""
    path = config.getoption("--write-missing")
    if path is None or hasattr(config, "workerinput"):
        return
    skipped = terminalreporter.stats.get("skipped", [])
    names = [report.nodeid for report in skipped if MISSING.search(report.longrepr[2])]
    Path(path).write_text("".join(f"{name}\n" for name in names), encoding="utf-8")


MISSING = re.compile("could not import|not installed|no package")
"""What the reason of a skip says if a package would help."""


@pytest.fixture(scope="session")
def allegro() -> Hand:
    return load_hand("allegro_hand")


@pytest.fixture(scope="session")
def shadow() -> Hand:
    return load_hand("shadow_hand")


def needs(*packages: str) -> pytest.MarkDecorator:
    """Mark of tests that are skipped where one of these packages is missing.

    Within a test or for a whole file, ``pytest.importorskip`` is the same. ``.ci/run`` has every
    package and fails where a test is skipped for want of one.
    """
    lacking = [name for name in packages if find_spec(name) is None]
    return pytest.mark.skipif(bool(lacking), reason=f"not installed: {', '.join(lacking)}")


def hand_of_others(name: str) -> Path:
    """The model of a hand that others published; the test is skipped without their package."""
    try:
        return find_hand(name)
    except ModelError as error:
        pytest.skip(f"not installed: {error}")


PlanOf = Callable[..., GraspPlan]
"""Gives the plan of a hand and an object: ``plan_of("allegro_hand", "box", seed=0, mu=0.6)``."""

ReportOf = Callable[..., TrialReport]
"""Gives the report of that plan's trial, by the quick timeline."""


@pytest.fixture(scope="session")
def plan_of() -> PlanOf:
    """Plans that are only input: planned once for each worker. Change none of their arrays."""

    @cache
    def planned(hand: str, thing: str, seed: int = 0, **options: Any) -> GraspPlan:
        return plan_grasp(GraspTask.create(hand, thing, **options), seed=seed)

    return planned


@pytest.fixture(scope="session")
def report_of(plan_of: PlanOf) -> ReportOf:
    """Reports of trials that are only input: executed once for each worker, in steps of 4 ms."""

    @cache
    def executed(hand: str, thing: str, seed: int = 0, **options: Any) -> TrialReport:
        plan = plan_of(hand, thing, seed, **options)
        return simulate(plan, timeline=Timeline.quick(), physics=brief.COARSE)

    return executed


@pytest.fixture(scope="module")
def brief_trials() -> Iterator[None]:
    """Trials of a module are brief unless they name another timeline: those of commands."""
    with brief.brief_trials():
        yield


@pytest.fixture(scope="module")
def coarse_steps() -> Iterator[None]:
    """Trials of a module take steps of 4 ms: of those that ask what is done with a trial."""
    with brief.coarse_steps():
        yield


@pytest.fixture(scope="module")
def plain_searches() -> Iterator[None]:
    """Searches of a module, and of the processes it starts, load no numba: 1 s for each process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(COMPILE_VARIABLE, "0")
        yield


@pytest.fixture(scope="module")
def small_shards() -> Iterator[None]:
    """Shards of a module's reset states are small."""
    with brief.small_shards():
        yield


@pytest.fixture(scope="session", params=RIGHT_HANDS)
def right_hand(request: pytest.FixtureRequest) -> Hand:
    hand = request.getfixturevalue(
        {"allegro_hand": "allegro", "shadow_hand": "shadow"}[request.param]
    )
    assert isinstance(hand, Hand)
    return hand


@pytest.fixture(scope="session")
def can_draw() -> bool:
    """Whether this machine draws without a display, found out by MuJoCo's own renderer."""
    program = "import mujoco as m; m.Renderer(m.MjModel.from_xml_string('<mujoco/>'), 8, 8)"
    environment = {"MUJOCO_GL": "egl", **os.environ} if sys.platform == "linux" else os.environ
    asked = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, check=False
    )
    return asked.returncode == 0


@pytest.fixture
def edit_hand(tmp_path: Path) -> Callable[..., Path]:
    """A copy of the Allegro's two files with pieces of text replaced; gives the hand.toml."""
    source = models_dir() / "hands" / "allegro_hand"

    def edit(toml: Mapping[str, str] | None = None, xml: Mapping[str, str] | None = None) -> Path:
        for name, changes in (("hand.toml", toml or {}), ("allegro_hand.xml", xml or {})):
            text = (source / name).read_text(encoding="utf-8")
            for old, new in changes.items():
                assert old in text, f"{old!r} is not in {name}: the test edits nothing"
                text = text.replace(old, new)
            (tmp_path / name).write_text(text, encoding="utf-8")
        return tmp_path / "hand.toml"

    return edit


@pytest.fixture
def virtual_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Real clocks of hands tell a time that passes only while they wait.

    A loop then meets every deadline, however busy the machine is. What happens where one is missed
    is tested with clocks of tests (test_real_hand_loop).
    """
    moment = [0.0]

    def sleep_until(_: RealClock, until: float) -> None:
        moment[0] = max(moment[0], until)

    monkeypatch.setattr(RealClock, "now", lambda _: moment[0])
    monkeypatch.setattr(RealClock, "sleep_until", sleep_until)


def calls_in(work: Callable[[], object]) -> int:
    """How many functions, of Python or of C, a piece of work calls: its cost on any machine."""
    count = 0

    def note(frame: object, event: str, argument: object) -> None:
        nonlocal count
        count += event in ("call", "c_call")

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        work()
    finally:
        sys.setprofile(before)
    return count


@contextmanager
def noting_advances(times: list[float]) -> Iterator[None]:
    """Note how long (s) references lead, step by step, in all that is executed meanwhile."""
    advance = MotionReference.advance

    def noted(reference: MotionReference, elapsed: float, *args: Any, **options: Any) -> Target:
        times.append(elapsed)
        return advance(reference, elapsed, *args, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(MotionReference, "advance", noted)
        yield


@pytest.fixture(scope="module")
def brief_postures(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Proposals of a module take postures from the shortest search, and from no cache but its own.

    For tests of everything else in a proposal: the search is nine tenths of its time.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(postures, "RADII", (0.022, 0.040))
        patch.setattr(postures, "FIRST", (0.022,))
        patch.setattr(postures, "STARTS", 1)
        patch.setenv(CACHE_VARIABLE, str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture
def brief_manipulations(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Manipulations take short phases and steps of 4 ms: those of commands and trainings."""
    from manipulations import QUICK  # here: most modules have no use for what it imports

    from sim.manipulation import ManipulationTimeline

    monkeypatch.setattr(ManipulationTimeline.__init__, "__kwdefaults__", asdict(QUICK))
    assert ManipulationTimeline() == QUICK
    with brief.coarse_steps():
        yield
