"""``propose``: a hand description from the structure of a model alone, with a reason for each line.

The order follows the data: repairs that MuJoCo needs, the base, the tree of fingers, their tips and
pads, what drives them, and last the postures, which are looked for on the hand so described.

A proposal takes seconds, mostly for postures. It is determined by the model, the name of its file,
our code and the libraries: by these ``proposed_description`` keeps it on disk.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from planner.bridge import couplings_from_mujoco, hand_geometries
from planner.bridge.geometry import joint_inertia
from planner.bridge.load import named_files
from planner.bridge.pinocchio_model import pinocchio_from_mujoco
from planner.bridge.structure import read_spec, structure_of
from planner.describe.anatomy import (
    default_fingers,
    describe_finger,
    find_fingers,
    find_opposer,
    palm_body,
    palm_normal,
)
from planner.describe.drive import (
    PadContact,
    joint_defaults,
    joint_stops,
    missing_servos,
    stops_and_springs,
)
from planner.describe.fingertips import Fingertip, Skeleton
from planner.describe.overlaps import frequent_overlaps
from planner.describe.pads import PadFit
from planner.describe.postures import PostureCandidate, PosturePart, PostureSolver
from planner.describe.proposal import Notes, Proposal
from planner.describe.repairs import (
    prepared_model,
    repair_and_base,
    with_possible_inertias,
    without_impossible_couplings,
    without_overlaps,
)
from planner.describe.tree import Branch, HandTree, finger_names, read_tree
from planner.errors import HandError
from planner.hands.build import build_from_spec
from planner.hands.catalog import find_hand, foreign_hand_model
from planner.joints.description import (
    ActuatorDescription,
    CouplingDescription,
    HandDescription,
    JointDefaults,
)
from planner.spatial import FloatArray
from planner.system.disk_cache import read_text, write_text


def propose(model: Any, *, name: str | None = None, base_body: str | None = None) -> Proposal:
    """Propose a hand description from a model.

    Args:
        model: A path, or ``PACKAGE:NAME`` as for ``load_hand``; a ``mujoco.MjSpec``, or a compiled
            ``mujoco.MjModel``.
        name: What to call the hand; after the model if None.
        base_body: Root of the hand in the model; found if None.

    Raises:
        NotFoundError: The model, or the body, does not exist.
        ModelError: The model cannot be read.
        HandError: Nothing in it is a hand, several things are, or no finger can be described.
    """
    path, line = (None, "model.xml") if not isinstance(model, str | Path) else located(model)
    what = str(path) if path is not None else "the model"
    return _Proposer(path if path is not None else model, what, line, name, base_body).run()


def located(model: str | Path) -> tuple[Path, str]:
    """A model's path, and the ``model`` line of its description.

    Raises:
        NotFoundError: The model does not exist.
        ModelError: It is in a package that is missing.
        HandError: It is a description already.
    """
    path = find_hand(model)
    if path.suffix == ".toml":
        raise HandError(f"{path} is a description already; give the model that it names")
    line = foreign_hand_model(str(model))
    if line is not None:
        return path, line
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
        self.notes = Notes()
        if not isinstance(source, Path):
            self.notes.ask(f"the model was made in Python: save it, and name its file for {line!r}")

    def run(self) -> Proposal:
        """Everything, in order."""
        repair, base = repair_and_base(self.spec, self.base_choice, self.what, self.notes)
        description = HandDescription(
            schema=1,
            name=self.name,
            model=self.line,
            base_body=base,
            palm_body=base,
            palm_normal=(0.0, 0.0, 1.0),
            repair=repair,
        )
        alone = prepared_model(self.spec, description, self.what)
        description = with_possible_inertias(alone, description, self.notes)
        description = without_impossible_couplings(alone, description, self.notes)
        description = self._anatomy(description)
        description = without_overlaps(self.spec, description, self.notes)
        description = self._postures(description)
        hand = build_from_spec(self.spec, description)
        for overlap in frequent_overlaps(hand):
            self.notes.ask(f"{overlap.text}; {overlap.remedy}")
        return Proposal(
            description=description,
            reasons=tuple(self.notes.reasons),
            open_questions=tuple(self.notes.questions),
        )

    def _anatomy(self, description: HandDescription) -> HandDescription:
        """Palm, fingers, pads and drive."""
        model = prepared_model(self.spec, description, self.what)
        structure = structure_of(model)
        if not structure.hinges_and_slides:
            raise HandError(
                f"{self.what} has free or ball joints below {description.base_body!r}; a hand has "
                "hinges and slides: name another base_body (--base-body)"
            )
        endless = [j.name for j in structure.joints if j.limits is None]
        if endless:
            raise HandError(
                f"joints {endless} of {self.what} have no range; give them one in the model "
                "(range in MJCF, a <limit> and type revolute in URDF)"
            )
        pin_model = pinocchio_from_mujoco(model)
        skeleton = Skeleton(structure, pin_model, hand_geometries(model, pin_model))
        ties = [c.row for c in couplings_from_mujoco(model)]
        tree = read_tree(structure, description.base_body, self.what, ties)
        fingers = find_fingers(skeleton, tree, self.what, self.notes)
        names = self._names(skeleton, [b for b, _, _ in fingers])
        opposer = find_opposer(skeleton, names, [t for _, t, _ in fingers])
        names = self._name_thumb(names, opposer)
        described = tuple(
            describe_finger(skeleton, name, branch, tip, pad, self.notes)
            for name, (branch, tip, pad) in zip(names, fingers, strict=True)
        )
        palm = palm_body(structure, tree, self.notes)
        tips = [t for _, t, _ in fingers]
        normal = palm_normal(skeleton, palm, tips, opposer, self.notes)
        sheets = tuple(s for _, _, pad in fingers for s in pad.sheets)
        if sheets:
            self.notes.because(
                "repair.drop_collision",
                ", ".join(sheets),
                "thin sheets that cover the pads by less than a millimetre; the solids below "
                "them touch instead",
            )
        couplings, servos, defaults = self._drive(model, skeleton, tree, fingers)
        chosen = default_fingers(skeleton, names, tips, opposer, self.notes)
        wrist = tuple(structure.joints[j].name for j in tree.wrist)
        if wrist:
            self.notes.because("wrist_joints", ", ".join(wrist), "they lie between base and palm")
        for j in tree.others:
            if any(row[j] for row in ties):
                continue  # it follows another joint
            self.notes.ask(
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
                "couplings": couplings,
                "actuators": servos,
                "joint_defaults": defaults,
                "repair": description.repair.model_copy(update={"drop_collision": sheets}),
            }
        )

    def _names(self, skeleton: Skeleton, branches: Sequence[Branch]) -> list[str]:
        names, whys = finger_names(skeleton.structure, branches)
        for name, why in zip(names, whys, strict=True):
            self.notes.because(f"fingers.{name}.name", name, why)
        return names

    def _name_thumb(self, names: list[str], opposer: int) -> list[str]:
        """Call the opposer the thumb if nothing else is called so."""
        if "thumb" in names or not names[opposer].startswith("finger"):
            return names
        old = names[opposer]
        self.notes.reasons[:] = [r for r in self.notes.reasons if r.key != f"fingers.{old}.name"]
        self.notes.because(
            "fingers.thumb.name",
            "thumb",
            "its last joint closes against those of the others; rename it freely",
        )
        return [*names[:opposer], "thumb", *names[opposer + 1 :]]

    def _drive(
        self,
        model: Any,
        skeleton: Skeleton,
        tree: HandTree,
        fingers: Sequence[tuple[Branch, Fingertip, PadFit]],
    ) -> tuple[tuple[CouplingDescription, ...], tuple[ActuatorDescription, ...], JointDefaults]:
        structure, notes = skeleton.structure, self.notes
        low, high = skeleton.q_lower, skeleton.q_upper
        equalities = couplings_from_mujoco(model)
        contacts = _contacts(skeleton, fingers)
        stops = stops_and_springs(structure, equalities, low, high, contacts, notes)
        index = {j.name: k for k, j in enumerate(structure.joints)}
        held = [a.row for a in structure.actuators] + [c.row for c in equalities]
        held += [_row(coupling, index) for coupling in stops]
        ends = joint_stops(structure, held, low, high, contacts, notes)
        held += [_row(coupling, index) for coupling in ends]
        order = [*tree.wrist, *(j for branch, _, _ in fingers for j in branch.joints)]
        order += [j for j in range(len(structure.joints)) if j not in order]
        inertia = joint_inertia(model, skeleton.neutral)
        servos = missing_servos(structure, held, order, inertia, notes)
        return (*stops, *ends), servos, joint_defaults(structure, servos, inertia, notes)

    def _postures(self, description: HandDescription) -> HandDescription:
        """The best candidate as ``open`` and ``pinch``, others as ``open_2``, ``pinch_2``, ..."""
        hand = build_from_spec(self.spec, description)
        solver = PostureSolver(hand, hand.choose_fingers())
        candidates = solver.candidates()
        postures = {}
        for number, candidate in enumerate(candidates, start=1):
            suffix = "" if number == 1 else f"_{number}"
            for name, part in (
                (f"open{suffix}", candidate.wide),
                (f"pinch{suffix}", candidate.pinch),
            ):
                q = solver.rounded(part.q)
                postures[name] = {
                    joint: float(f"{value:.12g}")
                    for joint, value, zero in zip(hand.joint_names, q, hand.neutral, strict=True)
                    if value != zero
                }
                self.notes.because(
                    f"postures.{name}",
                    f"pads {2e3 * part.radius:.0f} mm apart",
                    _rated(candidate, part, number),
                )
        best = candidates[0]
        bad = next((part for part in (best.pinch, best.wide) if not part.good), None)
        if bad is not None:
            self.notes.ask(
                "no good postures 'open' and 'pinch' were found "
                f"({_rated(best, bad, 1)}): give better ones, in which the pads face each "
                "other"
            )
        return description.model_copy(update={"postures": postures})


def _row(coupling: CouplingDescription, index: Mapping[str, int]) -> FloatArray:
    """Coefficients (nv,) of a described coupling."""
    row = np.zeros(len(index))
    for joint, coefficient in coupling.joints.items():
        row[index[joint]] = coefficient
    return row


def _rated(candidate: PostureCandidate, part: PosturePart, number: int) -> str:
    """The quality of a posture, in words."""
    shape = "bar along the fingers" if candidate.bar else "ball"
    text = (
        f"pads hold a {shape} of {2e3 * part.radius:.0f} mm to "
        f"{1e3 * part.distance_error:.1f} mm, the first finger presses "
        f"{np.rad2deg(part.opposition_error):.0f} degrees past the others, pads face it to "
        f"{np.rad2deg(part.facing_error):.0f} degrees beyond their cones, parts that must not "
        f"touch are {1e3 * part.clearance:.1f} mm apart"
    )
    if number > 1:
        text += (
            f"; choice {number}, not used: exchange the names of this table and of the one without "
            "a number to plan from it"
        )
    return text


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


KIND = "proposal"

LIBRARIES = ("mujoco", "pin", "coal", "numpy", "scipy", "trimesh")
"""Distributions on whose numbers a proposal depends."""


def proposed_description(model: str | Path) -> HandDescription:
    """The description that ``propose`` finds for a model, found once.

    Args:
        model: As for ``propose``, on disk.

    Raises:
        PlannerError: As ``propose`` does.
    """
    path, line = located(model)
    key = _key(path, line)
    if key is None:
        return propose(model).description
    known = _read(key)
    if known is not None:
        return known.model_copy(update={"model": line})
    description = propose(model).description
    write_text(KIND, key, description.to_json())
    return description


def _read(key: str) -> HandDescription | None:
    text = read_text(KIND, key)
    try:
        return None if text is None else HandDescription.from_json(text)
    except ValidationError:
        return None


def _key(path: Path, line: str) -> str | None:
    """Key of a proposal, wherever the model lies; None if not all files are known.

    The hand is called after the last part of its ``model`` line.
    """
    files = named_files(path)
    if not all(f.is_file() for f in files):
        return None  # MuJoCo found them elsewhere, or will say what is missing
    digest = hashlib.sha256(_made_with())
    parts = [line.rpartition("/")[2].encode()]
    for file in files:
        parts += [file.name.encode(), file.read_bytes()]
    for part in parts:
        digest.update(hashlib.sha256(part).digest())
    return digest.hexdigest()


@lru_cache(maxsize=1)
def _made_with() -> bytes:
    """Digest of all modules of the planner, and of the libraries' versions."""
    root = Path(__file__).resolve().parents[1]
    digest = hashlib.sha256()
    for module in sorted(root.rglob("*.py")):
        digest.update(hashlib.sha256(module.read_bytes()).digest())
    for name in LIBRARIES:
        digest.update(f"{name} {_version(name)};".encode())
    return digest.digest()


def _version(name: str) -> str:
    """Of a distribution; "" where it came in another way than as a package of that name."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""
