"""What pages of reports are put together from: words, numbers, lines of plots, spans and marks."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from planner.hands.hand import Hand
from sim.show.parts import (
    _finger_of,
    column,
    command_plot,
    cone_plot,
    event_marks,
    facts_of,
    force_plot,
    in_words,
    measured_contacts,
    per_finger,
    phase_bands,
    quality_plot,
    shown,
)


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (None, "N", "unknown"),
        (True, "", "yes"),
        (False, "", "no"),
        (3, "", "3"),
        (12345, "N", "12345 N"),
        (0.123456, "m", "0.123 m"),
        ("soft", "N", "soft"),
        ([1.0, 2.5], "N", "1, 2.5 N"),
        ({"time_s": 0.5, "held": True}, "", "time (s) 0.5, held yes"),
    ],
)
def test_values_are_shown_with_their_unit(value: Any, unit: str, text: str) -> None:
    assert shown(value, unit) == text


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("time_to_angle_s", "time to angle (s)"),
        ("slip_mm_s", "slip (mm/s)"),
        ("turn_rad_s", "turn (rad/s)"),
        ("off_deg", "off (degrees)"),
        ("gap_mm", "gap (mm)"),
        ("grip_force_N", "grip force (N)"),
        ("mu", "mu"),
    ],
)
def test_names_in_files_become_words_with_the_unit_that_they_end_in(name: str, text: str) -> None:
    assert in_words(name) == text
    assert facts_of({name: 1}).rows == ((text, "1"),)


def test_null_becomes_a_missing_number() -> None:
    np.testing.assert_array_equal(column([1.0, None]), [1.0, np.nan])
    np.testing.assert_array_equal(per_finger([[1, None], [3, 4]], "ab"), [[1, np.nan], [3, 4]])
    assert per_finger([], "ab").shape == (0, 2)


def test_forces_are_drawn_beside_the_planned_ones_of_their_finger() -> None:
    measured, planned = np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([[5.0, 6.0]])
    lines = force_plot(("index", "thumb"), measured, planned).lines
    assert [(x.name, x.group, x.dashed) for x in lines] == [
        ("index", "index", False),
        ("index, planned", "index", True),
        ("thumb", "thumb", False),
        ("thumb, planned", "thumb", True),
    ]
    np.testing.assert_array_equal(lines[2].values, [2.0, 4.0])
    np.testing.assert_array_equal(lines[3].values, [6.0])
    assert len(force_plot(("index", "thumb"), measured, np.zeros((0, 2))).lines) == 2


def test_the_edge_of_the_cone_is_at_one_and_no_closure_at_zero() -> None:
    *fingers, edge = cone_plot(("index", "thumb"), np.array([[0.2, 0.4]])).lines
    assert [float(line.values[0]) for line in (*fingers, edge)] == [0.2, 0.4, 1.0]
    assert [line.dashed for line in (*fingers, edge)] == [False, False, True]
    epsilon, weight = quality_plot(np.array([0.1]), np.array([-0.3])).lines
    assert (float(epsilon.values[0]), float(weight.values[0])) == (0.1, 0.0)
    assert len(quality_plot(np.array([0.1]), None).lines) == 1


def test_commands_are_shares_of_the_ranges_that_there_are() -> None:
    recording: Any = SimpleNamespace(
        control_range=np.array([[-1.0, 3.0], [-np.inf, np.inf], [2.0, 2.0]]),
        commands=np.array([[0.0, 7.0, 2.0], [3.0, 8.0, 2.0]]),
        actuator_names=("a", "b", "c"),
    )
    plot = command_plot(recording, None)
    assert plot is not None
    first, lower, upper = plot.lines
    assert first.name == "a"
    np.testing.assert_allclose(first.values, [0.25, 1.0])
    assert (lower.name, *lower.values, upper.name, *upper.values) == (
        "lower limit",
        0.0,
        "upper limit",
        1.0,
    )
    recording.control_range = recording.control_range[1:]
    assert command_plot(recording, None) is None


def test_an_actuator_is_of_the_finger_that_it_moves(shadow: Hand) -> None:
    """By the names of the hand's actuators; the wrist is of none."""
    beginnings = {"FF": "index", "MF": "middle", "RF": "ring", "LF": "little", "TH": "thumb"}
    for k, name in enumerate(shadow.actuation.names):
        code = next((c for c in beginnings if c in name), None)
        assert _finger_of(shadow, k) == ("" if code is None else beginnings[code]), name
    assert _finger_of(None, 0) == ""


def test_phases_and_marks_are_where_their_samples_are() -> None:
    time, phase = [0.1, 0.2, 0.3, 0.4, 0.5], ["close", "close", "lift", "lift", "close"]
    assert [(b.name, b.begin, b.end) for b in phase_bands(time, phase)] == [
        ("close", 0.0, 0.2),
        ("lift", 0.2, 0.4),
        ("close", 0.4, 0.5),
    ]
    events: Any = [
        SimpleNamespace(time_s=0.5, kind="slip", finger="thumb", detail="3 mm/s"),
        SimpleNamespace(time_s=0.7, kind="contact", finger="", detail=""),
    ]
    marks = event_marks(events, shift=2.0)
    assert [(m.time, m.text) for m in marks] == [(2.5, "slip thumb: 3 mm/s"), (2.7, "contact")]


def test_cones_are_those_of_the_friction_that_most_contacts_have() -> None:
    friction = np.full((4, 2, 3), np.nan)
    friction[:3, 0, 0] = 0.5, 0.8, 0.8
    friction[:3, 0, 1] = 0.1  # torsion
    arrays = {name: np.zeros((4, 2, 3)) for name in ("points", "normals", "forces")}
    recording: Any = SimpleNamespace(friction=friction, contact_names=("a", "b"), **arrays)
    assert measured_contacts(recording).mu == 0.8
    recording.friction = np.full((4, 2, 3), np.nan)
    assert measured_contacts(recording).mu == 0.0
