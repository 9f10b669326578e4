"""What ``run``, ``plan`` and ``batch`` are asked for: the same options make the same task."""

from __future__ import annotations

from typing import Any

from sim.cli.common import load_of, names

__all__ = ["task_of_options"]


def task_of_options(
    hand: Any,
    object: str,
    *,
    fingers: str | None,
    mu: float,
    mass: float | None,
    density: float | None,
    repair: bool,
    resting: int,
    touch: list[str] | None,
    avoid: list[str] | None,
    expect_load: str | None,
) -> Any:
    """The task that the command line describes.

    Args:
        hand: A ``Hand``, its name, or the path of its description.
        object: As ``planner.objects.parse_object`` takes it.
        fingers: Names with commas between them; None to leave the choice to the search.
        mu: Sliding friction that planning relies on (-).
        mass: kg.
        density: kg/m3, instead of the mass.
        repair: Whether to mend a mesh that does not bound a solid.
        resting: Which of its stable poses the object stands in.
        touch: Regions where fingers may touch.
        avoid: Regions where they must not.
        expect_load: Force and torque that the grip is sized for; None for none.

    Raises:
        PlannerError: An unknown name, or something that cannot be.
    """
    from planner.objects import parse_object
    from planner.task import GraspTask

    item = parse_object(
        object, mass=mass, density=density, repair=repair, touch=_touch_region(touch, avoid)
    )
    return GraspTask.create(
        hand,
        item,
        T_world_object=item.resting_pose(index=resting),
        mu=mu,
        fingers=None if fingers is None else names(fingers),
        expected_load=load_of(expect_load),
    )


def _touch_region(touch: list[str] | None, avoid: list[str] | None) -> Any:
    """Regions as the options give them; None for none."""
    from planner.regions import TouchRegion, parse_region

    if not touch and not avoid:
        return None
    return TouchRegion(
        allowed=tuple(parse_region(text) for text in touch or ()),
        forbidden=tuple(parse_region(text) for text in avoid or ()),
    )
