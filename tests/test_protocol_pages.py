"""Pages of the trials of protocols: states are those of the trial, whatever carries the hand."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import PlanOf
from typer.testing import CliRunner

from planner.errors import TaskError
from planner.files import write_plan
from planner.kinematics import HandState
from planner.pages.page import page_html, read_page_data
from planner.plan import GraspPlan
from planner.spatial import pose_from_wxyz
from sim.cli import app
from sim.protocols import ProtocolReport, run_protocol
from sim.protocols.page import outcome_page

pytestmark = pytest.mark.usefixtures("coarse_steps")

TRIALS = {
    "dexgraspbench": "dexgraspbench +x",
    "forces": "force +x",
    "shake": "shake rx",
    "robust": "mass x2, friction x0.7, pose 0 mm 0 deg",
}
"""Protocol -> one of its trials."""


@pytest.fixture(scope="module")
def plan(plan_of: PlanOf) -> GraspPlan:
    return plan_of("allegro_hand", "cylinder")


@pytest.fixture(scope="module", params=list(TRIALS))
def report(request: pytest.FixtureRequest, plan: GraspPlan) -> ProtocolReport:
    return run_protocol(plan, request.param, only=[TRIALS[request.param]])


def test_recorded_contacts_lie_between_pad_and_object(
    report: ProtocolReport, plan: GraspPlan
) -> None:
    """So poses of base and object are those of the contacts, by Pinocchio and the true shape."""
    (outcome,) = report.outcomes
    recording, seen = outcome.recording, 0
    assert recording is not None and len(recording) == len(outcome.samples) > 10
    for i in range(len(recording)):
        item = pose_from_wxyz(*np.split(recording.T_world_object[i], [3]))
        base = pose_from_wxyz(*np.split(recording.T_world_base[i], [3]))
        state = HandState(plan.task.hand, recording.q[i])
        for k, finger in enumerate(plan.task.fingers):
            point = recording.points[i, k]
            if not np.isfinite(point).all():
                continue
            seen += 1
            local = item.inverse().act(point)
            assert abs(plan.task.object.shape.signed_distance(local[None])[0]) < 3e-3, (
                i,
                finger.name,
            )
            away = np.linalg.norm(base.act(state.pad_center(finger)) - point)
            assert abs(away - finger.pad.radius) < 4e-3, (i, finger.name)
    assert seen > 20


def test_a_trial_of_a_protocol_has_a_page(report: ProtocolReport, plan: GraspPlan) -> None:
    (outcome,) = report.outcomes
    page = outcome_page(report, outcome, plan)
    assert page.verdict is not None and page.scene is not None
    assert page.verdict.good == (outcome.held or outcome.grows)
    if outcome.fault is not None:
        assert page.verdict.reason == outcome.fault.detail
        assert page.scene.start == pytest.approx(outcome.fault.time, abs=0.11)
    on_table = "table" in page.scene.models
    assert on_table == (report.protocol == "robust")
    assert TRIALS[report.protocol] in page.title
    assert "opposable-scene" in page_html(page)


def test_without_states_there_is_no_page(report: ProtocolReport, plan: GraspPlan) -> None:
    (outcome,) = report.outcomes
    with pytest.raises(TaskError, match="has no recorded states, so it has no page"):
        outcome_page(report, replace(outcome, recording=None), plan)


@pytest.mark.slow
def test_the_command_writes_pages_of_failures(plan: GraspPlan, tmp_path: Path) -> None:
    write_plan(plan, tmp_path / "plan.json")
    words = ["test", str(tmp_path / "plan.json"), "--protocol", "all", "--workers", "1"]
    words += ["--out", str(tmp_path / "out")]
    for only in ("mass x0.5, friction x1, pose 0 mm 0 deg", TRIALS["robust"]):
        words += ["--only", only]
    done = CliRunner().invoke(app, [*words, "--pages", "failures"])
    assert done.exit_code in (0, 1), done.output
    lines = (tmp_path / "out" / "000-plan-robust.jsonl").read_text(encoding="utf-8").splitlines()
    lost = [row for row in map(json.loads, lines) if not row["held"]]
    pages = sorted((tmp_path / "out").glob("*.html"))
    assert len(lines) == 2 and len(pages) == len(lost)
    assert f"pages to open in a browser: {len(lost)}" in done.output
    for page, row in zip(pages, lost, strict=True):
        kind, data = read_page_data(page)
        assert (kind, data["trial"], data["protocol"]) == ("trial", row["trial"], "robust")
        assert "--pages failures" in data["command"]
    refused = CliRunner().invoke(app, [*words, "--pages", "some"])
    assert refused.exit_code == 3 and "choice of pages" in refused.output
