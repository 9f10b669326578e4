"""``_repr_html_``: tables with the numbers of the thing, a picture of it, quick, made once."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Iterator
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import PlanOf, ReportOf
from manipulations import QUICK
from PIL import Image, ImageDraw

from planner.batch import GraspSet, plan_grasps
from planner.contacts import ContactSet
from planner.errors import NotFoundError
from planner.hand_loading import load_hand
from planner.hands.catalog import hand_names
from planner.motion import plan_motion
from planner.motion.manipulation import manipulation_task, plan_manipulation
from planner.objects import parse_object
from planner.pages.notebook import MOST_ROWS, notebook_html
from planner.plan import GraspPlan
from planner.showing import in_notebook
from planner.task import GraspTask
from sim.manipulation import ManipulationReport, manipulate
from sim.report import TrialReport
from sim.simulation import Simulation
from sim.trial import simulate

pytestmark = pytest.mark.usefixtures("coarse_steps")

MOST_POLYGONS = 150_000
"""That a picture may draw, which is what it costs: 0.04 to 0.25 s where nothing else runs."""

LARGEST = 15_000
"""Bytes of a picture."""


class Cells(HTMLParser):
    """Texts of the cells of a table, row by row, and tags that are left open."""

    def __init__(self, html: str) -> None:
        """Read it."""
        super().__init__()
        self.rows: list[list[str]] = []
        self.open: list[str] = []
        self.pictures = 0
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Rows and cells begin."""
        if tag == "img":
            self.pictures += 1
            return
        self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        elif tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_endtag(self, tag: str) -> None:
        """Every tag ends where it should."""
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        """Text of a cell."""
        if self.open[-1] in ("td", "th"):
            self.rows[-1][-1] += data


def seen(thing: Any) -> Cells:
    """What a notebook shows of a thing, after the checks that hold for every kind."""
    with pytest.MonkeyPatch.context() as patch:
        drawn: list[int] = []
        polygon = ImageDraw.ImageDraw.polygon

        def counted(draw: Any, *corners: Any, **options: Any) -> None:
            drawn.append(1)
            polygon(draw, *corners, **options)

        patch.setattr(ImageDraw.ImageDraw, "polygon", counted)
        html: str = thing._repr_html_()
    assert len(drawn) < MOST_POLYGONS
    assert thing._repr_html_() is html
    cells = Cells(html)
    assert not cells.open
    assert "http:" not in html
    assert "https:" not in html
    return cells


def picture(thing: Any) -> Image.Image:
    """The picture of a thing, which is not blank."""
    found = re.search(r'src="data:image/png;base64,([^"]+)"', thing._repr_html_())
    assert found is not None
    content = base64.b64decode(found[1])
    assert len(content) <= LARGEST
    image = Image.open(io.BytesIO(content)).convert("RGB")
    colours = image.getcolors(maxcolors=1 << 20) or []
    assert len(colours) > 20
    assert max(count for count, _ in colours) < 0.97 * image.width * image.height
    return image


@pytest.fixture(scope="module", autouse=True)
def _warm() -> None:
    load_hand("allegro_hand").rolling._repr_html_()


@pytest.fixture(scope="module")
def plan(plan_of: PlanOf) -> GraspPlan:
    return plan_of("allegro_hand", "cylinder:0.03x0.10")


@pytest.fixture(scope="module")
def report(report_of: ReportOf) -> TrialReport:
    return report_of("allegro_hand", "cylinder:0.03x0.10")


@pytest.fixture(scope="module")
def turned() -> Iterator[ManipulationReport]:
    task = manipulation_task("allegro_hand", parse_object("cylinder:0.03x0.08"), mu=0.45)
    yield manipulate(plan_manipulation(task, angle=0.3), timeline=QUICK)


@pytest.mark.slow
def test_a_plan_shows_its_contacts_and_forces(plan: GraspPlan) -> None:
    head, *rows = seen(plan).rows
    assert head == ["finger", "contact in object (mm)", "normal force (N)", "friction used"]
    at, used = plan.contacts_in_object.positions, plan.contacts.friction_utilisation()
    assert [row[0] for row in rows] == list(plan.task.finger_names)
    for i, (_, where, force, share) in enumerate(rows):
        np.testing.assert_allclose([float(v) for v in where.split(",")], 1e3 * at[i], atol=0.051)
        assert float(force) == pytest.approx(plan.contacts.forces[i, 0], abs=0.0051)
        assert float(share.rstrip(" %")) == pytest.approx(100 * used[i], abs=0.51)
    assert f"epsilon {plan.quality.epsilon:.4f}" in plan._repr_html_()
    picture(plan)


@pytest.mark.parametrize("name", hand_names())
def test_every_hand_shows_its_fingers_and_its_palm(name: str) -> None:
    hand = load_hand(name).rolling  # not the one that others may have looked at
    _, *rows = seen(hand).rows
    assert [row[0] for row in rows] == list(hand.fingers)
    for row, finger in zip(rows, hand.fingers.values(), strict=True):
        assert row[1] == str(len(finger.q_index))
        assert float(row[2]) == pytest.approx(1e3 * finger.pad.radius, abs=0.051)
        assert row[3].split(", ") == [hand.joint_names[int(i)] for i in finger.q_index]
    picture(hand)


def test_left_and_right_hands_look_different() -> None:
    left, right = (picture(load_hand(n)) for n in ("shadow_hand_left", "shadow_hand"))
    apart = np.abs(np.asarray(left, float) - np.asarray(right, float)).max(axis=2) > 60
    assert apart.mean() > 0.02


