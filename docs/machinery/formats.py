"""The pages of file formats, out of the models that read them, with an example of each."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import Any

from pydantic import BaseModel
from sphinx.application import Sphinx

from machinery import examples
from machinery.commands import shown
from machinery.docstrings import as_written
from machinery.write import write_pages
from planner.batch.rows import grasp_schema
from planner.exchange.table_forms import TableFile
from planner.files import ContactsFile, MovementFile, PlanFile
from planner.hand_loading import load_hand
from planner.hands.arm import MountDescription
from planner.hands.description_toml import MirrorDescription, MotorsDescription
from planner.joints.description import HandDescription
from sim.manipulation import ManipulationReportFile
from sim.report_file import ReportFile
from sim.scene.physics import PhysicsOptions

HERE = Path(__file__).parent.parent
FOLDER = HERE / "reference" / "generated" / "formats"
HANDS = HERE.parent / "models" / "hands"


@dataclass(frozen=True)
class Format:
    """A kind of file.

    Attributes:
        title: What it is called.
        file: Name of its page.
        text: What it is for, and who reads and writes it.
        model: What reads it: a Pydantic model or a dataclass.
        language: Of the example.
        example: Makes an example.
    """

    title: str
    file: str
    text: str
    model: type
    language: str
    example: Callable[[], str]


def _hand(name: str) -> Callable[[], str]:
    return partial((HANDS / name / "hand.toml").read_text, encoding="utf-8")


FORMATS = (
    Format(
        "hand.toml",
        "hand",
        "Describes a hand: what its model does not say. ``opposable hands --describe`` proposes "
        "one and ``opposable hands --check`` says what is wrong with it.",
        HandDescription,
        "toml",
        _hand("allegro_hand"),
    ),
    Format(
        "hand.toml of a mirrored hand",
        "hand-mirror",
        "The other side of a hand that is described already.",
        MirrorDescription,
        "toml",
        _hand("allegro_hand_left"),
    ),
    Format(
        "hand.toml with torque motors",
        "hand-motors",
        "A described hand with torque motors instead of its servos and tendons.",
        MotorsDescription,
        "toml",
        _hand("shadow_hand_torque"),
    ),
    Format(
        "hand.toml of a hand on an arm",
        "hand-arm",
        "A described hand on an arm.",
        MountDescription,
        "toml",
        _hand("allegro_on_arm7"),
    ),
    Format(
        "Physics",
        "physics",
        "How MuJoCo computes: ``--physics FILE``, TOML or JSON. What a file leaves out is ours.",
        PhysicsOptions,
        "toml",
        lambda: examples.PHYSICS,
    ),
    Format(
        "Table of grasps",
        "grasp-table",
        "Poses and joints of grasps by names with units, here as JSON; NPZ and CSV have the same. "
        "``opposable refine --judge-only`` reads it, "
        "and ``opposable export --to table`` writes it.",
        TableFile,
        "json",
        examples.grasp_table,
    ),
    Format(
        "Contacts",
        "contacts",
        "A list of contacts that a person types in; ``opposable analyse`` reads it.",
        ContactsFile,
        "json",
        lambda: examples.CONTACTS,
    ),
    Format(
        "Plan",
        "plan",
        "A grasp plan; ``opposable plan`` and ``write_plan`` write it.",
        PlanFile,
        "json",
        examples.plan,
    ),
    Format(
        "Trial report",
        "report",
        "What happened in a trial; ``opposable run`` and ``opposable test`` write it.",
        ReportFile,
        "json",
        examples.report,
    ),
    Format(
        "Movement",
        "movement",
        "A movement in the hand: the phases of a turn or translation, strokes and relocations of "
        "single fingers, and how the object is put down; ``opposable manipulate`` writes it, with "
        "``--plan-only`` without an ending.",
        MovementFile,
        "json",
        examples.movement,
    ),
    Format(
        "Manipulation report",
        "manipulation-report",
        "What happened in a manipulation; ``opposable manipulate`` writes it.",
        ManipulationReportFile,
        "json",
        examples.manipulation_report,
    ),
)


LIMITS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<=", "min_length": "length >="}
"""Limits that a field can have, as they are shown."""


def meanings(model: type) -> dict[str, str]:
    """Field -> what the docstring says of it, in a list of attributes or below the field."""
    text = inspect.getdoc(model) or ""
    listed = text.partition("Attributes:\n")[2].split("\n\n")[0]
    found: dict[str, str] = {}
    for entry in re.split(r"\n(?= {4}\w)", f"\n{listed}"):
        names, _, meaning = entry.strip().partition(": ")
        found |= {name: " ".join(meaning.split()) for name in names.split(", ")}
    return found


def rows(model: Any) -> Iterator[tuple[str, str, str, str]]:
    """Name, type, default and meaning of each field."""
    known = meanings(model)
    hints: dict[str, object] = {}
    for base in reversed(model.__mro__):
        hints |= vars(base).get("__annotations__", {})
    if is_dataclass(model):
        for item in fields(model):
            default = "" if item.default is MISSING else repr(item.default)
            yield item.name, as_written(hints[item.name]), default, known.get(item.name, "")
        return
    for name, field in model.model_fields.items():
        required = field.is_required()
        default = "" if required else repr(field.get_default(call_default_factory=True))
        limits = [
            f"{sign} {getattr(given, key)}"
            for given in field.metadata
            for key, sign in LIMITS.items()
            if hasattr(given, key)
        ]
        meaning = f"{known.get(name, '')} {'; '.join(limits)}".strip()
        yield field.alias or name, as_written(hints[name]), default, meaning


def parts(model: Any) -> list[Any]:
    """A model and those in it, outermost first; none inside what has a page of its own."""
    found = [model]
    with_page = {form.model for form in FORMATS}
    for one in found:
        if one is not model and one in with_page:
            continue
        for field in getattr(one, "model_fields", {}).values():
            inner = [field.annotation]
            while inner:
                kind = inner.pop()
                inner += getattr(kind, "__args__", ())
                if inspect.isclass(kind) and issubclass(kind, BaseModel) and kind not in found:
                    found.append(kind)
    return found


def tables(form: Format) -> list[str]:
    """What a format is for, and the tables of its fields."""
    lines = [form.title, "=" * len(form.title), "", form.text, ""]
    for model in parts(form.model):
        if model is not form.model:
            lines += [model.__name__, "-" * len(model.__name__), ""]
            if other := [f.file for f in FORMATS if f.model is model]:
                lines += [f"See :doc:`{other[0]}`.", ""]
                continue
        said = (inspect.getdoc(model) or "").split("Attributes:")[0]
        lines += [shown(part) + "\n" for part in re.sub(r"``(.*?)``", r"\1", said).split("\n\n")]
        lines += [".. list-table::", "   :header-rows: 1", "   :class: names", ""]
        table = list(rows(model))
        explained = any(meaning for *_, meaning in table)
        lines += ["   * - field", "     - type", "     - if left out"]
        lines += ["     - meaning"] * explained
        for name, kind, default, meaning in table:
            left_out = "required" if default == "" else f"``{shorter(default)}``"
            lines += [f"   * - ``{name}``", f"     - ``{kind}``", f"     - {left_out}"]
            lines += [f"     - {shown(meaning.replace('``', ''))}"] * explained
        lines += [""]
    return lines


def page(form: Format) -> str:
    """The page of one format: tables of fields, and an example."""
    lines = [*tables(form), "Example", "-------", ""]
    if form.language == "json":
        lines += ["Long lists are cut short here: ``...`` stands for what is left out.", ""]
    language = "text" if form.language == "json" else form.language
    lines += [f".. code-block:: {language}", ""]
    lines += [f"   {line}".rstrip() for line in form.example().splitlines()]
    return "\n".join([*lines, ""])


def shorter(text: str) -> str:
    """A default value, cut where it is long."""
    return text if len(text) < 45 else f"{text.partition('(')[0][:40]}(...)"


def dataset() -> str:
    """The page of the table of grasps that ``opposable batch`` writes."""
    title = "Dataset of grasps"
    lines = [title, "=" * len(title), ""]
    lines += ["``opposable batch`` writes a folder: ``manifest.json`` says what was requested, and"]
    lines += ["Parquet files hold the grasps. Lists of joints are as long as the hand has joints"]
    lines += ["(16 here); ``GraspSet`` reads the folder.", ""]
    lines += [".. list-table::", "   :header-rows: 1", "   :class: names", ""]
    lines += ["   * - column", "     - type", "     - meaning"]
    for field in grasp_schema(load_hand("allegro_hand")):
        lines += [f"   * - ``{field.name}``", f"     - ``{field.type}``"]
        lines += [f"     - {shown(field.metadata[b'description'].decode())}"]
    return "\n".join([*lines, ""])


def pages() -> dict[str, str]:
    """Name of a file -> its text."""
    names = [*(form.file for form in FORMATS), "dataset"]
    first = ["File formats", "============", ""]
    first += [
        "``opposable export --schema KIND`` prints the JSON Schema of what is JSON. Files say their"
    ]
    first += ["version; unknown fields, NaN and infinity are refused with the field's name. Units"]
    first += ["are in the names: ``_m``, ``_N``, ``_rad``; frames and signs are those of the"]
    first += [":doc:`conventions </how/conventions>`.", "", ".. toctree::", "   :maxdepth: 1", ""]
    first += [f"   {name}" for name in names]
    written = {f"{form.file}.rst": page(form) for form in FORMATS}
    return {"index.rst": "\n".join([*first, ""]), **written, "dataset.rst": dataset()}


def setup(app: Sphinx) -> dict[str, Any]:
    """Write the pages when a build begins."""
    app.connect("builder-inited", lambda _: write_pages(FOLDER, pages()))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
