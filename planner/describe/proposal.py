"""A proposal: a description, a reason for each guess, and open questions; and how it is written.

Floats are written with every digit: reading them back gives the same hand.
"""

from __future__ import annotations

import json
import os
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from planner.errors import FileFormatError
from planner.hands.catalog import PACKAGE_SCHEME
from planner.joints.description import HandDescription


@dataclass(frozen=True, kw_only=True)
class Reason:
    """The reason for a line of a description.

    Attributes:
        key: The line: "palm_body", "fingers.index.pad", "postures.pinch".
        value: The choice, in words.
        why: The evidence in the model, and evidence that would change it.
    """

    key: str
    value: str
    why: str


@dataclass(frozen=True, kw_only=True)
class Proposal:
    """A hand description proposed from the structure of a model.

    Attributes:
        description: The description; valid, and as complete as the model allows.
        reasons: One for every guess, in the order of the description.
        open_questions: What the structure leaves open or contradicts, each with a remedy.
    """

    description: HandDescription
    reasons: tuple[Reason, ...]
    open_questions: tuple[str, ...]


@dataclass(frozen=True)
class Notes:
    """Notes taken while a proposal is made.

    Attributes:
        reasons: One per line of the description.
        questions: Open questions.
    """

    reasons: list[Reason] = field(default_factory=list)
    questions: list[str] = field(default_factory=list)

    def because(self, key: str, value: str, why: str) -> None:
        """Note a reason."""
        self.reasons.append(Reason(key=key, value=value, why=why))

    def ask(self, question: str) -> None:
        """Note an open question."""
        self.questions.append(question)


COMMENT_WIDTH = 98
"""Width of a comment, characters."""


def write_description(
    description: HandDescription,
    path: Path,
    *,
    reasons: Sequence[Reason] = (),
    open_questions: Sequence[str] = (),
    overwrite: bool = False,
) -> None:
    """Write a description; a model beside it or below it is named by its relative path.

    Raises:
        FileFormatError: The file exists already, or cannot be written.
    """
    if path.exists() and not overwrite:
        raise FileFormatError(
            f"{path} exists already; name another file, or overwrite it (--force)"
        )
    text = description_text(description, path.parent, reasons, open_questions)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise FileFormatError(f"cannot write {path}: {error.strerror}") from error


def description_text(
    description: HandDescription,
    folder: Path,
    reasons: Sequence[Reason] = (),
    open_questions: Sequence[str] = (),
) -> str:
    """The TOML text of a description that is to lie in ``folder``."""
    because = {r.key: r.why for r in reasons}
    d = description
    lines = list(_comments(f"TO DO: {q}" for q in open_questions))
    if lines:
        lines.append("")
    lines += ["schema = 1", *_line("name", d.name), *_line("model", _model(d.model, folder))]
    for key in ("summary", "source"):
        if getattr(d, key):
            lines += _line(key, getattr(d, key))
    for key in ("base_body", "palm_body", "palm_normal", "wrist_joints", "default_fingers"):
        lines += _line(key, getattr(d, key), because.get(key))
    lines += _line("allowed_contacts", d.allowed_contacts)
    for table in ("repair", "joint_defaults"):
        values = getattr(d, table).model_dump(exclude_defaults=True)
        if values:
            lines += ["", f"[{table}]"]
            for key, value in values.items():
                lines += _line(key, value, because.get(f"{table}.{key}"))
    lines += _comments([because["actuators"]] if "actuators" in because else [], gap=True)
    for actuator in d.actuators:
        lines += ["", "[[actuators]]"]
        values = actuator.model_dump(exclude_defaults=True)
        lines += [text for key, value in values.items() for text in _line(key, value)]
    for finger in d.fingers:
        key = f"fingers.{finger.name}"
        lines += ["", "[[fingers]]"]
        lines += _line("name", finger.name, because.get(f"{key}.name"))
        lines += _line("joints", finger.joints, because.get(f"{key}.joints"))
        tip = because.get(f"{key}.tip")
        if finger.tip is None:
            lines += _line("tip_site", finger.tip_site, tip)
        else:
            lines += ["[fingers.tip]", *_comments([tip] if tip else [])]
            lines += _line("body", finger.tip.body) + _line("position", finger.tip.position)
        lines.append("[fingers.pad]")
        lines += _comments([because[f"{key}.pad"]] if f"{key}.pad" in because else [])
        for key_of_pad, value in finger.pad.model_dump(exclude_none=True).items():
            lines += _line(key_of_pad, value)
    for coupling in d.couplings:
        lines += ["", "[[couplings]]"]
        lines += _line("name", coupling.name, because.get(f"couplings.{coupling.name}"))
        lines += _line("joints", coupling.joints)
        lines += [*_line("value", coupling.value), *_line("kind", coupling.kind)]
    for name, posture in d.postures.items():
        lines += ["", f"[postures.{_key(name)}]"]
        why = because.get(f"postures.{name}")
        lines += _comments([why] if why else [])
        lines += [text for joint, value in posture.items() for text in _line(joint, value)]
    return "\n".join(lines) + "\n"


def write_proposal(proposal: Proposal, path: Path, *, overwrite: bool = False) -> None:
    """Write a proposal's description with its reasons and open questions.

    Raises:
        FileFormatError: The file exists already, or cannot be written.
    """
    write_description(
        proposal.description,
        path,
        reasons=proposal.reasons,
        open_questions=proposal.open_questions,
        overwrite=overwrite,
    )


def _model(model: str, folder: Path) -> str:
    """The model line: relative where the model lies in the folder or below, else as it is."""
    if model.startswith(PACKAGE_SCHEME) or not os.path.isabs(model):
        return model
    inside = Path(os.path.relpath(model, folder.absolute()))
    return model if inside.parts[0] == os.pardir else inside.as_posix()


def _line(key: str, value: Any, why: str | None = None) -> list[str]:
    return [*_comments([why] if why else []), f"{_key(key)} = {_value(value)}"]


def _comments(texts: Iterable[str], *, gap: bool = False) -> list[str]:
    lines = [f"# {line}" for text in texts for line in textwrap.wrap(text, width=COMMENT_WIDTH - 2)]
    return ["", *lines] if gap and lines else lines


def _key(key: str) -> str:
    """A key bare where TOML allows it."""
    bare = key.isascii() and key.replace("_", "").replace("-", "").isalnum()
    return key if bare else _value(key)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, Mapping):
        inner = ", ".join(f"{_key(k)} = {_value(v)}" for k, v in value.items())
        return f"{{ {inner} }}"
    return f"[{', '.join(_value(v) for v in value)}]"
