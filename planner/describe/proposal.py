"""A proposal: a description, a reason for each guess, and open questions; and how it is written.

Floats are written with every digit: reading them back gives the same hand.

``CheckReport``: the findings of ``check_hand``, as plain data. Each finding says what to do.
"error" forbids planning, "warning" costs grasps or realism, "note" is worth knowing.
"""

from __future__ import annotations

import json
import os
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from planner.arrays import finite, short_repr
from planner.errors import FileFormatError
from planner.hands.catalog import PACKAGE_SCHEME
from planner.joints.description import HandDescription


@dataclass(frozen=True, kw_only=True)
class Reason:
    """The reason for a line of a description.

    Attributes:
        key: The line: "palm_body", "fingers.index.pad", "postures.pinch".
        value: The choice, in words.
        why: The evidence in the model, and evidence that would change it.
    """

    key: str
    value: str
    why: str


@dataclass(frozen=True, kw_only=True)
class Proposal:
    """A hand description proposed from the structure of a model.

    Attributes:
        description: The description; valid, and as complete as the model allows.
        reasons: One for every guess, in the order of the description.
        open_questions: What the structure leaves open or contradicts, each with a remedy.
    """

    description: HandDescription
    reasons: tuple[Reason, ...]
    open_questions: tuple[str, ...]


@dataclass(frozen=True)
class Notes:
    """Notes taken while a proposal is made.

    Attributes:
        reasons: One per line of the description.
        questions: Open questions.
    """

    reasons: list[Reason] = field(default_factory=list)
    questions: list[str] = field(default_factory=list)

    def because(self, key: str, value: str, why: str) -> None:
        """Note a reason."""
        self.reasons.append(Reason(key=key, value=value, why=why))

    def ask(self, question: str) -> None:
        """Note an open question."""
        self.questions.append(question)


COMMENT_WIDTH = 98
"""Width of a comment, characters."""


def write_description(
    description: HandDescription,
    path: Path,
    *,
    reasons: Sequence[Reason] = (),
    open_questions: Sequence[str] = (),
    overwrite: bool = False,
) -> None:
    """Write a description; a model beside it or below it is named by its relative path.

    Raises:
        FileFormatError: The file exists already, or cannot be written.
    """
    if path.exists() and not overwrite:
        raise FileFormatError(
            f"{path} exists already; name another file, or overwrite it (--force)"
        )
    text = description_text(description, path.parent, reasons, open_questions)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise FileFormatError(f"cannot write {path}: {error.strerror}") from error


def description_text(
    description: HandDescription,
    folder: Path,
    reasons: Sequence[Reason] = (),
    open_questions: Sequence[str] = (),
) -> str:
    """The TOML text of a description that is to lie in ``folder``."""
    because = {r.key: r.why for r in reasons}
    d = description
    lines = list(_comments(f"TO DO: {q}" for q in open_questions))
    if lines:
        lines.append("")
    lines += ["schema = 1", *_line("name", d.name), *_line("model", _model(d.model, folder))]
    for key in ("summary", "source"):
        if getattr(d, key):
            lines += _line(key, getattr(d, key))
    for key in ("base_body", "palm_body", "palm_normal", "wrist_joints", "default_fingers"):
        lines += _line(key, getattr(d, key), because.get(key))
    lines += _line("allowed_contacts", d.allowed_contacts)
    for table in ("repair", "joint_defaults"):
        values = getattr(d, table).model_dump(exclude_defaults=True)
        if values:
            lines += ["", f"[{table}]"]
            for key, value in values.items():
                lines += _line(key, value, because.get(f"{table}.{key}"))
    lines += _comments([because["actuators"]] if "actuators" in because else [], gap=True)
    for actuator in d.actuators:
        lines += ["", "[[actuators]]"]
        values = actuator.model_dump(exclude_defaults=True)
        lines += [text for key, value in values.items() for text in _line(key, value)]
    for finger in d.fingers:
        key = f"fingers.{finger.name}"
        lines += ["", "[[fingers]]"]
        lines += _line("name", finger.name, because.get(f"{key}.name"))
        lines += _line("joints", finger.joints, because.get(f"{key}.joints"))
        tip = because.get(f"{key}.tip")
        if finger.tip is None:
            lines += _line("tip_site", finger.tip_site, tip)
        else:
            lines += ["[fingers.tip]", *_comments([tip] if tip else [])]
            lines += _line("body", finger.tip.body) + _line("position", finger.tip.position)
        lines.append("[fingers.pad]")
        lines += _comments([because[f"{key}.pad"]] if f"{key}.pad" in because else [])
        for key_of_pad, value in finger.pad.model_dump(exclude_none=True).items():
            lines += _line(key_of_pad, value)
    for coupling in d.couplings:
        lines += ["", "[[couplings]]"]
        lines += _line("name", coupling.name, because.get(f"couplings.{coupling.name}"))
        lines += _line("joints", coupling.joints)
        lines += [*_line("value", coupling.value), *_line("kind", coupling.kind)]
    for name, posture in d.postures.items():
        lines += ["", f"[postures.{_key(name)}]"]
        why = because.get(f"postures.{name}")
        lines += _comments([why] if why else [])
        lines += [text for joint, value in posture.items() for text in _line(joint, value)]
    return "\n".join(lines) + "\n"


