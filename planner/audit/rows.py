"""What is said of one grasp: a result per stage, with its number and its reason."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from planner.arrays import finite


@dataclass(frozen=True, kw_only=True)
class Stage:
    """A stage of the verdict.

    Attributes:
        name: Its name.
        number: What its number is, with unit, as the name of a column.
        asks: What it asks, for people.
    """

    name: str
    number: str
    asks: str


STAGES: tuple[Stage, ...] = (
    Stage(name="joints", number="beyond_rad", asks="joint limits and couplings are kept"),
    Stage(name="gap", number="tolerance_mm", asks="enough pads touch the surface"),
    Stage(name="pad", number="angle_deg", asks="they touch on the pad, off edges, where allowed"),
    Stage(name="penetration", number="depth_mm", asks="nothing else penetrates"),
    Stage(name="closure", number="min_weight", asks="the contacts close"),
    Stage(name="forces", number="share", asks="forces hold the weight within torque limits"),
    Stage(name="approach", number="opening_mm", asks="a straight way in is free"),
    Stage(name="held", number="moved_mm", asks="it holds in simulation"),
)
"""All stages in their order; the last two where they are asked for."""


@dataclass(frozen=True, kw_only=True)
class StageResult:
    """What a stage says.

    Attributes:
        passed: Whether it passes; None where an earlier stage leaves nothing to judge.
        number: As ``Stage.number`` says; None where there is none.
        reason: Why not, or why it was not judged; "" if it passes.
    """

    passed: bool | None
    number: float | None = None
    reason: str = ""


@dataclass(frozen=True, kw_only=True)
class AuditRow:
    """The verdict on one grasp.

    Attributes:
        index: Its place in the file.
        name: As ``GivenGrasp.name``.
        source: The file.
        object: The object as the file names it.
        scale: Factor on the object's mesh.
        fingers: Those whose pads are taken for its contacts.
        gaps_mm: Finger -> signed distance of its pad from the surface, mm, of all that may take
            part.
        stages: Name -> result, in the order of ``STAGES``.
    """

    index: int
    name: str
    source: str = ""
    object: str = ""
    scale: float = 1.0
    fingers: tuple[str, ...] = ()
    gaps_mm: Mapping[str, float] = field(default_factory=dict)
    stages: Mapping[str, StageResult]

    def __post_init__(self) -> None:
        """Keep copies that nobody changes."""
        for name in ("gaps_mm", "stages"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    @property
    def passed(self) -> bool:
        """Whether every stage passes."""
        return all(result.passed is True for result in self.stages.values())

    @property
    def first_fault(self) -> str:
        """Name of the first stage that does not pass; "" if all do."""
        return next((n for n, result in self.stages.items() if result.passed is not True), "")

    @property
    def reason(self) -> str:
        """Why it does not pass: every stage that fails with its reason."""
        return "; ".join(
            f"{name}: {result.reason}"
            for name, result in self.stages.items()
            if result.passed is False
        )

    def __reduce__(self) -> tuple[Any, ...]:
        """How it is sent to another process: a read-only mapping cannot be pickled."""
        values = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return _row, ({**values, "gaps_mm": dict(self.gaps_mm), "stages": dict(self.stages)},)

    def to_dict(self) -> dict[str, Any]:
        """Plain data, one value per column; lists are joined by spaces."""
        out: dict[str, Any] = {
            "index": self.index,
            "name": self.name,
            "source": self.source,
            "object": self.object,
            "scale": self.scale,
            "passed": self.passed,
            "first_fault": self.first_fault,
            "fingers": " ".join(self.fingers),
        }
        for stage in STAGES:
            if stage.name in self.stages:
                result = self.stages[stage.name]
                out[stage.name] = result.passed
                out[f"{stage.name}_{stage.number}"] = finite(result.number)
        out["reason"] = self.reason
        out["gaps_mm"] = " ".join(f"{n}={v:.4g}" for n, v in self.gaps_mm.items())
        return out


def _row(values: dict[str, Any]) -> AuditRow:
    return AuditRow(**values)
