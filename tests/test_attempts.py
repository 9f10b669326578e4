"""``planner.attempt``: what is said when a budget ends."""

from __future__ import annotations

from planner.attempt import Attempt, nothing_found


def failed(*reasons: str) -> list[Attempt[None]]:
    """Attempts that failed for these reasons."""
    return [Attempt(index=i, plan=None, reason=r, cpu_s=0.0) for i, r in enumerate(reasons)]


def test_reasons_that_differ_in_numbers_alone_are_one() -> None:
    made = failed(
        "forces: 49.1 N is too much; in the way: a; b",
        "not solved: load of actuator A_thumb_0 at 0 % of the path, off by 0.33",
        "not solved: load of actuator A_thumb_1 at 0 % of the path, off by 0.2",
        "not solved: load of actuator A_thumb_1 at 33 % of the path, off by -1e-05",
        "not solved: load of actuator A_thumb_1 at 67 % of the path, off by 3",
    )
    error = nothing_found("way", made, "Try less")
    assert str(error) == (
        "no way in 5 attempts: "
        "3 x not solved: load of actuator A_thumb_1 at 0 % of the path, off by 0.2; "
        "1 x forces: 49.1 N is too much; "
        "1 x not solved: load of actuator A_thumb_0 at 0 % of the path, off by 0.33. Try less"
    )
    assert error.attempts == tuple(made)


def test_only_the_commonest_reason_is_told_to_its_end() -> None:
    made = failed("a: 1 N; in the way: x", "a: 2 N; in the way: y", "b; in the way: z")
    assert "2 x a: 1 N; in the way: x; 1 x b. " in str(nothing_found("way", made, "Try"))