def test_contacts_show_positions_normals_friction_and_forces(plan: GraspPlan) -> None:
    _, *rows = seen(plan.contacts).rows
    for i, (finger, where, normal, friction, force) in enumerate(rows):
        contact = plan.contacts[i]
        assert finger == contact.finger
        np.testing.assert_allclose(
            [float(v) for v in where.split(",")], 1e3 * contact.position, atol=0.051
        )
        np.testing.assert_allclose(
            [float(v) for v in normal.split(",")], contact.frame[:, 0], atol=0.0051
        )
        assert friction == f"point, mu {contact.mu:g}"
        assert float(force) == pytest.approx(contact.force[0], abs=0.0051)
    picture(plan.contacts)


def test_few_contacts_without_names_and_forces_are_shown() -> None:
    none = ContactSet.from_arrays([], [])
    assert "0 contacts" in none._repr_html_()
    assert seen(none).pictures == 0
    one = ContactSet.from_arrays([[0.0, 0, 0]], [[0, 0, 1]])
    assert seen(one).rows[1] == ["0", "0.0, 0.0, 0.0", "0.00, 0.00, 1.00", "point, mu 0.5", ""]
    assert seen(one).pictures == 1
    many = ContactSet.from_arrays(np.eye(3).repeat(7, axis=0), np.eye(3).repeat(7, axis=0))
    assert len(seen(many).rows) == 1 + MOST_ROWS
    assert f"and {21 - MOST_ROWS} more" in many._repr_html_()


def test_a_motion_shows_its_margins() -> None:
    motion = plan_motion(GraspTask.create("allegro_hand", "cylinder:0.03x0.08"), angle=0.3)
    rows = dict(row for row in seen(motion).rows)
    assert rows["knots"] == str(len(motion.knots))
    assert float(rows["least normalised min-weight"]) == pytest.approx(motion.margin, abs=5.1e-4)
    assert str(motion.path) in motion._repr_html_()
    picture(motion)


def test_a_trial_shows_planned_and_measured_forces(report: TrialReport) -> None:
    _, *rows = seen(report).rows
    assert [row[0] for row in rows] == list(report.fingers)
    for row, c in zip(rows, report.comparison, strict=True):
        told = [float(v) for v in row[1:]]
        true = [c.position_error_mm, c.planned_normal_force, c.measured_normal_force]
        np.testing.assert_allclose(told, true, atol=0.0051)
    assert "held: the object moved" in report._repr_html_()
    picture(report)


def test_a_report_without_a_recording_has_a_table_alone(report: TrialReport) -> None:
    poses = ("T_world_base", "T_world_object")
    over_time = (
        "time",
        "phase",
        "q",
        *poses,
        "points",
        "normals",
        "forces",
        "friction",
        "commands",
    )
    recording = report.recording
    nothing = replace(recording, **{name: getattr(recording, name)[:0] for name in over_time})
    cells = seen(replace(report, recording=nothing))
    assert cells.pictures == 0
    assert len(cells.rows) == 1 + len(report.fingers)


@pytest.mark.slow
def test_a_manipulation_shows_its_phases(turned: ManipulationReport) -> None:
    _, *rows = seen(turned).rows
    assert [row[0] for row in rows] == [r.phase for r in turned.results][:MOST_ROWS]
    assert [row[1] == "passed" for row in rows] == [r.passed for r in turned.results][:MOST_ROWS]
    assert f"turned {np.rad2deg(turned.turned):.2f} of" in turned._repr_html_()
    picture(turned)


@pytest.mark.slow
def test_a_dataset_shows_what_was_found_of_each_object(tmp_path: Path) -> None:
    plan_grasps("allegro_hand", ["box", "sphere"], 3, workers=1, out=tmp_path)
    grasps = GraspSet(tmp_path)
    _, *rows = seen(grasps).rows
    assert [row[0] for row in rows] == list(grasps.labels)
    for label, found, attempts, epsilon in rows:
        mine = [row for row in grasps if row["object"] == label]
        held = [row for row in mine if row["found"]]
        assert found == f"{len(held)} of {len(mine)}"
        assert float(attempts) == pytest.approx(
            sum(row["attempts"] for row in mine) / len(held), abs=0.051
        )
        assert float(epsilon) == pytest.approx(
            float(np.median([row["epsilon"] for row in held])), abs=5.1e-4
        )
    picture(grasps)


def test_names_that_look_like_html_are_text(plan: GraspPlan) -> None:
    nasty = '<script>alert("1 & 2")</script>'
    assert nasty not in notebook_html(nasty, (nasty,), ((nasty,),), notes=(nasty,), picture=b"x")
    fingers = tuple(nasty for _ in plan.contacts.fingers)
    cells = seen(replace(plan.contacts, fingers=fingers))
    assert [row[0] for row in cells.rows[1:]] == list(fingers)


@pytest.mark.slow
def test_a_failed_trial_is_shown_where_it_ended(plan: GraspPlan) -> None:
    def stop(simulation: Simulation) -> None:
        if simulation.time > 1.0:
            simulation.stop("seen enough")

    report = simulate(plan, on_step=stop)
    assert "not held" in report._repr_html_()
    assert report.verdict.detail in report._repr_html_()
    picture(report)


def test_a_kind_that_nobody_registered_is_named() -> None:
    class Other:
        """Something else."""

    with pytest.raises(NotFoundError, match=r"Other.*register_notebook"):
        in_notebook(Other())
