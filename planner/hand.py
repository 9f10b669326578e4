"""``Hand``: a model and its description, checked against each other.

MuJoCo compiles the model; Pinocchio's model, coal's geometries and the actuation are built from the
compiled model by ``planner.bridge``. What a hand has and answers is in ``planner.hand_model``.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from planner.bridge import (
    actuation_from_mujoco,
    add_described_parts,
    compile_spec,
    hand_geometries,
    load_spec,
    mirror_spec,
    motorise_spec,
    pinocchio_from_mujoco,
    prepare_spec,
    spec_from_model,
)
from planner.bridge.geometry import allowed_pairs
from planner.bridge.load import model_bytes, model_files
from planner.bridge.numbers import check_numbers
from planner.catalog import find_hand, hand_reference
from planner.couplings import Coupling, check_held
from planner.described import DescribedHand, MirrorAxis, read_description, reflection_signs
from planner.description import HandDescription
from planner.errors import HandError
from planner.fingers import Finger, Pad, Resolver
from planner.hand_model import HandModel
from planner.mount import Mount, read_mount

__all__ = ["Coupling", "Finger", "Hand", "Pad"]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Hand(HandModel):
    """A hand that the planner can use; make one with ``load``, ``from_spec`` or ``from_model``."""

    @classmethod
    def load(cls, name_or_path: str | Path, *, download: bool = True) -> Hand:
        """Load a hand by name or path.

        Args:
            name_or_path: A shipped hand (``catalog.hand_names()``), a description (``hand.toml``)
                or its folder; or a model, which is then described by its structure alone: a file
                (MJCF, URDF), ``PACKAGE:NAME`` out of ``catalog.FOREIGN_HANDS``,
                ``menagerie:NAME``, ``robot_descriptions:ID`` or ``package:PACKAGE/PATH``.
            download: Whether models of ``menagerie:`` and ``robot_descriptions:`` may be fetched
                where they are not cached. Readers of files say no: a file is not to make this
                machine fetch anything.

        Raises:
            NotFoundError: No such hand, or the description names what the model does not have.
            ModelError: The model file is missing or not usable.
            HandError: Description and model do not fit.
        """
        path = find_hand(name_or_path, download=download)
        reference = hand_reference(name_or_path)
        if path.suffix == ".toml":
            mount = read_mount(path)
            if mount is not None:
                return cls.load(mount.hand_path)._on_arm(mount, reference)
            described = read_description(path)
        else:
            described = DescribedHand(
                description=_proposed_of_file(name_or_path),
                model_path=path,
                mirror_axis=None,
                described_in=path,
                files=(),
            )
        return cls._build(
            load_spec(described.model_path),
            described.description,
            mirror_axis=described.mirror_axis,
            path=path,
            where=str(described.described_in),
            model=str(described.model_path),
            reference=reference,
            digest=described.digest,
        )

    @classmethod
    def from_spec(cls, spec: Any, description: HandDescription | None = None) -> Hand:
        """A hand from a ``mujoco.MjSpec`` made in Python; the spec itself is left as it is.

        Args:
            spec: The model; what is outside the base's subtree is dropped.
            description: The description; one proposed from the structure if None.

        Raises:
            NotFoundError: The description names what the model does not have.
            ModelError: The model is not usable.
            HandError: Description and model do not fit.
        """
        what = f"the model {spec.modelname!r}"
        return cls._build(
            spec.copy(),
            description or _proposed(spec),
            mirror_axis=None,
            path=None,
            where=f"the description of {what}",
            model=what,
            reference=None,
            digest=None,
        )

    @classmethod
    def from_model(cls, model: Any, description: HandDescription | None = None) -> Hand:
        """A hand from a compiled ``mujoco.MjModel``; see ``from_spec``.

        Raises:
            NotFoundError: The description names what the model does not have.
            ModelError: The model has parts that cannot be turned back into a spec; or as above.
            HandError: Description and model do not fit.
        """
        return cls.from_spec(spec_from_model(model), description)

    @classmethod
    def _build(
        cls,
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
        prepare_spec(spec, description, model)
        if mirror_axis is not None:
            mirror_spec(spec, reflection_signs(mirror_axis), model)
        add_described_parts(spec, description, model)
        if description.motors:
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
        hand = cls._of_model(
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

    @classmethod
    def _of_model(
        cls,
        spec: Any,
        mj_model: Any,
        description: HandDescription,
        *,
        where: str,
        path: Path | None,
        reference: str | None,
        digest: str,
        mount: Mount | None = None,
    ) -> Hand:
        """The hand of a compiled model: everything that follows from model and description.

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
        hand = cls(
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
        )
        drive = hand.actuation
        check_held(hand.joint_names, drive.moment, hand.couplings, where, drive.names)
        return hand

    def _on_arm(self, mount: Mount, reference: str) -> Hand:
        """This hand, carried by an arm."""
        where = str(mount.path)
        spec, root = mount.attach(self.new_spec())
        mj_model = compile_spec(spec, where)
        check_numbers(mj_model, where)
        if mj_model.nq != mj_model.njnt:
            raise HandError(f"{mount.arm_path} has free or ball joints; use hinges and slides")
        described = mount.description
        description = self.description.model_copy(
            update={"name": described.name, "summary": described.summary, "base_body": root}
        )
        files = (mount.path, *model_files(mount.arm_path))
        content = self.digest.encode() + b"".join(f.read_bytes() for f in files)
        return Hand._of_model(
            spec,
            mj_model,
            description,
            where=where,
            path=mount.path,
            reference=reference,
            digest=hashlib.sha256(content).hexdigest(),
            mount=mount,
        )


def _proposed_of_file(name_or_path: str | Path) -> HandDescription:
    """A description from the structure of a model on disk alone."""
    from planner.describe import proposed_description  # above this room: it checks hands as well

    return proposed_description(name_or_path)


def _proposed(spec: Any) -> HandDescription:
    """A description from the structure of a ``mujoco.MjSpec`` alone."""
    from planner.describe import propose

    return propose(spec).description
