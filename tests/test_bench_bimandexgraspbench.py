"""BimanDexGraspBench's model taken apart into two hands; masses that are none."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from commands import opposable

from benchmarks.bimandexgraspbench import SLICES, _masses, _one_hand
from planner.errors import TaskError

SIDE = """<body name="{0}a_slide"><joint name="{0}a_x" type="slide" axis="1 0 0"/>
<geom size="0.01"/><body name="{0}h_palm" pos="0 0 0.034">
<geom type="box" size="0.02 0.01 0.05" pos="0.01 0 0.04"/><geom type="box" size="0.01 0.01 0.01"/>
<body name="{0}h_ff" pos="0 0 0.1"><joint name="{0}h_FFJ1" axis="1 0 0"/><geom size="0.01"/></body>
</body></body>"""

MODEL = f"""<mujoco><compiler angle="radian"/><asset/><worldbody>{SIDE.format("r")}
{SIDE.format("l")}</worldbody><contact><exclude body1="rh_palm" body2="rh_ff"/></contact><actuator>
<position joint="ra_x"/><position joint="rh_FFJ1"/><position joint="lh_FFJ1"/></actuator>
</mujoco>"""


@pytest.mark.parametrize(("prefix", "excludes"), [("rh", 1), ("lh", 0)])
def test_a_hand_has_its_joints_servos_and_the_same_solid(
    tmp_path: Path, prefix: str, excludes: int
) -> None:
    path = tmp_path / "two.xml"
    path.write_text(MODEL, encoding="utf-8")
    whole = mujoco.MjModel.from_xml_path(str(path))
    alone = mujoco.MjModel.from_xml_string(_one_hand(path, prefix))
    assert (alone.njnt, alone.nu, alone.nexclude) == (1, 1, excludes)
    assert alone.joint(0).name == f"{prefix}_FFJ1"
    assert alone.ngeom == SLICES + 2  # plate in slices, box, finger
    for name in (f"{prefix}_palm", f"{prefix}_ff"):
        here, there = alone.body(name), whole.body(name)
        np.testing.assert_allclose(here.mass, there.mass, rtol=1e-9)
        np.testing.assert_allclose(here.ipos, there.ipos, atol=1e-12)
        np.testing.assert_allclose(here.inertia, there.inertia, rtol=1e-6)


@pytest.mark.parametrize("text", ["", "a", "0", "-1", "nan", "0.1;3"])
def test_masses_that_are_none_are_refused(text: str) -> None:
    with pytest.raises(TaskError, match="are no masses in kg"):
        _masses(text)
    assert _masses("0.1,3") == [0.1, 3.0]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--masses", "0"), "are no masses in kg"),
        (("nowhere",), "cannot read the manifest of a batch nowhere"),
    ],
)
def test_what_is_refused_ends_before_anything_is_installed(
    words: tuple[str, ...], message: str, tmp_path: Path
) -> None:
    code, _, err = opposable("bench", "bimandexgraspbench", *words, "--home", tmp_path / "home")
    assert code == 3
    assert message in " ".join(err.split())
    assert not (tmp_path / "home").exists()
