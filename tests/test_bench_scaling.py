"""Curves of cost, and the hands of any number of fingers that one of them needs."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from benchmarks.scaling import (
    CURVES,
    _build_for_meshes,
    curve,
    points_of,
    run_scaling,
    scaling_tables,
)
from benchmarks.star_hand import write_star_hand
from planner.errors import NotFoundError
from planner.hand_loading import load_hand
from planner.kinematics.state import HandState
from planner.shapes.field.mesh_field import fit_mesh_field
from planner.system.disk_cache import CACHE_VARIABLE
from sim.runner import Runner

HERE = Runner(console=Console(quiet=True), check=lambda: None)
"""Works here, shows nothing, and never finds Ctrl-C."""


@pytest.mark.parametrize("n", [2, 5, 8])
def test_a_star_hand_has_equal_fingers_around_its_palm(n: int, tmp_path: Path) -> None:
    hand = load_hand(write_star_hand(tmp_path, n))
    assert len(hand.fingers) == n
    assert hand.nq == 4 * n
    state = HandState(hand, hand.posture("pinch"))
    tips = np.array(
        [state.joint_pose(f.pad.joint_id).act(f.pad.center) for f in hand.fingers.values()]
    )
    assert np.linalg.norm(tips[:, :2], axis=1) == pytest.approx(0.038, abs=5e-4)
    assert np.ptp(tips[:, 2]) == pytest.approx(0.0, abs=1e-9)
    step = np.roll(tips, -1, axis=0) - tips
    assert np.ptp(np.linalg.norm(step, axis=1)) == pytest.approx(0.0, abs=1e-8)


def test_laws_leave_out_what_is_not_comparable() -> None:
    points = [
        {"x": x, "fitted": x > 2, "prepare_cpu_s": 1.0, "cpu_s_per_found": None}
        | {"cpu_s_per_attempt": 99.0 if x == 2 else 0.5 * x**2}
        for x in (2, 4, 8)
    ]
    laws = curve("contacts", points)["laws"]
    assert laws["cpu_s_per_attempt"]["exponent"] == pytest.approx(2.0)
    assert laws["cpu_s_per_attempt"]["factor"] == pytest.approx(0.5)
    assert laws["prepare_cpu_s"]["exponent"] == pytest.approx(0.0, abs=1e-12)
    assert laws["cpu_s_per_found"] is None


def test_efficiency_is_over_one_worker() -> None:
    points = [{"x": 1, "grasps_per_s": 10.0}, {"x": 2, "grasps_per_s": 18.0}]
    item = curve("workers", points)
    assert [p["efficiency"] for p in item["points"]] == pytest.approx([1.0, 0.9])
    assert item["laws"]["grasps_per_s"]["exponent"] == pytest.approx(np.log2(1.8))
    assert curve("workers", points[1:])["points"][0]["efficiency"] is None


def test_where_curves_are_measured() -> None:
    assert points_of("grasps", 1000, 2) == [1, 10, 100, 1000]
    assert points_of("grasps", 300, 2) == [1, 10, 100, 300]
    assert points_of("workers", 300, 2) == [1, 2]
    assert points_of("contacts", 300, 2) == [2, 3, 4, 5, 6, 7, 8]
    assert set(CURVES) == {"contacts", "triangles", "grasps", "workers"}


def test_contacts_and_triangles_are_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "benchmarks.scaling.points_of",
        lambda name, *_: {"contacts": [2, 3], "triangles": [1]}[name],
    )
    fitted: list[float] = []

    def fit(*arguments: Any, **options: Any) -> Any:
        begin = time.process_time()
        field = fit_mesh_field(*arguments, **options)
        fitted.append(time.process_time() - begin)
        return field

    _build_for_meshes("allegro_hand")  # that fits a field too, on a machine where none is kept
    monkeypatch.setattr("planner.shapes.mesh.fit_mesh_field", fit)
    before = os.environ.get(CACHE_VARIABLE)
    result = run_scaling(
        "allegro_hand",
        ["contacts", "triangles"],
        1,
        most_grasps=1,
        runner=HERE,
    )
    assert os.environ.get(CACHE_VARIABLE) == before
    contacts, triangles = result["curves"]
    assert [(p["x"], p["fitted"]) for p in contacts["points"]] == [(2, False), (3, True)]
    assert triangles["points"][0]["x"] == 80
    assert all(p["found"] == 1 for p in contacts["points"] + triangles["points"])
    # nothing was prepared before, in memory or on disk; and what is told holds the time of the fit
    (fit_s,) = fitted
    assert triangles["points"][0]["prepare_cpu_s"] > fit_s
    assert [t.row_count for t in scaling_tables(result)] == [4, 3]


def test_grasps_are_counted() -> None:
    pytest.importorskip("pyarrow")
    result = run_scaling("allegro_hand", ["grasps"], 1, most_grasps=4, runner=HERE)
    (item,) = result["curves"]
    assert [p["x"] for p in item["points"]] == [1, 4]
    assert item["points"][1]["found"] == 4
    assert item["points"][1]["cpu_s"] > item["points"][0]["cpu_s"]
    assert item["points"][1]["peak_memory_mb"] > 50


def test_a_curve_that_does_not_exist_is_refused() -> None:
    with pytest.raises(NotFoundError, match="no curve is called 'mass'"):
        run_scaling("allegro_hand", ["mass"], 1, most_grasps=1, runner=HERE)
