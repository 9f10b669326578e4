"""Models of hands, MJCF and URDF, with hostile numbers, names and structure."""

from __future__ import annotations

from pathlib import Path
from random import Random

from ..hostile import damaged, number_text, replaced_numbers
from ..samples import Samples

COMMANDS: tuple[tuple[str, list[str]], ...] = (
    ("hands", ["--check"]),
    ("hands", []),
    ("hands", ["--describe"]),
    ("crosscheck", ["--no-own-reader", "--configurations", "1"]),
)


def case(rng: Random, samples: Samples) -> list[str]:
    del samples
    urdf = rng.random() < 0.4
    text = _urdf(rng) if urdf else mjcf(rng)
    for old, new in rng.sample(SWAPS, rng.choice([0, 0, 1])):
        text = text.replace(old, new, 1)
    text = replaced_numbers(text, rng, rng.choice([0, 1, 1, 2, 3]))
    content = text.encode(errors="replace")
    if rng.random() < 0.1:
        content = damaged(content, rng)
    path = Path("hand.urdf" if urdf else "hand.xml")
    path.write_bytes(content)
    command, more = rng.choice(COMMANDS)
    return [command, str(path), *more]


SWAPS = [
    ("<mujoco", "<!DOCTYPE a [<!ENTITY b SYSTEM 'file:///etc/passwd'>]><mujoco"),
    ("</worldbody>", '<body name="flying"><freejoint/><geom size=".01"/></body></worldbody>'),
    ("<worldbody>", '<worldbody><include file="hand.xml"/>'),
    ('type="hinge"', 'type="ball"'),
    ('type="hinge"', 'type="slide"'),
    ('name="f0_0"', 'name="f1_0"'),
    ('name="f0_0"', 'name="' + "x" * 3000 + '"'),
    ("</actuator>", '<motor joint="f0_0"/></actuator>'),
    ("</robot>", "</robot></robot>"),
    ('<link name="f0_0">', '<link name="palm">'),
    ('type="capsule"', 'type="mesh"'),
    ("<mujoco", '<mujoco model="../../../x"'),
]


def _numbers(rng: Random, *sound: float) -> str:
    """Numbers as an attribute, now and then one of them hostile."""
    values = [f"{v:g}" for v in sound]
    if rng.random() < 0.03:
        values[rng.randrange(len(values))] = number_text(rng).replace('"', "").replace("<", "")
    return " ".join(values)


def mjcf(rng: Random) -> str:
    fingers, joints = rng.choice([2, 3, 3]), rng.choice([2, 3])
    bodies, motors = [], []
    for f in range(fingers):
        text, end = "", ""
        for k in range(joints):
            x = 0.03 * (f - 1) if k == 0 else 0.0
            text += (
                f'<body name="f{f}_{k}" pos="{_numbers(rng, x, 0, 0.05 if k else 0.02)}">'
                f'<joint name="f{f}_{k}" type="hinge" axis="{_numbers(rng, 0, 1, 0)}" '
                f'range="{_numbers(rng, -0.2, 1.6)}" damping="{_numbers(rng, 0.01)}"/>'
                f'<geom name="f{f}_{k}" type="capsule" size="{_numbers(rng, 0.008)}" '
                f'fromto="{_numbers(rng, 0, 0, 0, 0, 0, 0.05)}" mass="{_numbers(rng, 0.03)}"/>'
            )
            end += "</body>"
            motors.append(
                f'<position joint="f{f}_{k}" kp="{_numbers(rng, 2)}" '
                f'ctrlrange="{_numbers(rng, -0.2, 1.6)}" forcerange="{_numbers(rng, -1, 1)}"/>'
            )
        bodies.append(text + end)
    return (
        '<mujoco><compiler angle="radian"/><worldbody><body name="palm">'
        f'<geom type="box" size="{_numbers(rng, 0.04, 0.04, 0.015)}" mass="0.4"/>'
        + "".join(bodies)
        + f"</body></worldbody><actuator>{''.join(motors)}</actuator></mujoco>"
    )


def _urdf(rng: Random) -> str:
    inertial = (
        '<inertial><mass value="{}"/><inertia ixx="{}" ixy="0" ixz="0" iyy="1e-5" iyz="0" '
        'izz="1e-5"/></inertial>'
    )
    parts = [
        f'<link name="palm">{inertial.format(_numbers(rng, 0.4), _numbers(rng, 1e-5))}<collision>'
        f'<geometry><box size="{_numbers(rng, 0.08, 0.08, 0.03)}"/></geometry></collision></link>'
    ]
    for f in range(3):
        for k in range(2):
            parent = "palm" if k == 0 else f"f{f}_{k - 1}"
            x = 0.03 * (f - 1) if k == 0 else 0.0
            mimic = rng.choice(["", "", "", f'<mimic joint="f{f}_0" multiplier="0.8"/>'])
            parts.append(
                f'<link name="f{f}_{k}">{inertial.format(_numbers(rng, 0.03), 1e-5)}<collision>'
                f'<origin xyz="{_numbers(rng, 0, 0, 0.025)}"/><geometry>'
                f'<cylinder radius="{_numbers(rng, 0.008)}" length="{_numbers(rng, 0.05)}"/>'
                f'</geometry></collision></link><joint name="j{f}_{k}" type="revolute">'
                f'<parent link="{parent}"/><child link="f{f}_{k}"/>'
                f'<origin xyz="{_numbers(rng, x, 0, 0.05)}"/><axis xyz="{_numbers(rng, 0, 1, 0)}"/>'
                f'<limit lower="{_numbers(rng, 0)}" upper="{_numbers(rng, 1.6)}" '
                f'effort="{_numbers(rng, 1)}" velocity="1"/>{mimic if k else ""}</joint>'
            )
    return f'<?xml version="1.0"?><robot name="hand">{"".join(parts)}</robot>'
