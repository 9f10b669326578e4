"""``propose``: a hand description from the structure of a model alone, with a reason for each line.

The order follows the data: repairs that MuJoCo needs, the base, the tree of fingers, their tips and
pads, what drives them, and last the postures, which are looked for on the hand so described.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from planner.bridge import compile_spec, couplings_from_mujoco, hand_geometries
from planner.bridge.pinocchio_model import body_name, pinocchio_from_mujoco
from planner.bridge.prepare import name_parts, prepare_spec
from planner.bridge.structure import (
    ModelStructure,
    compile_balanced,
    joint_inertia,
    read_spec,
    structure_of,
)
from planner.catalog import FOREIGN_HANDS, find_hand
from planner.describe.drive import (
    Drive,
    PadContact,
    impossible_couplings,
    joint_defaults,
    missing_servos,
    stops_and_springs,
)
from planner.describe.fingertips import Fingertip, Skeleton, fingertip_of
from planner.describe.pads import FIT_TOL, PadFit, fit_pad
from planner.describe.postures import OPEN_RADII, PINCH_RADII, PosturePart, PostureSolver
from planner.describe.proposal import Proposal, Reason
from planner.describe.tree import Branch, HandTree, find_base, finger_names, read_tree
from planner.description import (
    FingerDescription,
    HandDescription,
    PadDescription,
    RepairDescription,
    TipDescription,
)
from planner.errors import HandError
from planner.hand import Hand
from planner.kinematics import HandState
from planner.proximity import DistancePair
from planner.spatial import SE3, FloatArray

__all__ = ["propose"]

NARROW_HINGE, WIDE_HINGE = 0.1, 20.0
"""Widest range (rad) of all hinges below which a file was written in radians and read in degrees,
and above which the reverse."""

TIP_BELOW, TIP_BESIDE = 0.015, 0.006
"""How far (m) before the end of a finger, and beside its bone, a site may be to be its tip."""

SNAP = np.deg2rad(15.0)
"""A palm normal nearer than this (rad) to an axis of the palm's frame is that axis."""

GRIPPER = -0.85
"""Cosine between the opposer's closing axis and that of the others below which the fingers close
against each other and not against the palm."""

MOST_FINGERS = 4
"""Fingers that take part in a grasp unless the task says otherwise: the opposer and three more."""

OVERLAP_SAMPLES = 60
"""Random configurations at which parts are looked at that always overlap."""

ALWAYS = 0.8
"""Share of configurations in which two links must overlap to do so by construction."""

TOUCHING = -5e-5
"""Signed distance (m) below which two parts overlap."""


def propose(model: Any, *, name: str | None = None, base_body: str | None = None) -> Proposal:
    """Propose a hand description from a model.

    Args:
        model: A path, or ``PACKAGE:NAME`` as for ``Hand.load``; a ``mujoco.MjSpec``, or a compiled
            ``mujoco.MjModel``.
        name: What to call the hand; after the model if None.
        base_body: Root of the hand in the model; found if None.

    Raises:
        NotFoundError: The model, or the body, does not exist.
        ModelError: The model cannot be read.
        HandError: Nothing in it is a hand, several things are, or no finger can be described.
    """
    path, line = _located(model)
    what = str(path) if path is not None else "the model"
    return _Proposer(path if path is not None else model, what, line, name, base_body).run()


def _located(model: Any) -> tuple[Path | None, str]:
    """The model's path, None for one in Python, and the ``model`` line of its description."""
    if not isinstance(model, str | Path):
        return None, "model.xml"
    path = find_hand(model)
    if path.suffix == ".toml":
        raise HandError(f"{path} is a description already; give the model that it names")
    source, _, rest = str(model).partition(":")
    known = f"{source.replace('_', '-')}:{rest}"
    if known in FOREIGN_HANDS:
        return path, FOREIGN_HANDS[known]
    return path, str(model) if str(model).startswith("package:") else str(path.absolute())


