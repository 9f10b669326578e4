"""CPU time by stage."""

from __future__ import annotations

import pytest

from planner.system.threads import stage, timed


class Processor:
    """A processor's clock that goes on where the test says so."""

    used = 100.0

    def burn(self, seconds: float) -> None:
        self.used += seconds


@pytest.fixture
def processor(monkeypatch: pytest.MonkeyPatch) -> Processor:
    clock = Processor()
    monkeypatch.setattr("planner.system.threads.time.process_time", lambda: clock.used)
    return clock


def test_inner_stages_do_not_count_for_outer_ones(processor: Processor) -> None:
    with timed() as spent:
        with stage("outer"):
            processor.burn(0.02)
            with stage("inner"):
                processor.burn(0.04)
            processor.burn(0.01)
        with stage("inner"):
            processor.burn(0.01)
    assert spent["outer"] == pytest.approx(0.03, abs=1e-9)
    assert spent["inner"] == pytest.approx(0.05, abs=1e-9)


def test_nobody_is_timed_outside_and_after_an_error_all_is_as_before(processor: Processor) -> None:
    with timed() as spent:
        with pytest.raises(ValueError, match="x"), stage("failed"):
            raise ValueError("x")
        with stage("next"):
            processor.burn(0.01)
    with stage("outside"):
        pass
    assert set(spent) == {"failed", "next"}
    assert spent["next"] == pytest.approx(0.01, abs=1e-9)
