"""The lines of a hand's description as a page lists them: value, reason, and the part they name.

The reasons are those of ``planner.describe``, or the comments of a ``hand.toml``, which stand in
the same places.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from planner.describe.proposal import Reason
from planner.hands.arm import read_mount
from planner.hands.description_toml import is_pair, read_description
from planner.hands.hand import Hand

__all__ = ["DescribedLine", "comments_of", "described_lines", "named_joints", "reasons_by_key"]

BASE = -1
"""Number of the base where joints are listed."""


@dataclass(frozen=True, kw_only=True)
class DescribedLine:
    """One line of a description.

    Attributes:
        key: "palm_body", "fingers.index.pad".
        value: The choice, in words.
        why: The reason; "" where none is known.
        joints: Numbers of the joints that carry what it names; -1 for the base.
        pads: Whether it is about the pads of these joints alone.
        posture: The posture that it describes, "" for none.
    """

    key: str
    value: str
    why: str = ""
    joints: tuple[int, ...] = ()
    pads: bool = False
    posture: str = ""


def described_lines(hand: Hand, reasons: Mapping[str, str]) -> tuple[DescribedLine, ...]:
    """All lines of a hand's description, in its order.

    Args:
        hand: The hand.
        reasons: Key of a line -> its reason.
    """
    return tuple(
        DescribedLine(key=key, why=reasons.get(key, ""), **rest) for key, rest in _lines(hand)
    )


def reasons_by_key(reasons: tuple[Reason, ...]) -> dict[str, str]:
    """The reasons of a proposal by the key of their line."""
    return {reason.key: reason.why for reason in reasons}


def comments_of(path: Path) -> dict[str, str]:
    """Comments of the ``hand.toml`` with the fingers of a hand, by the key of the line below them.

    Raises:
        HandError: The file is damaged.
    """
    if is_pair(path):
        return {}  # the two descriptions have theirs
    mount = read_mount(path)
    described = read_description(path if mount is None else mount.hand_path)
    return _comments(described.described_in.read_text(encoding="utf-8"))


def named_joints(hand: Hand, text: str) -> tuple[int, ...]:
    """Numbers of the joints that a sentence names: by their name, a finger's or a geometry's."""
    words = set(re.findall(r"[\w:.\-/]+", text)) | set(re.findall(r"\w+", text))
    found = {k for k, name in enumerate(hand.joint_names) if name in words}
    for finger in hand.fingers.values():
        if finger.name in words:
            found |= {int(k) for k in finger.q_index}
    found |= {g.joint_id - 1 for g in hand.geometries if g.name in words or g.body in words}
    return tuple(sorted(found))


def _lines(hand: Hand) -> Iterator[tuple[str, dict[str, Any]]]:
    d = hand.description
    yield "base_body", {"value": d.base_body, "joints": _of_body(hand, d.base_body)}
    yield "palm_body", {"value": d.palm_body, "joints": _of_body(hand, d.palm_body)}
    normal = ", ".join(f"{v:.3g}" for v in d.palm_normal)
    yield "palm_normal", {"value": f"[{normal}]", "joints": _of_body(hand, d.palm_body)}
    if d.wrist_joints:
        joints = tuple(int(k) for k in hand.wrist_index)
        yield "wrist_joints", {"value": ", ".join(d.wrist_joints), "joints": joints}
    chosen = hand.choose_fingers()
    joints = tuple(int(k) for f in chosen for k in f.q_index)
    yield "default_fingers", {"value": ", ".join(f.name for f in chosen), "joints": joints}
    for table in ("repair", "joint_defaults"):
        values = getattr(d, table).model_dump()
        for key, value in values.items():
            if value not in (None, False, (), []):
                yield f"{table}.{key}", {"value": _said(value)}
    if d.actuators:
        driven = [j for a in d.actuators for j in (a.joints or (a.tendon,))]
        yield "actuators", {"value": f"servos for {', '.join(driven)}"}
    for finger in hand.fingers.values():
        key, own = f"fingers.{finger.name}", tuple(int(k) for k in finger.q_index)
        pad, tip = finger.pad, (finger.pad.joint_id - 1,)
        yield f"{key}.name", {"value": finger.name, "joints": own}
        yield f"{key}.joints", {"value": ", ".join(finger.joints), "joints": own}
        yield f"{key}.tip", {"value": finger.tip_frame, "joints": tip}
        size = f"{pad.geom}, radius {1e3 * pad.radius:.1f} mm"
        yield f"{key}.pad", {"value": size, "joints": tip, "pads": True}
    for coupling in hand.couplings:
        row = [(int(k), float(c)) for k, c in enumerate(coupling.row) if c]
        terms = " ".join(f"{c:+.4g} {hand.joint_names[k]}" for k, c in row)
        kind = "stop" if coupling.one_sided else "equality"
        yield (
            f"couplings.{coupling.name}",
            {
                "value": f"{terms} = {coupling.value:.4g} ({kind})",
                "joints": tuple(k for k, _ in row),
            },
        )
    for name, posture in d.postures.items():
        yield f"postures.{name}", {"value": f"{len(posture)} joints", "posture": name}


def _of_body(hand: Hand, body: str) -> tuple[int, ...]:
    model = hand.pin_model
    if not model.existBodyName(body):
        return (BASE,)
    return (int(model.frames[model.getBodyId(body)].parentJoint) - 1,)


def _said(value: Any) -> str:
    if isinstance(value, tuple | list):
        return ", ".join(_said(v) for v in value)
    return f"{value:.4g}" if isinstance(value, float) else str(value)


_HEADER = re.compile(r"\[+\s*([\w.\"'-]+)\s*\]+")
_ENTRY = re.compile(r"([\w\"'-]+)\s*=\s*(.*)")


def _comments(text: str) -> dict[str, str]:
    """Comments of a description by key; what stands above a table belongs to its first line."""
    found: dict[str, list[str]] = {}
    waiting: list[str] = []
    table = entry = ""
    for raw in text.splitlines():
        line = raw.strip()
        if line.startswith("#"):
            waiting.append(line.lstrip("# "))
            continue
        header, pair = _HEADER.fullmatch(line), _ENTRY.match(line)
        if header:
            table = header[1].replace('"', "")
            if line.startswith("[["):
                entry = ""
            continue
        if not pair:
            if not line and not table:  # a heading of the file, about no line
                waiting.clear()
            continue
        if pair[1] == "name" and table in ("fingers", "couplings"):
            entry = f"{table}.{pair[2].strip().strip(chr(34))}"
        if waiting:
            found.setdefault(_key(table, entry, pair[1]), []).extend(waiting)
            waiting.clear()
    return {key: " ".join(lines) for key, lines in found.items()}


def _key(table: str, entry: str, name: str) -> str:
    """The key of a line as ``planner.describe`` calls it."""
    if table.startswith("fingers."):
        return f"{entry}.{table.removeprefix('fingers.')}"
    if table == "couplings":
        return entry
    if table == "fingers":
        return f"{entry}.tip" if name == "tip_site" else f"{entry}.{name}"
    if table.startswith("postures.") or table == "actuators":
        return table
    return f"{table}.{name}" if table else name
