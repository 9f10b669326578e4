"""Palm and fingers of a hand as lines of its description: their bodies, names and places."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planner.bridge.structure import ModelStructure
from planner.describe.fingertips import Fingertip, Skeleton, fingertip_of
from planner.describe.pads import FIT_TOL, PadFit, fit_pad
from planner.describe.proposal import Notes
from planner.describe.tree import Branch, HandTree
from planner.errors import HandError
from planner.joints.description import FingerDescription, PadDescription, TipDescription
from planner.spatial import FloatArray

TIP_BELOW, TIP_BESIDE = 0.015, 0.006
"""How far (m) before the end of a finger, and beside its bone, a site may be to be its tip."""

SNAP = np.deg2rad(15.0)
"""A palm normal nearer than this (rad) to an axis of the palm's frame is that axis."""

GRIPPER = -0.85
"""Cosine between the opposer's closing axis and that of the others below which the fingers close
against each other and not against the palm."""

GRIPPER_FINGERS = 2
"""Fingers of a gripper: too few for a grasp with point contacts."""

MOST_FINGERS = 4
"""Fingers that take part in a grasp unless the task says otherwise: the opposer and three more."""


def find_fingers(
    skeleton: Skeleton, tree: HandTree, what: str, notes: Notes
) -> list[tuple[Branch, Fingertip, PadFit]]:
    """The branches that end in something that can touch, with tip and pad."""
    first = [fingertip_of(skeleton, b, None) for b in tree.branches]
    poses = skeleton.place(skeleton.neutral)
    ends = {i: poses[t.joint_id].act(t.end) for i, t in enumerate(first) if t is not None}
    out = []
    for i, branch in enumerate(tree.branches):
        others = [e for k, e in ends.items() if k != i]
        middle = np.mean(others, axis=0) if others else None
        tip = fingertip_of(skeleton, branch, middle)
        pad = None if tip is None else fit_pad(tip, skeleton.solids[tip.joint_id])
        joints = [skeleton.structure.joints[j].name for j in branch.joints]
        if tip is None or pad is None:
            notes.ask(
                f"the chain {', '.join(joints)} ends in nothing solid that collides: it is no "
                "finger; give its last body a colliding geom if it is one"
            )
            continue
        if not tip.certain:
            notes.ask(
                f"the range of joint {skeleton.structure.joints[tip.flexion_joint].name} does not "
                "tell which way it closes: the side of the other fingers is taken; turn the pad's "
                "axis if it is the other"
            )
        aside = [skeleton.structure.joints[j].name for j in branch.side_joints]
        if aside:
            notes.ask(f"the finger of {joints[0]} branches: {', '.join(aside)} are left aside")
        out.append((branch, tip, pad))
    if len(out) < 2:
        raise HandError(
            f"{what} has {len(out)} fingers whose last link can touch anything; two are "
            "needed: give the last bodies of the fingers colliding geoms"
        )
    return out


def describe_finger(
    skeleton: Skeleton, name: str, branch: Branch, tip: Fingertip, pad: PadFit, notes: Notes
) -> FingerDescription:
    """A finger's lines: joints, tip and pad, in the frames of the model's bodies."""
    structure, pin_model = skeleton.structure, skeleton.pin_model
    joints = tuple(structure.joints[j].name for j in branch.joints)
    notes.because(
        f"fingers.{name}.joints", ", ".join(joints), "a chain of joints that leaves the palm"
    )
    site, position = _tip_site(skeleton, tip)
    body = next(s.body for s in skeleton.solids[tip.joint_id] if s.name == pad.geom)
    placement = pin_model.frames[pin_model.getBodyId(body)].placement
    described_tip = None
    if site:
        notes.because(f"fingers.{name}.tip", site, f"the site nearest to the end, {position}")
    else:
        is_ball = pad.exact and np.linalg.norm(tip.end - pad.center) < 2 * pad.radius
        at = pad.center if is_ball else tip.end
        described_tip = TipDescription(body=body, position=_vector(placement.actInv(at)))
        notes.because(
            f"fingers.{name}.tip",
            "the middle of the round end" if is_ball else "the furthest point of the last link",
            "no site is near the end of the last link",
        )
    closing = structure.joints[tip.flexion_joint].name
    kind = next(s.kind for s in skeleton.solids[tip.joint_id] if s.name == pad.geom)
    fit = (
        f"exactly a part of the {kind}"
        if pad.exact
        else f"a flat face stands for it, {1e3 * pad.error:.1f} mm off at the cone's edge"
        if pad.flat
        else f"the {kind} is at most {1e3 * pad.error:.1f} mm outside it within the cone"
    )
    notes.because(
        f"fingers.{name}.pad",
        pad.geom,
        f"the end of the last link; it faces {np.rad2deg(pad.tilt):.0f} degrees from the way "
        f"that {closing} closes towards the bone; {fit}",
    )
    if not pad.exact and pad.error > FIT_TOL:
        notes.ask(
            f"the tip of {name} is not round: a sphere of {1e3 * pad.radius:.1f} mm stands for "
            f"{pad.geom} up to {1e3 * pad.error:.1f} mm; a sphere or capsule as its collision "
            "geom would plan better"
        )
    return FingerDescription(
        name=name,
        joints=joints,
        tip_site=site,
        tip=described_tip,
        pad=PadDescription(
            geom=pad.geom,
            center=_vector(placement.actInv(pad.center)),
            radius=float(f"{pad.radius:.6g}"),
            axis=_vector(placement.rotation.T @ pad.axis),
            half_angle_deg=round(float(np.rad2deg(pad.half_angle)), 1),
        ),
    )