def write_proposal(proposal: Proposal, path: Path, *, overwrite: bool = False) -> None:
    """Write a proposal's description with its reasons and open questions.

    Raises:
        FileFormatError: The file exists already, or cannot be written.
    """
    write_description(
        proposal.description,
        path,
        reasons=proposal.reasons,
        open_questions=proposal.open_questions,
        overwrite=overwrite,
    )


def _model(model: str, folder: Path) -> str:
    """The model line: relative where the model lies in the folder or below, else as it is."""
    if model.startswith(PACKAGE_SCHEME) or not os.path.isabs(model):
        return model
    inside = Path(os.path.relpath(model, folder.absolute()))
    return model if inside.parts[0] == os.pardir else inside.as_posix()


def _line(key: str, value: Any, why: str | None = None) -> list[str]:
    return [*_comments([why] if why else []), f"{_key(key)} = {_value(value)}"]


def _comments(texts: Iterable[str], *, gap: bool = False) -> list[str]:
    lines = [f"# {line}" for text in texts for line in textwrap.wrap(text, width=COMMENT_WIDTH - 2)]
    return ["", *lines] if gap and lines else lines


def _key(key: str) -> str:
    """A key bare where TOML allows it."""
    bare = key.isascii() and key.replace("_", "").replace("-", "").isalnum()
    return key if bare else _value(key)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, Mapping):
        inner = ", ".join(f"{_key(k)} = {_value(v)}" for k, v in value.items())
        return f"{{ {inner} }}"
    return f"[{', '.join(_value(v) for v in value)}]"