class _Proposer:
    """One proposal in the making."""

    def __init__(
        self, source: Any, what: str, line: str, name: str | None, base_body: str | None
    ) -> None:
        self.what, self.line = what, line
        self.spec = read_spec(source)
        stem = Path(line).stem if isinstance(source, Path) else (self.spec.modelname or "hand")
        self.name = name or re.sub(r"\W+", "_", stem).strip("_") or "hand"
        self.base_choice = base_body
        self.reasons: list[Reason] = []
        self.questions: list[str] = []

    def run(self) -> Proposal:
        """Everything, in order."""
        repair, base = self._repair_and_base()
        description = HandDescription(
            schema=1,
            name=self.name,
            model=self.line,
            base_body=base,
            palm_body=base,
            palm_normal=(0.0, 0.0, 1.0),
            repair=repair,
        )
        description = self._without_impossible_couplings(description)
        description = self._anatomy(description)
        description = self._without_overlaps(description)
        description = self._postures(description)
        Hand.from_spec(self.spec, description)  # what is proposed loads, or says why not
        return Proposal(
            description=description,
            reasons=tuple(self.reasons),
            open_questions=tuple(self.questions),
        )

    def _because(self, key: str, value: str, why: str) -> None:
        self.reasons.append(Reason(key=key, value=value, why=why))

    def _prepared(self, description: HandDescription) -> Any:
        spec = self.spec.copy()
        prepare_spec(spec, description, self.what)
        return compile_spec(spec, self.what)

    def _repair_and_base(self) -> tuple[RepairDescription, str]:
        """What the file needs to be read rightly, and the root of the hand in it."""
        raw = self.spec.copy()
        name_parts(raw)
        model, balanced = compile_balanced(raw, self.what)
        structure = structure_of(model)
        angle = None
        ranges = [
            j.limits[1] - j.limits[0] for j in structure.joints if j.kind == "hinge" and j.limits
        ]
        if ranges and max(ranges) < NARROW_HINGE and raw.compiler.degree:
            angle = "radian"
            self._because(
                "repair.angle",
                "radian",
                f"read in degrees, no hinge turns more than {np.rad2deg(max(ranges)):.1f} degrees: "
                "the file is written in radians and does not say so",
            )
        elif ranges and max(ranges) > WIDE_HINGE and not raw.compiler.degree:
            angle = "degree"
            self._because(
                "repair.angle",
                "degree",
                f"read in radians, a hinge turns {max(ranges):.0f} rad: the file is in degrees",
            )
        if balanced:
            self._because(
                "repair.balance_inertia",
                "true",
                "MuJoCo refuses inertias of this model that no body can have (A + B < C)",
            )
        base, why, questions = find_base(structure, self.base_choice, self.what)
        self._because("base_body", base, why)
        self.questions += questions
        return RepairDescription(angle=angle, balance_inertia=balanced), base

    def _without_impossible_couplings(self, description: HandDescription) -> HandDescription:
        model = self._prepared(description)
        wrong = impossible_couplings(
            couplings_from_mujoco(model), *_limits(pinocchio_from_mujoco(model))
        )
        if not wrong:
            return description
        self._because(
            "repair.drop_couplings",
            ", ".join(wrong),
            "within the joint ranges these couplings cannot hold, or leave the joints that they "
            "tie no room to move",
        )
        self.questions.append(
            f"the model's couplings {', '.join(wrong)} contradict its joint ranges and are left "
            "out: give the real ones as [[couplings]] with kind = \"equality\""
        )
        repair = description.repair.model_copy(update={"drop_couplings": wrong})
        return description.model_copy(update={"repair": repair})

    def _anatomy(self, description: HandDescription) -> HandDescription:
        """Palm, fingers, pads and drive."""
        model = self._prepared(description)
        structure = structure_of(model)
        if not structure.hinges_and_slides:
            raise HandError(
                f"{self.what} has free or ball joints below {description.base_body!r}; a hand has "
                "hinges and slides: name another base_body (--base)"
            )
        pin_model = pinocchio_from_mujoco(model)
        skeleton = Skeleton(structure, pin_model, hand_geometries(model, pin_model))
        tree = read_tree(structure, description.base_body, self.what)
        fingers = self._fingers(skeleton, tree)
        names = self._names(skeleton, [b for b, _, _ in fingers])
        opposer = _opposer(skeleton, names, [t for _, t, _ in fingers])
        names = self._name_thumb(names, opposer)
        described = tuple(
            self._describe_finger(skeleton, name, branch, tip, pad)
            for name, (branch, tip, pad) in zip(names, fingers, strict=True)
        )
        palm = self._palm_body(structure, tree, model)
        tips = [t for _, t, _ in fingers]
        normal = self._palm_normal(skeleton, palm, tips, opposer)
        sheets = tuple(s for _, _, pad in fingers for s in pad.sheets)
        if sheets:
            self._because(
                "repair.drop_collision",
                ", ".join(sheets),
                "thin sheets that cover the pads by less than a millimetre; the solids below "
                "them touch instead",
            )
        drive, defaults = self._drive(model, skeleton, tree, fingers)
        chosen = self._default_fingers(skeleton, names, tips, opposer)
        wrist = tuple(structure.joints[j].name for j in tree.wrist)
        if wrist:
            self._because("wrist_joints", ", ".join(wrist), "they lie between base and palm")
        for j in tree.others:
            self.questions.append(
                f"joint {structure.joints[j].name} belongs to no finger: the planner leaves it "
                "where it is; if it should move, put it into a finger's joints"
            )
        return description.model_copy(
            update={
                "palm_body": palm,
                "palm_normal": normal,
                "wrist_joints": wrist,
                "fingers": described,
                "default_fingers": chosen,
                "couplings": drive.couplings,
                "actuators": drive.actuators,
                "joint_defaults": defaults,
                "repair": description.repair.model_copy(update={"drop_collision": sheets}),
            }
        )

    def _fingers(
        self, skeleton: Skeleton, tree: HandTree
    ) -> list[tuple[Branch, Fingertip, PadFit]]:
        """The branches that end in something that can touch, with tip and pad."""
        first = [fingertip_of(skeleton, b, None) for b in tree.branches]
        poses = skeleton.place(skeleton.neutral)
        ends = {
            i: poses[t.joint_id].act(t.end) for i, t in enumerate(first) if t is not None
        }
        out = []
        for i, branch in enumerate(tree.branches):
            others = [e for k, e in ends.items() if k != i]
            middle = np.mean(others, axis=0) if others else None
            tip = fingertip_of(skeleton, branch, middle)
            pad = None if tip is None else fit_pad(tip, skeleton.solids[tip.joint_id])
            joints = [skeleton.structure.joints[j].name for j in branch.joints]
            if tip is None or pad is None:
                self.questions.append(
                    f"the chain {', '.join(joints)} ends in nothing solid that collides: it is no "
                    "finger; give its last body a colliding geom if it is one"
                )
                continue
            if not tip.certain:
                self.questions.append(
                    f"joint {skeleton.structure.joints[tip.flexion_joint].name} bends both ways "
                    "alike: the side of the other fingers is taken for the closing one; turn the "
                    "pad's axis if it is the other"
                )
            aside = [skeleton.structure.joints[j].name for j in branch.side_joints]
            if aside:
                self.questions.append(
                    f"the finger of {joints[0]} branches: {', '.join(aside)} are left aside"
                )
            out.append((branch, tip, pad))
        if len(out) < 2:
            raise HandError(
                f"{self.what} has {len(out)} fingers whose last link can touch anything; two are "
                "needed: give the last bodies of the fingers colliding geoms"
            )
        return out

    def _names(self, skeleton: Skeleton, branches: Sequence[Branch]) -> list[str]:
        names, whys = finger_names(skeleton.structure, branches)
        for name, why in zip(names, whys, strict=True):
            self._because(f"fingers.{name}.name", name, why)
        return names

    def _name_thumb(self, names: list[str], opposer: int) -> list[str]:
        """Call the opposer the thumb if nothing else is called so."""
        if "thumb" in names or not names[opposer].startswith("finger"):
            return names
        old = names[opposer]
        self.reasons = [r for r in self.reasons if r.key != f"fingers.{old}.name"]
        self._because(
            "fingers.thumb.name",
            "thumb",
            "its last joint closes against those of the others; rename it freely",
        )
        return [*names[:opposer], "thumb", *names[opposer + 1 :]]

    def _describe_finger(
        self, skeleton: Skeleton, name: str, branch: Branch, tip: Fingertip, pad: PadFit
    ) -> FingerDescription:
        structure, pin_model = skeleton.structure, skeleton.pin_model
        joints = tuple(structure.joints[j].name for j in branch.joints)
        self._because(
            f"fingers.{name}.joints", ", ".join(joints), "a chain of joints that leaves the palm"
        )
        site, position = _tip_site(skeleton, tip)
        body = next(s.body for s in skeleton.solids[tip.joint_id] if s.name == pad.geom)
        placement = pin_model.frames[pin_model.getBodyId(body)].placement
        described_tip = None
        if site:
            self._because(f"fingers.{name}.tip", site, f"the site nearest to the end, {position}")
        else:
            is_ball = pad.exact and np.linalg.norm(tip.end - pad.center) < 2 * pad.radius
            at = pad.center if is_ball else tip.end
            described_tip = TipDescription(body=body, position=_vector(placement.actInv(at)))
            self._because(
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
        self._because(
            f"fingers.{name}.pad",
            pad.geom,
            f"the end of the last link; it faces {np.rad2deg(pad.tilt):.0f} degrees from the way "
            f"that {closing} closes towards the bone; {fit}",
        )
        if not pad.exact and pad.error > FIT_TOL:
            self.questions.append(
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

    def _palm_body(self, structure: ModelStructure, tree: HandTree, model: Any) -> str:
        """Of the bodies of the palm's link, the heaviest."""
        candidates = [b for b in structure.bodies_of(tree.palm) if b]
        heaviest = max(candidates, key=lambda b: structure.bodies[b].mass)
        name = body_name(model, heaviest)
        self._because(
            "palm_body",
            name,
            f"{len(tree.branches)} chains of joints start from it"
            + (" or from bodies fixed to it" if len(candidates) > 1 else ""),
        )
        return name

    def _palm_normal(
        self, skeleton: Skeleton, palm: str, tips: Sequence[Fingertip], opposer: int
    ) -> tuple[float, float, float]:
        poses = skeleton.place(skeleton.neutral)
        frame = skeleton.pin_model.frames[skeleton.pin_model.getBodyId(palm)]
        to_palm = (poses[frame.parentJoint] * frame.placement).rotation.T
        ways = np.array([poses[t.joint_id].rotation @ t.flexion for t in tips])
        axes = np.array([poses[t.joint_id].rotation @ np.cross(t.bone, t.flexion) for t in tips])
        rest = np.arange(len(tips)) != opposer
        others = axes[rest].mean(axis=0)
        cosine = float(axes[opposer] @ others / max(np.linalg.norm(others), 1e-9))
        if cosine < GRIPPER:
            bones = np.array(
                [_reach_direction(skeleton, t) for t in tips]
            )
            way, why = bones.mean(axis=0), "the fingers close against each other and point there"
        else:
            way, why = ways[rest].mean(axis=0), "the fingers beside the thumb close to that side"
        if np.linalg.norm(way) < 0.3:
            way, why = ways.mean(axis=0), "the fingers close to that side, if to any"
            self.questions.append("it is not clear which way the palm faces; check palm_normal")
        local = to_palm @ (way / np.linalg.norm(way))
        k = int(np.argmax(np.abs(local)))
        if abs(local[k]) > np.cos(SNAP):
            local = np.sign(local[k]) * np.eye(3)[k]
        self._because("palm_normal", f"{(np.round(local, 2) + 0.0).tolist()} in the palm's frame", why)
        return _vector(local)

    def _default_fingers(
        self, skeleton: Skeleton, names: Sequence[str], tips: Sequence[Fingertip], opposer: int
    ) -> tuple[str, ...]:
        poses = skeleton.place(skeleton.neutral)
        ends = np.array([poses[t.joint_id].act(t.end) for t in tips])
        away = np.linalg.norm(ends - ends[opposer], axis=1)
        rest = sorted((i for i in range(len(names)) if i != opposer), key=lambda i: away[i])
        kept = sorted(rest[: MOST_FINGERS - 1])
        chosen = (names[opposer], *(names[i] for i in kept))
        why = f"{names[opposer]} opposes the others"
        if len(names) > MOST_FINGERS:
            why += f"; of those the {MOST_FINGERS - 1} nearest to it"
        self._because("default_fingers", ", ".join(chosen), why)
        return chosen

    def _drive(
        self,
        model: Any,
        skeleton: Skeleton,
        tree: HandTree,
        fingers: Sequence[tuple[Branch, Fingertip, PadFit]],
    ) -> tuple[Drive, Any]:
        structure = skeleton.structure
        equalities = couplings_from_mujoco(model)
        contacts = _contacts(skeleton, fingers)
        stops = stops_and_springs(
            structure, equalities, skeleton.q_lower, skeleton.q_upper, contacts
        )
        index = {j.name: k for k, j in enumerate(structure.joints)}
        held = [a.row for a in structure.actuators] + [c.row for c in equalities]
        for coupling in stops.couplings:
            row = np.zeros(len(structure.joints))
            for joint, coefficient in coupling.joints.items():
                row[index[joint]] = coefficient
            held.append(row)
        in_fingers = [j for branch, _, _ in fingers for j in branch.joints]
        order = [*tree.wrist, *in_fingers]
        order += [j for j in range(len(structure.joints)) if j not in order]
        inertia = joint_inertia(model, skeleton.neutral)
        servos = missing_servos(structure, held, order, inertia)
        defaults, why = joint_defaults(structure, servos.actuators, inertia)
        self.reasons += [*stops.reasons, *servos.reasons, *why]
        self.questions += [*stops.questions, *servos.questions]
        drive = Drive(couplings=stops.couplings, actuators=servos.actuators)
        return drive, defaults

    def _without_overlaps(self, description: HandDescription) -> HandDescription:
        """Exclude pairs of bodies that overlap nearly wherever the joints are."""
        hand = Hand.from_spec(self.spec, description)
        always = _overlapping(hand)
        if not always:
            return description
        listed = ", ".join(" - ".join(pair) for pair in always)
        self._because(
            "repair.exclude",
            listed,
            f"they overlap in at least {100 * ALWAYS:.0f} % of all configurations: neighbours by "
            "construction, or hulls of hollow parts",
        )
        repair = description.repair.model_copy(update={"exclude": always})
        return description.model_copy(update={"repair": repair})

    def _postures(self, description: HandDescription) -> HandDescription:
        hand = Hand.from_spec(self.spec, description)
        solver = PostureSolver(hand, hand.choose_fingers())
        pinch = solver.solve(PINCH_RADII)
        wide = solver.solve(OPEN_RADII, near=pinch.q)
        postures = {}
        for name, part in (("open", wide), ("pinch", pinch)):
            q = solver.rounded(part.q)
            rest = np.clip(np.zeros(hand.nq), hand.q_lower, hand.q_upper)
            postures[name] = {
                joint: float(f"{value:.12g}")
                for joint, value, zero in zip(hand.joint_names, q, rest, strict=True)
                if value != zero
            }
            self._because(f"postures.{name}", f"pads {2e3 * part.radius:.0f} mm apart", _told(part))
            if not part.good:
                self.questions.append(
                    f"no good posture {name!r} was found ({_told(part)}): give a better one, in "
                    "which the pads look at each other"
                )
        return description.model_copy(update={"postures": postures})


def _told(part: PosturePart) -> str:
    """What is good or bad about a posture, in words."""
    return (
        f"pads hold a ball of {1e3 * part.radius:.0f} mm radius to {1e3 * part.distance_error:.1f} "
        f"mm, the first finger looks {np.rad2deg(part.opposition_error):.0f} degrees past the "
        f"others, parts that must not touch are {1e3 * part.clearance:.1f} mm apart"
    )


def _opposer(skeleton: Skeleton, names: Sequence[str], tips: Sequence[Fingertip]) -> int:
    """The finger called thumb, else the one whose closing axis is least like the others'."""
    if "thumb" in names:
        return names.index("thumb")
    poses = skeleton.place(skeleton.neutral)
    axes = np.array([poses[t.joint_id].rotation @ np.cross(t.bone, t.flexion) for t in tips])
    return int(np.argmin(axes @ axes.sum(axis=0)))


def _reach_direction(skeleton: Skeleton, tip: Fingertip) -> FloatArray:
    """Unit vector from a finger's root to its end in the base, mid-range."""
    poses = skeleton.place((skeleton.q_lower + skeleton.q_upper) / 2)
    root = poses[_root_joint(skeleton, tip.joint_id)].translation
    way = poses[tip.joint_id].act(tip.end) - root
    return np.asarray(way / np.linalg.norm(way))


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


def _contacts(
    skeleton: Skeleton, fingers: Sequence[tuple[Branch, Fingertip, PadFit]]
) -> list[PadContact]:
    """Torques with which each pad is pressed along its axis, at random configurations."""
    rng = np.random.default_rng(0)
    out = []
    for _ in range(16):
        q = rng.uniform(skeleton.q_lower, skeleton.q_upper)
        poses = skeleton.place(q)
        for branch, tip, pad in fingers:
            pose = poses[tip.joint_id]
            point = pose.act(pad.center + pad.radius * pad.axis)
            force = pose.rotation @ pad.axis
            torque = np.zeros(len(q))
            for j in branch.joints:
                axis = poses[j + 1].rotation @ skeleton.axis(j)
                arm = np.cross(axis, point - poses[j + 1].translation)
                torque[j] = force @ (arm if skeleton.is_hinge(j) else axis)
            out.append(PadContact(q=q, torque=torque))
    return out


def _overlapping(hand: Hand) -> tuple[tuple[str, str], ...]:
    """Pairs of bodies with geometries that overlap in nearly all configurations."""
    rng = np.random.default_rng(0)
    samples = rng.uniform(hand.q_lower, hand.q_upper, (OVERLAP_SAMPLES, hand.nq))
    placed = []
    for q in samples:
        state = HandState(hand, q)
        placed.append([SE3(state.joint_pose(g.joint_id)) * g.T_joint_geometry
                       for g in hand.geometries])
    out = []
    for i, j in combinations(range(len(hand.geometries)), 2):
        a, b = hand.geometries[i], hand.geometries[j]
        if a.joint_id == b.joint_id or frozenset((a.name, b.name)) in hand.allowed_pairs:
            continue
        pair = DistancePair(a.geometry, b.geometry)
        apart, allowed = 0, int((1 - ALWAYS) * OVERLAP_SAMPLES)
        for poses in placed:
            apart += pair.distance(poses[i], poses[j]) >= TOUCHING
            if apart > allowed:
                break
        if apart <= allowed and (a.body, b.body) not in out:
            out.append((a.body, b.body))
    return tuple(out)


def _limits(pin_model: Any) -> tuple[FloatArray, FloatArray]:
    return np.array(pin_model.lowerPositionLimit), np.array(pin_model.upperPositionLimit)


def _vector(v: FloatArray) -> tuple[float, float, float]:
    """Six decimals: a micrometre, and a microradian."""
    x, y, z = (round(float(c), 6) + 0.0 for c in v)
    return (x, y, z)