def palm_body(structure: ModelStructure, tree: HandTree, notes: Notes) -> str:
    """Of the bodies of the palm's link the one that most fingers are on, else the heaviest."""
    candidates = [b for b in structure.bodies_of(tree.palm) if b]
    moving = [b.parent for i, b in enumerate(structure.bodies) if b.link == i]
    chosen = max(candidates, key=lambda b: (moving.count(b), structure.bodies[b].mass))
    if 2 * moving.count(chosen) <= len(tree.branches):
        chosen = max(candidates, key=lambda b: structure.bodies[b].mass)
    name = structure.bodies[chosen].name
    notes.because(
        "palm_body",
        name,
        f"{len(tree.branches)} chains of joints start from it"
        + (" or from bodies fixed to it" if len(candidates) > 1 else ""),
    )
    return name


def palm_normal(
    skeleton: Skeleton, palm: str, tips: Sequence[Fingertip], opposer: int, notes: Notes
) -> tuple[float, float, float]:
    """The direction that the palm faces, in the palm's frame: where the fingers close to."""
    poses = skeleton.place(skeleton.neutral)
    frame = skeleton.pin_model.frames[skeleton.pin_model.getBodyId(palm)]
    to_palm = (poses[frame.parentJoint] * frame.placement).rotation.T
    ways = np.array([poses[t.joint_id].rotation @ t.flexion for t in tips])
    axes = np.array([poses[t.joint_id].rotation @ np.cross(t.bone, t.flexion) for t in tips])
    rest = np.arange(len(tips)) != opposer
    others = axes[rest].mean(axis=0)
    cosine = float(axes[opposer] @ others / max(np.linalg.norm(others), 1e-9))
    if cosine < GRIPPER:
        roots = [poses[_root_joint(skeleton, t.joint_id)].translation for t in tips]
        ends = [poses[t.joint_id].act(t.end) for t in tips]
        way = np.mean(ends, axis=0) - np.mean(roots, axis=0)
        way /= max(float(np.linalg.norm(way)), 1e-9)
        why = "the fingers close against each other and point there"
    else:
        way, why = ways[rest].mean(axis=0), "the fingers beside the thumb close to that side"
    if np.linalg.norm(way) < 0.3:
        way, why = ways.mean(axis=0), "the fingers close to that side, if to any"
        notes.ask("it is not clear which way the palm faces; check palm_normal")
    local = to_palm @ (way / np.linalg.norm(way))
    k = int(np.argmax(np.abs(local)))
    if abs(local[k]) > np.cos(SNAP):
        local = np.sign(local[k]) * np.eye(3)[k]
    notes.because("palm_normal", f"{(np.round(local, 2) + 0.0).tolist()} in the palm's frame", why)
    return _vector(local)


def default_fingers(
    skeleton: Skeleton,
    names: Sequence[str],
    tips: Sequence[Fingertip],
    opposer: int,
    notes: Notes,
) -> tuple[str, ...]:
    """The fingers that take part in a grasp: the opposer first, then its nearest."""
    poses = skeleton.place(skeleton.neutral)
    ends = np.array([poses[t.joint_id].act(t.end) for t in tips])
    away = np.linalg.norm(ends - ends[opposer], axis=1)
    rest = sorted((i for i in range(len(names)) if i != opposer), key=lambda i: away[i])
    kept = sorted(rest[: MOST_FINGERS - 1])
    chosen = (names[opposer], *(names[i] for i in kept))
    why = f"{names[opposer]} opposes the others"
    if len(names) > MOST_FINGERS:
        why += f"; of those the {MOST_FINGERS - 1} nearest to it"
    notes.because("default_fingers", ", ".join(chosen), why)
    if len(chosen) == GRIPPER_FINGERS:
        notes.ask(
            f"this is a gripper of two fingers, {' and '.join(chosen)}: point contacts of two "
            "fingers close no grasp, so opposable run refuses it; plan from Python with "
            'contact_model="soft"'
        )
    return chosen


def find_opposer(skeleton: Skeleton, names: Sequence[str], tips: Sequence[Fingertip]) -> int:
    """The finger called thumb, else the one whose closing axis is least like the others'."""
    if "thumb" in names:
        return names.index("thumb")
    poses = skeleton.place(skeleton.neutral)
    axes = np.array([poses[t.joint_id].rotation @ np.cross(t.bone, t.flexion) for t in tips])
    return int(np.argmin(axes @ axes.sum(axis=0)))


def _root_joint(skeleton: Skeleton, joint_id: int) -> int:
    """The first joint of the chain that a Pinocchio joint ends, as far as it does not branch."""
    parents = list(skeleton.pin_model.parents)
    count = {p: parents.count(p) for p in parents}
    while parents[joint_id] and count[parents[joint_id]] == 1:
        joint_id = parents[joint_id]
    return joint_id


def _tip_site(skeleton: Skeleton, tip: Fingertip) -> tuple[str, str]:
    """The site furthest along the bone that is near a finger's end, and where it is; or "", ""."""
    best, reach = "", -np.inf
    for frame in skeleton.pin_model.frames:
        if frame.parentJoint != tip.joint_id or str(frame.type) != "OP_FRAME":
            continue
        offset = np.array(frame.placement.translation) - tip.end
        along = float(offset @ tip.bone)
        beside = float(np.linalg.norm(offset - along * tip.bone))
        if -TIP_BELOW <= along <= TIP_BELOW and beside <= TIP_BESIDE and along > reach:
            best, reach = frame.name, along
    return best, f"{-1e3 * reach:.0f} mm before it" if best else ""


def _vector(v: FloatArray) -> tuple[float, float, float]:
    """Six decimals: a micrometre, and a microradian."""
    x, y, z = (round(float(c), 6) + 0.0 for c in v)
    return (x, y, z)