Level = Literal["error", "warning", "note"]


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One finding: its level, the fact, the remedy."""

    level: Level
    what: str
    what_to_do: str


class Findings(list[Finding]):
    """What a check has found, in the order in which it was found."""

    def add(self, level: Level, what: str, what_to_do: str) -> None:
        """Note a finding."""
        self.append(Finding(level=level, what=what, what_to_do=what_to_do))

    def error(self, what: str, what_to_do: str) -> None:
        """Note what forbids planning."""
        self.add("error", what, what_to_do)

    def warning(self, what: str, what_to_do: str) -> None:
        """Note what costs grasps or realism."""
        self.add("warning", what, what_to_do)

    def note(self, what: str, what_to_do: str) -> None:
        """Note a fact that is no fault."""
        self.add("note", what, what_to_do)

    def worst_first(self) -> tuple[Finding, ...]:
        """Errors, then warnings, then notes."""
        return tuple(sorted(self, key=lambda f: ("error", "warning", "note").index(f.level)))


@dataclass(frozen=True, kw_only=True)
class JointRow:
    """A joint: its place in both engines, its range (rad, m), torque mid-range (N m, N).

    Attributes:
        name: Its name.
        belongs_to: Its finger, "wrist", or "".
        q_index: Its number in Pinocchio's q.
        qpos_index: Its number in MuJoCo's qpos.
        lower: Lower end of its range.
        upper: Upper end.
        torque: Least and greatest torque that its actuators make there; infinite if unlimited.
        actuators: Names of the actuators that act on it.
    """

    name: str
    belongs_to: str
    q_index: int
    qpos_index: int
    lower: float
    upper: float
    torque: tuple[float, float]
    actuators: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class WorkspaceRow:
    """Workspace of a tip: corners of its box in the base's frame, m."""

    finger: str
    lower: tuple[float, float, float]
    upper: tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class PadRow:
    """A pad: its sphere against its geom.

    Attributes:
        finger: Name of the finger.
        geom: Its geom.
        kind: Of the geom.
        radius: m.
        half_angle_deg: Of its cone.
        depth_error: Depth of its centre in the geom less its radius, m.
        stands_out: How far the geom stands out before the sphere within the cone, m.
        hidden: How far another geom of the link stands out before both along the axis, m.
        taxels: Its array as ``hand.toml`` has it, for people; "" of a pad without one.
        presses: Force along the pad's look that the actuators make in the pinch posture, N; None
            for a finger that takes no part in it.
    """

    finger: str
    geom: str
    kind: str
    radius: float
    half_angle_deg: float
    depth_error: float
    stands_out: float
    hidden: float
    taxels: str
    presses: float | None


@dataclass(frozen=True, kw_only=True)
class TouchRow:
    """Two geometries that overlap at rest: distance by coal and by MuJoCo, m; whether allowed."""

    first: str
    second: str
    coal: float
    mujoco: float
    collides_in_mujoco: bool


@dataclass(frozen=True, kw_only=True)
class PostureRow:
    """A posture: free width between pads (m), how pads face each other (deg), clearance (m)."""

    name: str
    gap: float
    facing_deg: tuple[float, ...]
    clearance: float


SHARE = 0.35
"""Where the width of an object lies between the widths of the hand's postures pinch and open."""

LEAST, MOST = 0.015, 0.14
"""Smallest and largest width, m."""

LEAST_HEIGHT = 0.06
"""Least height (m) of what stands on the table, so that fingers have room beside it."""


@dataclass(frozen=True, kw_only=True)
class CheckReport:
    """Result of ``check_hand``."""

    hand: str
    joints: tuple[JointRow, ...]
    couplings: tuple[str, ...]
    workspaces: tuple[WorkspaceRow, ...]
    pads: tuple[PadRow, ...]
    touches: tuple[TouchRow, ...]
    postures: tuple[PostureRow, ...]
    kinematics_error: float
    findings: tuple[Finding, ...]

    def __repr__(self) -> str:
        """One line."""
        return short_repr(self)

    def __str__(self) -> str:
        """Whether a hand can be planned with, and how much is to be said about it."""
        ready = "ready to plan" if self.ok else "not ready to plan"
        return f"{self.hand}: {ready}, {len(self.findings)} findings"

    @property
    def ok(self) -> bool:
        """Whether nothing forbids planning."""
        return not any(f.level == "error" for f in self.findings)

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON; infinities are None."""
        return {"ok": self.ok, **finite(asdict(self))}


def fitting_objects(check: CheckReport) -> list[str]:
    """Specifications of objects between the pads' widths, the likeliest first, three of a size."""
    gaps = {row.name: float(row.gap) for row in check.postures}
    pinch = gaps.get("pinch", LEAST)
    width = pinch + SHARE * max(0.0, gaps.get("open", pinch) - pinch)
    width = round(min(max(width, LEAST), MOST), 3)
    found = []
    for scale in (1.0, 0.75, 1.2):
        wide = scale * width
        tall = max(1.5 * wide, LEAST_HEIGHT)
        found += [
            f"cylinder:{wide / 2:.3f}x{tall:.3f}",
            f"sphere:{wide / 2:.3f}",
            f"box:{0.85 * wide:.3f}x{0.85 * wide:.3f}x{tall:.3f}",
        ]
    return found
