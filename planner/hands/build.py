"""From a model and a description to a ``Hand``: its parts, built once and checked.

MuJoCo compiles the model; Pinocchio's model, coal's geometries and the actuation are built from the
compiled model by ``planner.bridge``.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from planner.bridge import (
    actuation_from_mujoco,
    add_described_parts,
    compile_spec,
    hand_geometries,
    pinocchio_from_mujoco,
    prepare_spec,
)
from planner.bridge.geometry import allowed_pairs
from planner.bridge.load import model_bytes, model_files
from planner.bridge.numbers import check_numbers
from planner.errors import HandError
from planner.hands.arm import Mount
from planner.hands.description_toml import MirrorAxis, reflection_signs
from planner.hands.fingers import Resolver, Side
from planner.hands.hand import Hand
from planner.joints.couplings import check_held
from planner.joints.description import HandDescription

__all__ = ["build_from_spec", "build_hand", "hand_of_model", "hand_on_arm"]


def build_from_spec(spec: Any, description: HandDescription) -> Hand:
    """A hand from a ``mujoco.MjSpec`` made in Python; the spec itself is left as it is.

    Args:
        spec: The model; bodies outside the base's subtree are dropped.
        description: What names its palm, base, fingers and pads.

    Raises:
        NotFoundError: The description names what the model does not have.
        ModelError: The model is not usable.
        HandError: Description and model do not fit.
    """
    from planner.bridge.structure import read_spec  # here: models in memory alone

    what = f"the model {spec.modelname!r}"
    return build_hand(
        read_spec(spec),
        description,
        mirror_axis=None,
        path=None,
        where=f"the description of {what}",
        model=what,
        reference=None,
        digest=None,
    )


def build_hand(
    spec: Any,
    description: HandDescription,
    *,
    mirror_axis: MirrorAxis | None,
    path: Path | None,
    where: str,
    model: str,
    reference: str | None,
    digest: str | None,
) -> Hand:
    """A hand from a spec, which is changed, and a description.

    Args:
        spec: ``mujoco.MjSpec`` of the hand.
        description: What names its palm, base, fingers and pads.
        mirror_axis: Axis along which the hand is mirrored, or None.
        path: The file that describes the hand, or None.
        where: What errors call the description.
        model: What errors call the model.
        reference: What ``load_hand`` takes to get the same hand again, or None.
        digest: SHA-256 of what determines the hand; computed from the model if None.

    Raises:
        NotFoundError: The description names what the model does not have.
        ModelError: The model is not usable.
        HandError: Description and model do not fit.
    """
    spec = prepare_spec(spec, description, model)
    if mirror_axis is not None:
        from planner.bridge import mirror_spec

        mirror_spec(spec, reflection_signs(mirror_axis), model)
    add_described_parts(spec, description, model)
    if description.motors:
        from planner.bridge import motorise_spec

        motorise_spec(spec, model)
    mj_model = compile_spec(spec, model)
    if mj_model.nq != mj_model.nv or mj_model.nq != mj_model.njnt:
        raise HandError(
            f"{model} has free or ball joints below {description.base_body!r}; a hand has "
            "hinges and slides: replace a ball joint by hinges, or name another base_body"
        )
    if mj_model.nq == 0:
        raise HandError(
            f"{model} has no joint below {description.base_body!r}; name another base_body"
        )
    check_numbers(mj_model, model)
    if digest is None:
        content = description.model_dump_json().encode() + model_bytes(mj_model)
        digest = hashlib.sha256(content).hexdigest()
    hand = hand_of_model(
        spec,
        mj_model,
        description,
        where=where,
        path=path,
        reference=reference,
        digest=digest,
    )
    for posture in description.postures:
        hand.posture(posture)
    return hand


def hand_on_arm(hand: Hand, mount: Mount, reference: str) -> Hand:
    """A hand that an arm carries.

    Args:
        hand: The hand alone.
        mount: The description of arm and flange.
        reference: What ``load_hand`` takes to get the same again.

    Raises:
        ModelError: The arm's model is missing or not usable.
        HandError: Arm and hand do not fit.
    """
    where = str(mount.path)
    spec, root = mount.attach(hand.new_spec())
    mj_model = compile_spec(spec, where)
    check_numbers(mj_model, where)
    if mj_model.nq != mj_model.njnt:
        raise HandError(f"{mount.arm_path} has free or ball joints; use hinges and slides")
    described = mount.description
    description = hand.description.model_copy(
        update={"name": described.name, "summary": described.summary, "base_body": root}
    )
    files = (mount.path, *model_files(mount.arm_path))
    content = hand.digest.encode() + b"".join(f.read_bytes() for f in files)
    return hand_of_model(
        spec,
        mj_model,
        description,
        where=where,
        path=mount.path,
        reference=reference,
        digest=hashlib.sha256(content).hexdigest(),
        mount=mount,
    )


def hand_of_model(
    spec: Any,
    mj_model: Any,
    description: HandDescription,
    *,
    where: str,
    path: Path | None,
    reference: str | None,
    digest: str,
    mount: Mount | None = None,
    sides: Callable[[Sequence[str]], tuple[Side, ...]] | None = None,
) -> Hand:
    """The hand of a compiled model: everything that follows from model and description.

    Args:
        spec: ``mujoco.MjSpec`` of the hand, prepared.
        mj_model: The same, compiled.
        description: What names its palm, base, fingers and pads.
        where: What errors call the description.
        path: Its file, or None.
        reference: What ``load_hand`` takes to get the same hand again, or None.
        digest: SHA-256 of what determines the hand.
        mount: The arm that carries it, or None.
        sides: The two hands that this is, by the names of all joints; None for one hand.

    Raises:
        NotFoundError: The description names what the model does not have.
        HandError: Description and model do not fit.
    """
    pin_model = pinocchio_from_mujoco(mj_model)
    geometries = hand_geometries(mj_model, pin_model)
    resolver = Resolver(where, description, mj_model, pin_model, geometries)
    arm = None
    if mount is not None:
        palm = int(pin_model.getBodyId(description.palm_body))
        arm = mount.arm(pin_model, palm, geometries)
    hand = Hand(
        name=description.name,
        description=description,
        path=path,
        reference=reference,
        digest=digest,
        spec=spec,
        mj_model=mj_model,
        pin_model=pin_model,
        fingers=resolver.fingers(),
        geometries=geometries,
        allowed_pairs=allowed_pairs(mj_model, description.allowed_contacts),
        actuation=actuation_from_mujoco(mj_model),
        couplings=resolver.couplings(),
        arm=arm,
        pair=() if sides is None else sides(tuple(pin_model.names)[1:]),
    )
    drive = hand.actuation
    check_held(hand.joint_names, drive.moment, hand.couplings, where, drive.names)
    return hand
