"""Pads and postures of a hand, judged: where it touches, and with what force."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planner.describe.fingertips import ConvexLink, cone_directions
from planner.describe.overlaps import TOUCHING
from planner.describe.postures import PostureSolver
from planner.describe.proposal import Findings, PadRow, PostureRow
from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.joints.description import TaxelDescription
from planner.kinematics import HandState
from planner.spatial import FloatArray

LEAST_PRESS = 1.5
"""Force (N) that a pad should reach in the pinch posture: the share of each finger in a default
grasp of 100 g."""

MOST_PRESS = 100.0
"""Largest pressing force (N) that is considered."""

LEAST_GAP, LEAST_OPENING = 0.01, 0.03
"""Least free width (m) between the pads: in pinch, and in open for household objects."""

MOVED = 1e-4
"""Change of a joint (rad, m) above which a posture counts as moved onto the couplings."""

ROUND_TOL = 2e-3
"""How far (m) a pad's geom may stand out before its sphere within the cone without a finding."""


def check_pads(hand: Hand, findings: Findings) -> tuple[PadRow, ...]:
    """Every pad against its geom, and whether its finger can press; faults are noted."""
    solids = {g.name: ConvexLink(g) for g in hand.geometries}
    taking_part = {f.name for f in hand.choose_fingers()}
    joint = {g.name: g.joint_id for g in hand.geometries}
    presses = _presses(hand)
    described = {f.name: f.pad for f in hand.description.fingers}
    out = []
    for finger in hand.fingers.values():
        pad = finger.pad
        solid = solids[pad.geom]
        directions = cone_directions(pad.axis, pad.half_angle)
        sphere = directions @ pad.center + pad.radius
        others = [s for n, s in solids.items() if joint[n] == pad.joint_id and n != pad.geom]
        beside = max((float(s.support(pad.axis[None])[0]) for s in others), default=-np.inf)
        own = float(solid.support(pad.axis[None])[0])
        row = PadRow(
            finger=finger.name,
            geom=pad.geom,
            kind=solid.kind,
            radius=pad.radius,
            half_angle_deg=float(np.rad2deg(pad.half_angle)),
            depth_error=solid.depth(pad.center) - pad.radius,
            stands_out=float((solid.support(directions) - sphere).max()),
            hidden=max(beside - own, 0.0),
            taxels=_array(described[finger.name].taxels),
            presses=presses.get(finger.name),
        )
        out.append(row)
        if row.hidden > TOUCHING + 1e-4:
            findings.warning(
                f"another geom of its link stands {1e3 * row.hidden:.2f} mm out before "
                f"the pad of {finger.name}",
                "put the pad on the outermost geom, or name the other one in "
                "drop_collision under [repair]",
            )
        if row.stands_out > ROUND_TOL:
            findings.warning(
                f"the pad of {finger.name} is not round: {pad.geom} stands up to "
                f"{1e3 * row.stands_out:.1f} mm out before its sphere",
                "make half_angle_deg smaller, or give the tip a sphere or capsule",
            )
        if row.presses is None:
            if finger.name in taking_part and presses:
                findings.error(
                    f"the pressing force of {finger.name} is unknown",
                    "pads of the pinch posture must lie apart, and every actuator "
                    "needs finite forces",
                )
        elif row.presses < LEAST_PRESS:
            findings.add(
                "error" if row.presses <= 0 else "warning",
                f"in the pinch posture {finger.name} presses with {row.presses:.2f} N at most",
                "give its actuators more force, wider control ranges, or the "
                "posture joints further from the ends of their ranges",
            )
    return tuple(out)


def _array(taxels: TaxelDescription | None) -> str:
    """An array in a few words; "" without one."""
    if taxels is None:
        return ""
    dead = f", {len(taxels.dead)} dead" if taxels.dead else ""
    return f"{taxels.rows} x {taxels.columns}, {1e3 * taxels.spacing:g} mm apart{dead}"


def _presses(hand: Hand) -> dict[str, float]:
    """Force with which each default finger can press towards the others in the pinch posture.

    Empty without that posture; a finger whose force is not a number is left out.
    """
    if "pinch" not in hand.description.postures:
        return {}
    q = hand.posture("pinch")
    state = HandState(hand, q)
    out = {}
    for finger, look in zip(hand.choose_fingers(), _looks(hand, state), strict=True):
        jacobian = state.point_jacobian(finger.pad.joint_id, state.pad_center(finger))
        torque = np.asarray(jacobian[:3].T @ look)
        if np.isfinite(torque).all() and (np.abs(torque) > 0).any():
            out[finger.name] = _largest_press(hand, q, torque)
    return out


