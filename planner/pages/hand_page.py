"""``hand_page``: a hand to move by its joints, its description with reasons, the findings.

Each line of the description is listed with its value, its reason, and the part that it names. The
reasons are those of ``planner.describe``, or the comments of a ``hand.toml``, which stand in the
same places.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import trimesh

from planner.arrays import short_names
from planner.describe import CheckReport
from planner.describe.proposal import Reason
from planner.hands.arm import read_mount
from planner.hands.description_toml import is_pair, read_description
from planner.hands.hand import Hand
from planner.joints.couplings import nearest_on_couplings
from planner.kinematics import HandState
from planner.pages.blocks import Block, Command, Facts, Sentence
from planner.pages.page import Page, own_scripts
from planner.pages.scene import IDENTITY_ROW, Actor, Layer, Model, Part, Scene, View, hand_model
from planner.spatial import SE3, FloatArray

__all__ = ["DescribedLine", "comments_of", "described_lines", "named_joints", "reasons_by_key"]


PALM_COLOUR, AXIS_COLOUR = (0.13, 0.55, 0.30, 1.0), (0.95, 0.52, 0.18, 1.0)
"""Colours of the arrows along which the palm and the pads face."""

PALM_ARROW, PAD_ARROW = 0.08, 0.02
"""Lengths of these arrows, m."""


def hand_page(
    hand: Hand,
    *,
    reasons: Mapping[str, str] | None = None,
    questions: Sequence[str] = (),
    check: CheckReport | None = None,
) -> Page:
    """A page with sliders for the joints of a hand, which keep its couplings.

    Args:
        hand: The hand.
        reasons: Key of a line of its description, such as "fingers.index.pad" -> its reason.
        questions: What its description leaves open.
        check: What ``check_hand`` found, if it was asked.
    """
    postures = _postures(hand)
    q = next(iter(postures.values()))
    return Page(
        title=hand.name,
        subtitle=hand.description.summary,
        summary=_summary(hand, check),
        scene=_scene(hand, q),
        data={
            "name": hand.name,
            "sha256": hand.digest,
            "joint_names": list(hand.joint_names),
            "q_lower_rad": hand.q_lower.tolist(),
            "q_upper_rad": hand.q_upper.tolist(),
            "postures_q_rad": {name: list(v) for name, v in postures.items()},
            "fingers": list(hand.fingers),
            "findings": [asdict(f) for f in check.findings] if check is not None else [],
        },
        kind="hand",
        scripts=own_scripts("side.js", "couplings.js", "hand.js", "hand_start.js"),
        extra=_extra(hand, q, postures, reasons or {}, questions, check),
    )


def _postures(hand: Hand) -> dict[str, FloatArray]:
    """Described postures, and zero, each as joints that keep the couplings."""
    found = {name: hand.posture(name) for name in hand.description.postures}
    zero = hand.neutral
    if hand.couplings:
        kept = nearest_on_couplings(zero, hand.couplings, hand.q_lower, hand.q_upper)
        zero = zero if kept is None else kept
    return found | {"zero": zero}


def _scene(hand: Hand, q: FloatArray) -> Scene:
    state, model = HandState(hand, q), hand_model(hand)
    points = np.concatenate(
        [
            np.array([state.joint_pose(p.joint + 1).act(v) for v in _corners(p.vertices)])
            for p in model.parts
            if p.layer == "hand"
        ]
    )
    focus = (points.min(axis=0) + points.max(axis=0)) / 2
    palm = state.T_base_palm.rotation @ hand.palm_normal
    return Scene(
        models={"hand": _with_arrows(hand, model)},
        actors=(Actor(name="hand", model="hand", pose=IDENTITY_ROW, q=q),),
        focus=focus,
        radius=float(np.linalg.norm(points - focus, axis=1).max()),
        views=(_view("palm", palm), _view("back", -palm), _view("start", palm + _aside(palm))),
    )


def _corners(vertices: FloatArray) -> FloatArray:
    """Corners (8, 3) of the box around points."""
    ends = np.array([vertices.min(axis=0), vertices.max(axis=0)])
    choice = np.array(np.meshgrid([0, 1], [0, 1], [0, 1])).reshape(3, -1).T
    return np.column_stack([ends[choice[:, k], k] for k in range(3)])


def _view(name: str, direction: FloatArray) -> View:
    x, y, z = (float(v) for v in direction / np.linalg.norm(direction))
    return View(name=name, direction=(x, y, z))


def _aside(direction: FloatArray) -> FloatArray:
    """A little to the side of a direction and above it, so that depth can be seen."""
    across = np.cross([0.0, 0.0, 1.0], direction)
    if np.linalg.norm(across) < 0.1:
        across = np.array([0.0, 1.0, 0.0])
    aside: FloatArray = 0.7 * across / np.linalg.norm(across) + np.array([0.0, 0.0, 0.35])
    return aside


def _with_arrows(hand: Hand, model: Model) -> Model:
    frame = hand.pin_model.frames[hand.palm_frame_id]
    place: SE3 = frame.placement
    joint = int(frame.parentJoint) - 1
    on_palm = [p.vertices for p in model.parts if p.joint == joint and p.layer == "hand"]
    middle = place.translation
    if on_palm:
        middle = _corners(np.concatenate(on_palm)).mean(axis=0)
    arrows = [
        arrow_part(
            "direction that the palm faces",
            joint=joint,
            layer="pads",
            start=middle,
            direction=place.rotation @ hand.palm_normal,
            length=PALM_ARROW,
            colour=PALM_COLOUR,
        )
    ]
    arrows += [
        arrow_part(
            f"direction that the pad of {f.name} faces",
            joint=f.pad.joint_id - 1,
            layer="pads",
            start=f.pad.center + f.pad.radius * f.pad.axis,
            direction=f.pad.axis,
            length=PAD_ARROW,
            colour=AXIS_COLOUR,
        )
        for f in hand.fingers.values()
    ]
    return replace(model, parts=(*model.parts, *arrows))


def _summary(hand: Hand, check: CheckReport | None) -> tuple[Block, ...]:
    rows = [
        ("fingers", ", ".join(hand.fingers)),
        ("joints", str(hand.nq)),
        ("actuators", str(len(hand.actuation.names))),
        ("couplings", str(len(hand.couplings))),
        ("mass", f"{float(np.sum(hand.mj_model.body_mass)):.3g} kg"),
        ("colliding geometries", str(len(hand.geometries))),
    ]
    blocks: list[Block] = [Facts(rows=tuple(rows))]
    if check is not None:
        counts = {
            k: sum(f.level == k for f in check.findings) for k in ("error", "warning", "note")
        }
        told = ", ".join(f"{n} {k}{'s' * (n != 1)}" for k, n in counts.items() if n)
        verdict = "Nothing forbids planning" if check.ok else "Planning is forbidden"
        blocks.append(Sentence(text=f"{verdict}; hands --check finds {told or 'nothing'}."))
    blocks.append(Command(text=f"opposable plan {hand.reference or hand.name} sphere:0.035"))
    return tuple(blocks)


def _extra(
    hand: Hand,
    q: FloatArray,
    postures: Mapping[str, FloatArray],
    reasons: Mapping[str, str],
    questions: Sequence[str],
    check: CheckReport | None,
) -> dict[str, Any]:
    facts = []
    if check is not None:
        facts.append(f"Pinocchio and MuJoCo agree to {check.kinematics_error:.1g} m")
    return {
        "hand": {
            "q": [float(v) for v in q],
            "postures": {name: [float(v) for v in value] for name, value in postures.items()},
            "groups": _groups(hand),
            "labels": list(short_names(hand.joint_names)[1]),
            "lines": [asdict(line) for line in described_lines(hand, reasons)],
            "questions": list(questions),
            "findings": [
                asdict(f) | {"joints": named_joints(hand, f.what)}
                for f in (check.findings if check is not None else ())
            ],
            "facts": facts,
        }
    }


def _groups(hand: Hand) -> list[dict[str, Any]]:
    """Joints under a heading: the arm, the wrist, each finger, and the rest."""
    groups = [("arm", hand.arm_index), ("wrist", hand.wrist_index)]
    groups += [(f.name, f.q_index) for f in hand.fingers.values()]
    taken = {int(k) for _, index in groups for k in index}
    groups.append(("other joints", np.array([k for k in range(hand.nq) if k not in taken], int)))
    return [{"name": n, "joints": [int(k) for k in index]} for n, index in groups if len(index)]


HEAD, SLIMNESS = 0.35, 0.035
"""Length of the head and radius of the shaft over the arrow's length (-)."""

SIDES = 16


def arrow_part(
    name: str,
    *,
    joint: int,
    layer: Layer,
    start: FloatArray,
    direction: FloatArray,
    length: float,
    colour: tuple[float, float, float, float],
) -> Part:
    """An arrow in a joint's frame.

    Args:
        name: What is said where it is pointed at.
        joint: Number of the joint that carries it; -1 for the base.
        layer: What switches it.
        start: Where it begins, (3,), m.
        direction: (3,), unit.
        length: m.
        colour: Red, green, blue, opacity.
    """
    shaft = trimesh.creation.cylinder(
        SLIMNESS * length, segment=[[0, 0, 0], [0, 0, (1 - HEAD) * length]], sections=SIDES
    )
    head = trimesh.creation.cone(3 * SLIMNESS * length, HEAD * length, sections=SIDES)
    head.apply_translation([0, 0, (1 - HEAD) * length])
    solid = trimesh.util.concatenate([shaft, head])
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), np.array(direction))
    return Part(
        name=name,
        joint=joint,
        layer=layer,
        vertices=np.asarray(solid.vertices) @ turn.toRotationMatrix().T + np.asarray(start),
        triangles=np.asarray(solid.faces, np.int64),
        colour=colour,
    )


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
