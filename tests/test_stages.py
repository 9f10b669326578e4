"""CPU time by stage."""

from __future__ import annotations

import time

import pytest

from planner.system.stage_times import stage, timed


def burn(seconds: float) -> None:
    """Use the processor for so long."""
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass


def test_inner_stages_do_not_count_for_outer_ones() -> None:
    with timed() as spent:
        with stage("outer"):
            burn(0.02)
            with stage("inner"):
                burn(0.04)
            burn(0.01)
        with stage("inner"):
            burn(0.01)
    assert spent["outer"] == pytest.approx(0.03, abs=0.008)
    assert spent["inner"] == pytest.approx(0.05, abs=0.008)


def test_nobody_is_timed_outside_and_after_an_error_all_is_as_before() -> None:
    with timed() as spent:
        with pytest.raises(ValueError, match="x"), stage("failed"):
            raise ValueError("x")
        with stage("next"):
            burn(0.01)
    with stage("outside"):
        pass
    assert set(spent) == {"failed", "next"}
    assert spent["next"] == pytest.approx(0.01, abs=0.005)
