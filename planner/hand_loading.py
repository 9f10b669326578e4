"""``load_hand``: a hand by name or path, described by a file or by the structure of its model.

It stands above ``planner.hands`` and ``planner.describe``: where no description is given,
``planner.describe`` proposes one.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from planner.bridge import load_spec
from planner.errors import HandError
from planner.hands.arm import mount_of
from planner.hands.build import build_from_spec, build_hand, hand_on_arm
from planner.hands.catalog import find_hand, hand_reference, joined_names
from planner.hands.description_toml import DescribedHand, read_description, read_toml
from planner.hands.hand import Hand
from planner.joints.description import HandDescription

__all__ = ["hand_from_model", "hand_from_spec", "load_hand"]


def load_hand(name_or_path: str | Path, *, download: bool = True) -> Hand:
    """Load a hand by name or path.

    Args:
        name_or_path: A shipped hand (``catalog.hand_names()``), a description (``hand.toml``)
            or its folder; or a model, which is then described by its structure alone: a file
            (MJCF, URDF), ``PACKAGE:NAME`` out of ``catalog.FOREIGN_HANDS``,
            ``menagerie:NAME``, ``robot_descriptions:ID`` or ``package:PACKAGE/PATH``. Two of them
            with a plus between are two hands, palm to palm.
        download: Whether models of ``menagerie:`` and ``robot_descriptions:`` may be fetched
            where they are not cached. Readers of files say no: a file is not to make this
            machine fetch anything.

    Raises:
        NotFoundError: No such hand, or the description names what the model does not have.
        ModelError: The model file is missing or not usable.
        HandError: Description and model do not fit.
    """
    if names := joined_names(name_or_path):
        from planner.hands.two_hands import joined_hands  # here: few hands are two

        if "" in names:
            raise HandError(f"{name_or_path}: a hand is missing beside the plus; give one+other")
        both = [load_hand(name, download=download) for name in names]
        return joined_hands(both, hand_reference(name_or_path))
    path = find_hand(name_or_path, download=download)
    reference = hand_reference(name_or_path)
    if path.suffix == ".toml":
        raw = read_toml(path)
        if "arm" in raw:
            mount = mount_of(path, raw)
            return hand_on_arm(load_hand(mount.hand_path), mount, reference)
        if "hands" in raw:
            from planner.hands.two_hands import read_pair, two_hands

            pair = read_pair(path)
            hands = [load_hand(path.parent / held.hand) for held in pair.hands]
            return two_hands(pair, hands, path, reference)
        described = read_description(path)
    else:
        # here, since it loads slowly, and hands that are described do not need it
        from planner.describe import proposed_description

        described = DescribedHand(
            description=proposed_description(name_or_path),
            model_path=path,
            mirror_axis=None,
            described_in=path,
            files=(),
        )
    return build_hand(
        load_spec(described.model_path),
        described.description,
        mirror_axis=described.mirror_axis,
        path=path,
        where=str(described.described_in),
        model=str(described.model_path),
        reference=reference,
        digest=described.digest,
    )


def hand_from_spec(spec: Any, description: HandDescription | None = None) -> Hand:
    """A hand from a ``mujoco.MjSpec`` made in Python; the spec itself is left as it is.

    Args:
        spec: The model; bodies outside the base's subtree are dropped.
        description: The description; one proposed from the structure if None.

    Raises:
        NotFoundError: The description names what the model does not have.
        ModelError: The model is not usable.
        HandError: Description and model do not fit.
    """
    if description is None:
        from planner.describe import propose  # here, since it loads slowly

        description = propose(spec).description
    return build_from_spec(spec, description)


def hand_from_model(model: Any, description: HandDescription | None = None) -> Hand:
    """A hand from a compiled ``mujoco.MjModel``; see ``hand_from_spec``.

    Raises:
        NotFoundError: The description names what the model does not have.
        ModelError: The model has parts that cannot be turned back into a spec; or as above.
        HandError: Description and model do not fit.
    """
    from planner.bridge import spec_from_model

    return hand_from_spec(spec_from_model(model), description)
