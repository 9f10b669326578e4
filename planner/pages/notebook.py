"""What a notebook shows of hands, contacts, plans, motions and datasets: a table and a picture.

``planner.showing.in_notebook`` calls these and keeps what they make. The pictures are by
``planner.pages.painter``; a first call takes less than 0.3 s of CPU with the modules loaded.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

from planner.contacts import ContactSet
from planner.hands.hand import Hand
from planner.kinematics import HandState
from planner.pages.painter import data_uri, paint
from planner.pages.plan_scene import Stage, planned_contacts
from planner.pages.scene import IDENTITY_ROW, Actor, Model, Part, Scene, hand_model
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray, IntArray, pose_from_wxyz
from planner.task import GraspTask

__all__ = [
    "contacts_html",
    "dataset_html",
    "grasp_picture",
    "hand_html",
    "motion_html",
    "notebook_html",
    "plan_html",
    "postures_picture",
]

MOST_ROWS = 16
"""Rows of a table; what is left out is counted."""

HULL_COLOUR = (0.80, 0.86, 0.92, 1.0)
"""Of the triangles between contacts that are on no known object."""

ASIDE = 0.55
"""How far (-) the camera goes aside from the direction that a palm faces."""


def notebook_html(
    title: str,
    columns: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    notes: Iterable[str] = (),
    picture: bytes | None = None,
) -> str:
    """A title, notes and a table beside a picture; every text is escaped.

    Args:
        title: What it is.
        columns: Heads, with units.
        rows: Cells; those beyond ``MOST_ROWS`` are counted.
        notes: Sentences below the title.
        picture: PNG.
    """
    head = "".join(f"<th>{escape(c)}</th>" for c in columns)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(c)}</td>" for c in row) + "</tr>" for row in rows[:MOST_ROWS]
    )
    left = f"<div>and {len(rows) - MOST_ROWS} more</div>" if len(rows) > MOST_ROWS else ""
    image = "" if picture is None else f'<img src="{data_uri(picture)}" alt="{escape(title)}">'
    return (
        '<div style="display:flex;gap:1em;align-items:flex-start;flex-wrap:wrap">'
        f"{image}<div><strong>{escape(title)}</strong>"
        + "".join(f"<div>{escape(note)}</div>" for note in notes)
        + f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{left}</div></div>"
    )


def plan_html(plan: GraspPlan) -> str:
    """A plan: contacts with forces, closure, and hand and object at the grasp."""
    task, closure = plan.task, plan.quality.closure
    at, used = plan.contacts_in_object.positions, plan.contacts.friction_utilisation()
    rows = [
        (
            name,
            ", ".join(f"{1e3 * v:.1f}" for v in at[i]),
            f"{plan.contacts.forces[i, 0]:.2f}",
            f"{100 * used[i]:.0f} %",
        )
        for i, name in enumerate(task.finger_names)
    ]
    return notebook_html(
        f"{task.hand.name} grasps {task.object.shape.spec}",
        ("finger", "contact in object (mm)", "normal force (N)", "friction used"),
        rows,
        notes=(
            f"{1e3 * task.object.mass:.0f} g, mu {task.mu:g}, seed {plan.record.seed}, attempt "
            f"{plan.record.attempt + 1}",
            f"force closure {'yes' if closure.closed else 'no'}, epsilon "
            f"{plan.quality.epsilon:.4f}, min-weight {closure.normalised_min_weight:.3f} (of 1)",
        ),
        picture=grasp_picture(task, plan.T_world_base, plan.q, task.T_world_object, plan.contacts),
    )


def motion_html(motion: Any) -> str:
    """A motion (``planner.motion.MovementPlan``): path, margins, and the grasp it begins with."""
    plan: GraspPlan = motion.grasp
    task, (joint, room, where) = plan.task, motion.joint_room
    rows = [
        ("knots", str(len(motion.knots))),
        ("least normalised min-weight", f"{motion.margin:.3f}"),
        ("least clearance", f"{1e3 * motion.clearance:.2f} mm"),
        (
            "joint nearest to a limit",
            f"{joint}, {100 * room:.1f} % of its range, at {100 * where:.0f} % of the path",
        ),
    ]
    return notebook_html(
        f"{task.hand.name} moves {task.object.shape.spec}",
        ("", ""),
        rows,
        notes=(str(motion.path),),
        picture=grasp_picture(task, plan.T_world_base, plan.q, task.T_world_object, plan.contacts),
    )


def hand_html(hand: Hand) -> str:
    """A hand: fingers with joints, pads and masses, and the palm side of its pinch posture."""
    masses = hand.mj_model.body_mass
    rows = [
        (
            finger.name,
            str(len(finger.q_index)),
            f"{1e3 * finger.pad.radius:.1f}",
            ", ".join(hand.joint_names[int(i)] for i in finger.q_index),
        )
        for finger in hand.fingers.values()
    ]
    return notebook_html(
        hand.name,
        ("finger", "joints", "pad radius (mm)", "names"),
        rows,
        notes=(
            f"{hand.nq} joints, {len(hand.actuation.names)} actuators, "
            f"{len(hand.couplings)} couplings, {float(np.sum(masses)):.2f} kg",
            *([hand.description.summary] if hand.description.summary else []),
        ),
        picture=_hand_picture(hand),
    )


def contacts_html(contacts: ContactSet) -> str:
    """Contacts: positions, normals, friction and forces; the picture has points and normals."""
    rows = [
        (
            name or str(i),
            ", ".join(f"{1e3 * v:.1f}" for v in contacts.positions[i]),
            ", ".join(f"{v:.2f}" for v in contacts.normals[i]),
            f"{contacts.models[i]}, mu {contacts.mu[i]:g}",
            "" if math.isnan(contacts.forces[i, 0]) else f"{contacts.forces[i, 0]:.2f}",
        )
        for i, name in enumerate(contacts.fingers)
    ]
    count = len(contacts)
    return notebook_html(
        f"{count} contact{'s' * (count != 1)}",
        ("finger", "position (mm)", "normal into object", "friction", "normal force (N)"),
        rows,
        picture=_contact_picture(contacts) if count else None,
    )


def dataset_html(grasps: Any) -> str:
    """A batch (``planner.batch.GraspSet``): found per object, and its first found grasp."""
    table = grasps.table(["object", "found", "epsilon", "attempts"]).to_pydict()
    labels, found = np.array(table["object"], dtype=object), np.array(table["found"], dtype=bool)
    attempts = np.array(table["attempts"], dtype=np.float64)
    epsilon = np.array([math.nan if e is None else e for e in table["epsilon"]])
    rows = []
    for label in grasps.labels:
        mine = labels == label
        held = mine & found
        per = f"{attempts[mine].sum() / held.sum():.1f}" if held.any() else "-"
        median = f"{np.median(epsilon[held]):.3f}" if held.any() else "-"
        rows.append((label, f"{held.sum()} of {mine.sum()}", per, median))
    picture = None
    if found.any():
        row = grasps[int(np.flatnonzero(found)[0])]
        task: GraspTask = grasps.task(row["object"])
        position = np.array(row["base_position_object_m"])
        quaternion = np.array(row["base_quaternion_object_wxyz"])
        T_world_base = task.T_world_object * pose_from_wxyz(position, quaternion)
        picture = grasp_picture(
            task, T_world_base, np.array(row["q_rad"]), task.T_world_object, None
        )
    manifest = grasps.manifest
    return notebook_html(
        f"grasps by {manifest.hand}",
        ("object", "found", "attempts per found", "median epsilon"),
        rows,
        notes=(f"{len(grasps)} of {manifest.total} requests in {grasps.folder}",),
        picture=picture,
    )


def grasp_picture(
    task: GraspTask,
    T_world_base: SE3,
    q: FloatArray,
    T_world_object: SE3,
    contacts: ContactSet | None,
) -> bytes:
    """Hand and object where they are, with contacts (world) as marks, as PNG."""
    stage = Stage(task, T_world_base, q, T_world_object, for_painter=True)
    marked = contacts is not None and len(contacts) > 0
    scene = Scene(
        models=stage.models,
        actors=tuple(stage.actors),
        focus=stage.focus,
        radius=stage.radius,
        contacts=(planned_contacts([contacts]),) if contacts is not None and marked else (),
    )
    return paint(scene, stage.views(contacts)[0].direction)


def postures_picture(hand: Hand) -> bytes:
    """Every posture of a hand with its name, those of a candidate in a row, as PNG."""
    names = sorted(hand.description.postures, key=lambda n: (*n.partition("_")[1:], n))
    tiles = [Image.open(io.BytesIO(_hand_picture(hand, hand.posture(n)))) for n in names]
    wide, high = tiles[0].size
    sheet = Image.new("RGB", (2 * wide, -(-len(tiles) // 2) * high), "white")
    for k, (name, tile) in enumerate(zip(names, tiles, strict=True)):
        at = k % 2 * wide, k // 2 * high
        sheet.paste(tile.convert("RGB"), at)
        ImageDraw.Draw(sheet).text((at[0] + 8, at[1] + 6), name, fill="black")
    out = io.BytesIO()
    sheet.save(out, "PNG", optimize=True)
    return out.getvalue()


def _hand_picture(hand: Hand, q: FloatArray | None = None) -> bytes:
    """The palm side of a hand, fingers up: at q (nq,), or in its pinch posture."""
    if q is None:
        q = hand.posture("pinch") if "pinch" in hand.description.postures else hand.neutral
    state = HandState(hand, q)
    palm = state.T_base_palm
    tips = np.array([state.tip_pose(f).translation for f in hand.fingers.values()])
    facing = palm.rotation @ hand.palm_normal
    up = tips.mean(axis=0) - palm.translation
    up = up - (up @ facing) * facing
    if np.linalg.norm(up) < 1e-3:  # the tips are straight before the palm
        up = palm.rotation @ np.roll(hand.palm_normal, 1)
    up /= np.linalg.norm(up)
    points = np.array([*tips, palm.translation])
    focus = (points.min(axis=0) + points.max(axis=0)) / 2
    scene = Scene(
        models={"hand": hand_model(hand, for_painter=True)},
        actors=(Actor(name="hand", model="hand", pose=IDENTITY_ROW, q=q),),
        focus=focus,
        radius=1.5 * float(np.linalg.norm(points - focus, axis=1).max()),
    )
    return paint(scene, facing + ASIDE * np.cross(up, facing) + 0.3 * up, up=up)


def _contact_picture(contacts: ContactSet) -> bytes:
    """Contact points with normals and, among three and more, the triangles between them."""
    points = contacts.positions
    focus = points.mean(axis=0)
    radius = max(1e-3, 1.5 * float(np.linalg.norm(points - focus, axis=1).max()))
    part = Part(
        name="between the contacts",
        layer="object",
        vertices=points,
        triangles=_between(len(points)),
        colour=HULL_COLOUR,
    )
    scene = Scene(
        models={"object": Model(joints=(), parts=(part,))},
        actors=(Actor(name="object", model="object", pose=IDENTITY_ROW),),
        focus=focus,
        radius=radius,
        contacts=(planned_contacts([contacts]),),
    )
    return paint(scene, (0.75, -1.0, 0.62))


def _between(count: int) -> IntArray:
    """Triangles (k, 3) of a fan over points, seen from both sides."""
    fan = np.array([(0, k, k + 1) for k in range(1, count - 1)], dtype=np.int64).reshape(-1, 3)
    both: IntArray = np.concatenate([fan, fan[:, ::-1]])
    return both
