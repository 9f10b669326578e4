"""MJCF text for the MuJoCo that DexGraspBench pins, 3.3.2, out of what a newer MuJoCo writes.

MuJoCo refuses a whole file for one attribute that it does not know, so what is written is checked
against a list of what 3.3.2 knows (from its own ``mj_printSchema``), for the elements of a hand.
Elements of the world rather than the hand (options, visuals, sensors, key frames) are left out: the
benchmark sets its own.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from planner.errors import ModelError, shown

PINNED = "3.3.2"
"""MuJoCo's version in the benchmark's README at commit 1e7a5a6."""

_PLACE = "axisangle euler pos quat xyaxes zaxis"
_LIMIT = (
    "class damping frictionloss group limited margin name range solimpfriction solimplimit "
    "solreffriction solreflimit stiffness user"
)
_FORCE_LIMIT = "actuatorfrclimited actuatorfrcrange armature"
_EQUALITY = "active class name solimp solref"

_KNOWN: Mapping[str, str] = MappingProxyType(
    {
        "mujoco": "model",
        "compiler": (
            "alignfree angle assetdir autolimits balanceinertia boundinertia boundmass coordinate "
            "discardvisual eulerseq fitaabb fusestatic inertiafromgeom inertiagrouprange meshdir "
            "saveinertial settotalmass strippath texturedir usethread"
        ),
        "default": "class",
        "asset": "",
        "mesh": (
            "class content_type face file inertia maxhullvert name normal refpos refquat scale "
            "smoothnormal texcoord vertex"
        ),
        "material": (
            "class emission metallic name reflectance rgba roughness shininess specular texrepeat "
            "texuniform"
        ),
        "worldbody": "",
        "body": f"childclass gravcomp mocap name user {_PLACE}",
        "inertial": f"diaginertia fullinertia mass {_PLACE}",
        "joint": (
            f"{_FORCE_LIMIT} {_LIMIT} actuatorgravcomp axis pos ref springdamper springref type "
            "active joint1 joint2 polycoef solimp solref coef joint"
        ),
        "geom": (
            "class conaffinity condim contype density fitscale fluidcoef fluidshape friction "
            "fromto gap group margin mass material mesh name priority rgba shellinertia size "
            f"solimp solmix solref type user geom sidesite {_PLACE}"
        ),
        "site": f"class fromto group material name rgba size type user site {_PLACE}",
        "contact": "",
        "pair": ("class condim friction gap geom1 geom2 margin name solimp solref solreffriction"),
        "exclude": "body1 body2 name",
        "equality": "active solimp solref",
        "connect": f"anchor body1 body2 site1 site2 {_EQUALITY}",
        "weld": f"anchor body1 body2 relpose site1 site2 torquescale {_EQUALITY}",
        "tendon": f"{_LIMIT} material rgba springlength width polycoef tendon1 tendon2 {_EQUALITY}",
        "spatial": f"{_FORCE_LIMIT} {_LIMIT} material rgba springlength width",
        "fixed": f"{_FORCE_LIMIT} {_LIMIT} springlength",
        "pulley": "divisor",
        "actuator": "",
        "general": (
            "actdim actearly actlimited actrange biasprm biastype body class cranklength cranksite "
            "ctrllimited ctrlrange dynprm dyntype forcelimited forcerange gainprm gaintype gear "
            "group joint jointinparent lengthrange name refsite site slidersite tendon user"
        ),
    }
)
"""Element -> attributes that 3.3.2 knows. Elements of one name in several places share a line."""

_WORLD = frozenset(
    {
        "camera",
        "custom",
        "keyframe",
        "layer",
        "light",
        "option",
        "sensor",
        "size",
        "skin",
        "statistic",
        "texture",
        "visual",
    }
)
"""Elements that say nothing of the hand's motion or contacts, left out."""

_HARMLESS: Mapping[str, frozenset[str]] = MappingProxyType(
    {
        # in 4.0 a note on what ctrl means; the force follows from gain and bias alone
        "general": frozenset({"input"}),
        "geom": frozenset({"castshadow"}),
        "material": frozenset({"texture"}),
    }
)
"""Attributes that change neither motion nor contact, left out; others are refused."""

_ONE_NUMBER = ("damping", "stiffness")
"""Attributes that hold a polynomial in MuJoCo 4 and one number in 3.3.2."""


def pinned_mjcf(text: str, hand: str, files: Mapping[str, Path] | None = None) -> str:
    """MJCF that MuJoCo 3.3.2 reads.

    Args:
        text: MJCF as a newer MuJoCo writes it.
        hand: What the hand is called, for messages.
        files: Name of a mesh file in the text -> the file that the result names instead, relative
            to the folder "assets" beside it; no mesh files if None.

    Raises:
        ModelError: The model needs what 3.3.2 does not have.
    """
    root = ET.fromstring(text)
    _drop_world(root)
    for element in root.iter():
        _check(element, hand)
        if element.tag == "compiler":
            for name in ("meshdir", "texturedir", "assetdir"):
                element.attrib.pop(name, None)
            if files:
                element.set("meshdir", "assets")
        if element.tag == "mesh" and "file" in element.attrib:
            element.set("file", str((files or {})[element.attrib["file"]]))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _drop_world(element: ET.Element) -> None:
    """Leave out elements of the world, at any depth."""
    for child in list(element):
        if child.tag in _WORLD:
            element.remove(child)
        else:
            _drop_world(child)


def _check(element: ET.Element, hand: str) -> None:
    """Drop harmless attributes of an element and refuse what 3.3.2 does not know."""
    if element.tag not in _KNOWN:
        raise ModelError(
            f"the model of {hand} has an element <{element.tag}>; DexGraspBench pins MuJoCo "
            f"{PINNED}, for which the export writes no such element: take it out of the model"
        )
    known = _KNOWN[element.tag].split()
    for name in list(element.attrib):
        if name in _HARMLESS.get(element.tag, frozenset()):
            del element.attrib[name]
        elif name not in known:
            raise ModelError(
                f"<{element.tag}> of {hand} has {name}={shown(element.attrib[name])}, which MuJoCo "
                f"{PINNED} does not know, and DexGraspBench pins it: take it out of the model"
            )
    for name in _ONE_NUMBER:
        if len(element.attrib.get(name, "0").split()) > 1:
            raise ModelError(
                f"<{element.tag}> of {hand} has {name}={shown(element.attrib[name])}; MuJoCo "
                f"{PINNED}, which DexGraspBench pins, takes one number: give a linear law"
            )
