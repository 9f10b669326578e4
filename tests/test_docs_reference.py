"""The reference holds all there is, each once: names, commands, formats, messages."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("sphinx")
pytest.importorskip("pyarrow")

import machinery.api as api
import machinery.commands as commands
import machinery.examples as examples
import machinery.formats as formats
import machinery.messages as messages
import machinery.public as public
import machinery.terms as terms

import planner
import sim
from planner import GraspTask, load_hand, parse_object, plan_grasp, read_plan
from planner.errors import PlannerError
from planner.files import read_contacts
from planner.motion.terms import MOTION_TERMS
from planner.synthesis.terms.registry import TERMS
from sim.cli import main
from sim.scene.physics import PRESETS
from sim.verdict import REASONS

pytestmark = pytest.mark.documentation

ROOT = Path(__file__).resolve().parent.parent
DIRECTIVE = re.compile(r"^\.\. auto(?:class|exception|function):: (\S+)$", re.MULTILINE)
DATA = re.compile(r"^\.\. py:data:: (\S+)\n   :module: (\S+)$", re.MULTILINE)


@pytest.fixture(scope="module")
def api_text() -> str:
    return "\n".join(api.page(title, rooms) for title, rooms in public.groups().items())


@pytest.mark.slow
def test_every_public_name_is_documented_once(api_text: str) -> None:
    documented = Counter(DIRECTIVE.findall(api_text))
    documented.update(f"{module}.{name}" for name, module in DATA.findall(api_text))
    assert set(documented.values()) == {1}
    assert set(documented) == {name.full_name for name in public.public_names()}


def test_every_name_of_every_face_is_one_of_them() -> None:
    homes = {(name.home, name.home_name) for name in public.public_names()}
    assert len(homes) == len(public.public_names()) > 600
    for room in public.rooms():
        for face in public.faces(room):
            for name in public.offered(face):
                assert public.home_of(face, name) in homes, f"{face}.{name}"
    for package in (planner, sim):
        for name in package.__all__:
            assert public.home_of(package.__name__, name) in homes


def test_every_room_is_on_one_page() -> None:
    rooms = Counter(room for listed in public.groups().values() for room in listed)
    assert rooms == Counter(public.rooms())
    named = {room for listed in public.GROUPS.values() for room in listed}
    assert named <= set(public.rooms()), "a room that is gone stands in a group"


@pytest.mark.slow
def test_every_public_name_says_what_it_is() -> None:
    assert [n.full_name for n in public.public_names() if not api.summary(n)] == []


def test_a_face_belongs_to_the_room_that_defines_it() -> None:
    where = {name.name: name.module for name in public.public_names()}
    assert where["ContactSet"] == "planner.contacts"  # defined in a module of that room
    assert where["Attempt"] == "planner.search.attempt"  # planner.search.grasp offers it too
    assert where["Mug"] == "planner.shapes"


def test_every_command_and_option_is_on_its_page() -> None:
    text = "\n".join(commands.pages().values())
    for _, command, context in commands.commands():
        assert text.count(f"\n{context.command_path}\n---") == 1, context.command_path
        for parameter in command.params:
            if record := parameter.get_help_record(context):
                assert f"``{record[0]}``" in text


def test_every_kind_of_schema_has_a_page(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["export", "--schema", "nothing"])
    error = " ".join(capsys.readouterr().err.split())
    kinds = error.partition("There is: ")[2].rstrip(". ").split(", ")
    assert len(kinds) > 5
    assert set(kinds) <= {form.file for form in formats.FORMATS}


def test_every_field_is_in_a_table() -> None:
    for form in formats.FORMATS:
        table = "\n".join(formats.tables(form))
        for name, *_ in formats.rows(form.model):
            assert f"   * - ``{name}``" in table


def test_examples_are_read_by_what_they_are_examples_of(tmp_path: Path) -> None:
    path = tmp_path / "physics.toml"
    path.write_text(examples.PHYSICS, encoding="utf-8")
    assert PRESETS.given(str(path)).timestep == 0.004
    path = tmp_path / "contacts.json"
    path.write_text(examples.CONTACTS, encoding="utf-8")
    contacts, _ = read_contacts(path)
    assert len(contacts) == 2


def test_long_lists_are_cut_and_short_ones_are_whole() -> None:
    assert examples.shortened({"a": [1, 2, 3], "b": [0.123456] * 9}) == (
        '{\n  "a": [1, 2, 3],\n  "b": [0.1235, 0.1235, ...]\n}'
    )


def as_pattern(template: str) -> str:
    """A template as a pattern: anything may stand where something is put in."""
    template = template.replace(" Did you mean <nearest>?", "<at times>")
    parts = re.split(r"(<[^<>]*>)", template)
    return "".join(".*" if part.startswith("<") else re.escape(part) for part in parts)


def no_hand() -> object:
    return load_hand("alegro_hand")


def no_object() -> object:
    return parse_object("bx")


def too_large() -> object:
    return plan_grasp(GraspTask.create("allegro_hand", "box:0.2x0.2x0.2"))


def no_finger() -> object:
    return GraspTask.create("allegro_hand", "box", fingers=["thumb", "pinky"])


def no_plan() -> object:
    return read_plan("nowhere.json")


def no_physics() -> object:
    return PRESETS.given("nothing")


def no_attempts() -> object:
    return plan_grasp(GraspTask.create("allegro_hand", "box"), max_attempts=0)


def not_closed() -> object:
    from planner.shapes import Mesh

    return Mesh.from_triangles(np.eye(3), np.array([[0, 1, 2]]))


@pytest.mark.parametrize(
    "wrong",
    [no_hand, no_object, too_large, no_finger, no_plan, no_physics, no_attempts, not_closed],
)
def test_a_message_that_is_met_is_found_by_its_text(wrong: Callable[[], object]) -> None:
    with pytest.raises(PlannerError) as caught:
        wrong()
    patterns = [as_pattern(m.text) for m in messages.all_messages()]
    found = [p for p in patterns if len(p) > 20 and re.search(p, str(caught.value), re.DOTALL)]
    assert found, caught.value


COMPOSED = {
    "planner.describe",  # what `check_hand` was told by others
    "planner.forces",  # "<reason>. <remedy>" of what `explain_infeasibility` finds
    "sim.cli",  # "<error>. <advice>" of a search that found nothing, as `advice_for_size` has it
    "planner.tools",  # "<path>: <what is wrong in a tool file>"
    "sim.presets",  # "<path>: <error>"
    "sim.protocols",  # the reason of what was asked of it
}
"""Rooms that raise a message made of others, which are listed themselves."""


@pytest.mark.slow
def test_no_place_that_raises_an_error_is_left_out() -> None:
    listed = {(m.error, m.text) for m in messages.all_messages()}
    for path in messages.modules():
        for message in messages.read(path):
            if (message.error, message.text) not in listed:
                assert message.room in COMPOSED, message
                assert not messages.has_words(message.text)


def test_every_error_class_has_a_page() -> None:
    errors = import_module("planner.errors")
    offered = {name: getattr(errors, name) for name in errors.__all__}
    classes = {name for name, one in offered.items() if isinstance(one, type)}
    assert "PlannerError" in classes and classes <= set(messages.PAGES)
    text = "\n".join(messages.pages().values())
    for message in messages.all_messages():
        assert commands.shown(message.text) in text


def test_a_template_names_what_is_put_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(messages, "ROOT", tmp_path)
    path = tmp_path / "planner" / "made_up.py"
    path.parent.mkdir()
    path.write_text(
        "LIMIT = 3\n"
        "def check(names, self, k):\n"
        "    raise TaskError(f'{self.name!r} has {len(names)} of {LIMIT} {k}: ' + 'give more')\n"
        "def other(what):\n"
        "    text = f'{what} is missing'\n"
        "    raise HandError(text if what else 'nothing')\n",
        encoding="utf-8",
    )
    assert [(m.error, m.text) for m in messages.Reader(path).messages()] == [
        ("TaskError", "<name> has <number of names> of 3 <...>: give more"),
        ("HandError", "<what> is missing"),
        ("HandError", "nothing"),
    ]


def test_every_term_is_explained_on_a_page() -> None:
    assert "```{terms}" in (ROOT / "docs" / "how" / "problem.md").read_text(encoding="utf-8")
    table = terms.table()
    for term in (*TERMS.values(), *MOTION_TERMS):
        row = next(line for line in table.splitlines() if line.startswith(f"| `{term.name}` |"))
        assert row.endswith(f"| {terms.meaning(term)} |")
        assert terms.meaning(term)


def test_every_reason_of_a_trial_is_explained() -> None:
    page = (ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8")
    for reason in REASONS:
        assert not reason or f"| {reason} |" in page
