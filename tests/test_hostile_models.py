"""Models and descriptions that cannot be: each is refused by name before anything measures it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from test_describe import claw, urdf, written
from typer.testing import CliRunner

from planner.bridge import load_spec
from planner.describe import propose
from planner.errors import HandError, ModelError, NotFoundError, PlannerError
from planner.hand_loading import hand_from_spec, load_hand
from planner.joints.description import HandDescription
from sim.cli import app
from sim.cli.common import EXIT_BAD_INPUT

pytestmark = pytest.mark.usefixtures("brief_postures")

EditHand = Callable[..., Path]

TIE = (
    '<tendon><fixed name="tie" limited="true" range="0.5 1"><joint joint="thumb_a" coef="{}"/>'
    "</fixed></tendon><actuator>"
)

MJCF = {
    "an endless size": ('size="0.011" mass="0.005"', 'size="inf" mass="0.005"', "size of geom"),
    "a huge size": ('size="0.011"', 'size="99999999999"', "size of geom 'thumb_ball' holds 1e"),
    "a size in millimetres": ('size="0.011"', 'size="11"', "allowed are numbers up to 10"),
    "an axis of NaN": ('axis="0 1 0"', 'axis="nan 1 0"', "axis of joint 'thumb_a' holds nan"),
    "a position of NaN": ('pos="0 0 0.05"', 'pos="0 nan 0.05"', "position of body 'thumb_b'"),
    "an orientation of NaN": ('euler="0 0 0.0"', 'euler="0 0 nan"', "orientation of body"),
    "a link of 1e11 kg": ('mass="0.02"', 'mass="1e11"', "mass of geom 'thumb_b' holds 1e\\+11"),
    "a link of a ton": ('mass="0.02"', 'mass="1100"', "mass of body 'thumb_b' holds 1100"),
    "a negative kp": ('kp="4"', 'kp="-1"', "kp = -1 .* drives its joint away"),
    "an endless kp": ('kp="4"', 'kp="inf"', "gain of actuator"),
    "a range of NaN": ('range="-0.6 1.4"', 'range="nan 1.4"', "range of joint 'thumb_a'"),
    "an endless range": ('range="-0.6 1.4"', 'range="-inf inf"', "range of joint 'thumb_a'"),
    "a force of NaN": ('forcerange="-1 1"', 'forcerange="nan 1"', "NaN in its forcerange"),
    "a command of NaN": ('ctrlrange="-1 2"', 'ctrlrange="nan 2"', "NaN in its forcerange or ctrl"),
    "a huge damping": ('axis="0 1 0"', 'axis="0 1 0" damping="1e300"', "damping of joint"),
    "an armature of NaN": ('axis="0 1 0"', 'axis="0 1 0" armature="nan"', "armature of joint"),
    "endless friction": ('axis="0 1 0"', 'axis="0 1 0" frictionloss="inf"', "frictionloss of"),
    "a coefficient of NaN": ("<actuator>", TIE.format("nan"), "tendon 'tie' has the coefficient"),
    "a coefficient of 0": ("<actuator>", TIE.format("0"), "tendon tie acts on no joint"),
}


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> HandDescription:
    """The description of the claw that the models below are not."""
    return propose(written(tmp_path_factory.mktemp("sound"), claw())).description


@pytest.mark.parametrize("kind", MJCF)
def test_numbers_of_no_hand_are_refused_by_name(
    kind: str, tmp_path: Path, sound: HandDescription
) -> None:
    old, new, message = MJCF[kind]
    text = claw()
    assert old in text
    path = written(tmp_path, text.replace(old, new, 1))
    with pytest.raises(ModelError, match=message):
        propose(path)
    # and where somebody describes it by hand
    with pytest.raises(PlannerError):
        hand_from_spec(load_spec(path), sound)


URDF = {
    "a huge radius": ('radius="0.011"', 'radius="1e308"', ModelError, "size of geom"),
    "a collision at NaN": (
        '<origin xyz="0 0 0.03"/>',
        '<origin xyz="nan nan nan"/>',
        ModelError,
        "position of geom",
    ),
    "a link of 1e11 kg": ('mass value="0.02"', 'mass value="1e11"', ModelError, "mass of body"),
    "a link of 1e308 kg": ('mass value="0.02"', 'mass value="1e308"', ModelError, "mass of body"),
    "two joints of one name": (
        '<joint name="f2.0"',
        '<joint name="f1.0"',
        ModelError,
        r"has 2 joints called 'f1\.0' \(repeated name\)",
    ),
    "a mimic of no joint": (
        '<axis xyz="0 1 0"/>',
        '<axis xyz="0 1 0"/><mimic joint="f1_1" multiplier="0.5"/>',
        NotFoundError,
        r"'f1\.0' can mimic is called 'f1_1'\. Did you mean 'f1\.1'\?",
    ),
    "a mimic of itself": (
        '<axis xyz="0 1 0"/>',
        '<axis xyz="0 1 0"/><mimic joint="f1.0"/>',
        ModelError,
        r"'f1\.0' mimics itself",
    ),
    "a multiplier of NaN": (
        '<axis xyz="0 1 0"/>',
        '<axis xyz="0 1 0"/><mimic joint="f1.1" multiplier="nan"/>',
        ModelError,
        "has the coefficient nan",
    ),
}


@pytest.mark.parametrize("kind", URDF)
def test_urdfs_that_do_not_say_what_they_mean_are_refused(kind: str, tmp_path: Path) -> None:
    old, new, error, message = URDF[kind]
    text = urdf()
    assert old in text
    with pytest.raises(error, match=message):
        propose(written(tmp_path, text.replace(old, new, 1), "claw.urdf"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<mujocoinclude><option/></mujocoinclude>", "fragment: give the file that includes it"),
        (
            "<mujoco><worldbody><body>" + 2 * '<inertial pos="0 0 0" mass="1"/>' + "</body>"
            "</worldbody></mujoco>",
            "'inertial'.*; keep one of them",
        ),
    ],
)
def test_a_fragment_and_a_repeated_element_are_told_what_to_do(
    text: str, message: str, tmp_path: Path
) -> None:
    with pytest.raises(ModelError, match=message):
        load_spec(written(tmp_path, text, "part.xml"))


def test_a_mimic_in_a_comment_and_the_joints_of_a_transmission_do_not_count(tmp_path: Path) -> None:
    more = (
        '<!-- <mimic joint="gone"/> --><transmission name="t"><joint name="f1.0"/>'
        '<actuator name="m"/></transmission></robot>'
    )
    text = urdf(mimic=True).replace("</robot>", more)
    assert len(load_spec(written(tmp_path, text, "claw.urdf")).equalities) == 3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[[couplings]]\nname = 'c'\njoints = {thumb_0 = 0.0}\nkind = 'equality'", "coefficients"),
        ("[[couplings]]\nname = 'c'\njoints = {thumb_0 = 1e300}\nkind = 'stop'", "coefficients"),
        ("[[actuators]]\njoints = ['thumb_0']\nkp = inf\nforce_limit = 1.0", "kp"),
        ("[[actuators]]\njoints = ['thumb_0']\nkp = 1.0\nforce_limit = inf", "force_limit"),
        ("[joint_defaults]\ndamping = inf", "damping"),
        ("[joint_defaults]\nleast_armature = nan", "least_armature"),
    ],
)
def test_descriptions_with_numbers_that_cannot_be(
    text: str, message: str, edit_hand: EditHand
) -> None:
    path = edit_hand()
    path.write_text(path.read_text(encoding="utf-8") + "\n" + text + "\n", encoding="utf-8")
    with pytest.raises(HandError, match=message):
        load_hand(path)


@pytest.mark.parametrize("command", ["--describe", "--check"])
def test_the_commands_end_with_the_code_of_bad_input(command: str, tmp_path: Path) -> None:
    path = written(tmp_path, claw().replace('axis="0 1 0"', 'axis="nan 1 0"', 1))
    result = CliRunner().invoke(app, ["hands", str(path), command])
    assert result.exit_code == EXIT_BAD_INPUT
    assert "axis of joint" in " ".join(result.output.split())