def _largest_press(hand: Hand, q: FloatArray, torque: FloatArray) -> float:
    """Largest factor up to ``MOST_PRESS`` on a torque (nq,) that the actuators make, by halving."""
    limits = hand.actuation.force_limits(q)

    def makes(factor: float) -> bool:
        force, _ = hand.actuation.split_torque(q, factor * torque)
        inside = (force >= limits[:, 0] - 1e-9) & (force <= limits[:, 1] + 1e-9)
        acting = np.abs(hand.actuation.moment @ torque) > 1e-12
        return bool(inside[acting].all())

    low, high = 0.0, MOST_PRESS
    if makes(high):
        return high
    for _ in range(30):
        middle = (low + high) / 2
        low, high = (middle, high) if makes(middle) else (low, middle)
    return low


def _looks(hand: Hand, state: HandState) -> list[FloatArray]:
    """Unit vectors: the opposer towards the middle of the others, and those back."""
    fingers = hand.choose_fingers()
    centers = np.array([state.pad_center(f) for f in fingers])
    opposer = _opposer(fingers, state)
    others = np.delete(centers, opposer, axis=0).mean(axis=0)
    way = others - centers[opposer]
    way = way / max(float(np.linalg.norm(way)), 1e-9)
    return [way if i == opposer else -way for i in range(len(fingers))]


def _opposer(fingers: Sequence[Finger], state: HandState) -> int:
    axes = np.array([state.pad_axis(f) for f in fingers])
    return int(np.argmin(axes @ axes.sum(axis=0)))


def check_postures(
    hand: Hand, fingers: Sequence[Finger], findings: Findings
) -> tuple[PostureRow, ...]:
    """Every posture: free width, how pads face each other, overlaps; faults are noted."""
    missing = [name for name in ("pinch", "open") if name not in hand.description.postures]
    for name in missing:
        findings.error(
            f"there is no posture {name!r}",
            f"add a [postures.{name}] table; opposable hands --describe proposes one",
        )
    if len(fingers) < 2:
        findings.error("fewer than two fingers take part", "name two or more in default_fingers")
        return ()
    if len(fingers) == 2:
        findings.error(
            "two fingers take part: a gripper, whose point contacts cannot close a grasp, "
            "so that opposable run refuses it",
            "name a third finger in default_fingers if the hand has one; a gripper "
            "is planned from Python alone, with soft contacts: GraspTask.create(hand, object, "
            'contact_model="soft", mu_torsion=...)',
        )
    out = []
    solver = PostureSolver(hand, fingers)
    for name in hand.description.postures:
        q = hand.posture(name)
        _check_moved(hand, name, q, findings)
        state = HandState(hand, q)
        centers = np.array([state.pad_center(f) for f in fingers])
        opposer = _opposer(fingers, state)
        looks = _looks(hand, state)
        width = float(
            np.linalg.norm(np.delete(centers, opposer, axis=0).mean(axis=0) - centers[opposer])
        )
        radii = np.array([f.pad.radius for f in fingers])
        cosines = [float(state.pad_axis(f) @ w) for f, w in zip(fingers, looks, strict=True)]
        out.append(
            PostureRow(
                name=name,
                gap=width - radii[opposer] - float(np.delete(radii, opposer).mean()),
                facing_deg=tuple(float(np.rad2deg(np.arccos(np.clip(c, -1, 1)))) for c in cosines),
                clearance=solver.clearance(q),
            )
        )
    _judge_postures({r.name: r for r in out}, findings)
    return tuple(out)


def _check_moved(hand: Hand, name: str, q: FloatArray, findings: Findings) -> None:
    """Note a posture that was moved onto the couplings, by how much, and the corrected lines."""
    moved = np.abs(q - hand.described_posture(name))
    changed = np.flatnonzero(moved > MOVED)
    if changed.size:
        lines = ", ".join(f"{hand.joint_names[k]} = {q[k]:.6g}" for k in changed)
        findings.note(
            f"posture {name!r} violates couplings and is taken as the nearest one that "
            f"keeps them, up to {moved.max():.3f} rad (m) away",
            f"nothing; or write under [postures.{name}]: {lines}",
        )


def _judge_postures(rows: dict[str, PostureRow], findings: Findings) -> None:
    for name in ("pinch", "open"):
        row = rows.get(name)
        if row is None:
            continue
        if max(row.facing_deg) > 90.0:
            findings.error(
                f"in posture {name!r} a pad faces {max(row.facing_deg):.0f} degrees away "
                "from the pads opposite",
                "turn the pad's axis to where the finger touches, or change the "
                "posture so that pads look at each other",
            )
        if row.clearance < TOUCHING:
            findings.warning(
                f"in posture {name!r} the hand overlaps itself by {-1e3 * row.clearance:.2f} mm",
                "open the posture a little, or exclude the pair under [repair] if "
                "it always overlaps",
            )
    pinch, wide = rows.get("pinch"), rows.get("open")
    if pinch and pinch.gap < LEAST_GAP:
        findings.warning(
            f"the pinch posture leaves {1e3 * pinch.gap:.0f} mm between the pads",
            "open it to some 40 mm: starts lie between pinch and open",
        )
    if wide and wide.gap < LEAST_OPENING:
        findings.warning(
            f"the open posture leaves {1e3 * wide.gap:.0f} mm between the pads",
            "open it as wide as the hand can",
        )
