"""What is viewed by name or model: a hand with sliders and findings, an object or mesh."""

from __future__ import annotations

import struct

from planner.describe import check_hand, propose
from planner.errors import ObjectError
from planner.hand_loading import load_hand
from planner.hands.catalog import MODEL_SUFFIXES, find_hand, foreign_hand_names, hand_names
from planner.objects import TouchRegion, object_names, parse_object, parse_region
from planner.pages.described import comments_of, reasons_by_key
from planner.pages.hand_page import hand_page
from planner.pages.mesh_page import mesh_page
from planner.pages.page import Page
from planner.shapes.meshes.io import CONVERTIBLE, MESH_SUFFIXES
from sim.show.targets import Kind, Target, ViewOptions

SCHEMES = ("menagerie:", "robot_descriptions:", "package:")
"""Beginnings of names of models in packages."""

DESCRIPTION_FILE = "hand.toml"

ROOTS = (b"<mujoco", b"<robot")
"""Root elements of models, MJCF and URDF."""


def _is_hand(target: Target) -> bool:
    if target.text in (*hand_names(), *foreign_hand_names()):
        return True
    if target.path is None:
        return target.text.startswith(SCHEMES)
    if target.is_folder:
        return target.holds(DESCRIPTION_FILE)
    if target.names_body:
        return False
    return any(root in target.head for root in ROOTS) or "schema" in (target.table or {})


def _hand_page(target: Target, options: ViewOptions) -> Page:
    hand, path = load_hand(target.text), find_hand(target.text)
    if path.suffix.lower() in MODEL_SUFFIXES:
        proposal = propose(target.text)
        reasons, questions = reasons_by_key(proposal.reasons), proposal.open_questions
    else:
        reasons, questions = comments_of(path), ()
    return hand_page(hand, reasons=reasons, questions=questions, check=check_hand(hand))


HAND = Kind(name="a hand (name, hand.toml, MJCF or URDF)", recognises=_is_hand, shown=_hand_page)
"""See ``sim.show.targets``."""


def _is_mesh(target: Target) -> bool:
    if target.path is None:
        return target.text.lower().partition(":")[0].strip() in object_names()
    if target.names_body:
        return True
    return target.is_file and (_format(target) != "" or _suffix(target) in CONVERTIBLE)


def _suffix(target: Target) -> str:
    return "" if target.path is None else target.path.suffix.lower()


def _format(target: Target) -> str:
    """The suffix that the content of a mesh file asks for; "" for a file of something else."""
    head = target.head
    if head.startswith((b"ply\n", b"ply\r")):
        return ".ply"
    if head.startswith(b"glTF"):
        return ".glb"
    if head.lstrip().startswith(b"solid") and b"facet" in head:
        return ".stl"
    if len(head) >= BINARY_STL and target.path is not None:
        (triangles,) = struct.unpack_from("<I", head, BINARY_STL - 4)
        if target.path.stat().st_size == BINARY_STL + 50 * triangles:
            return ".stl"
    whole = head[: head.rfind(b"\n")]  # the last line may be cut
    starts = {line.split(maxsplit=1)[0] for line in whole.splitlines() if line.strip()}
    if b"v" in starts and all(word in OBJ_WORDS or word.startswith(b"#") for word in starts):
        return ".obj"
    return _suffix(target) if _suffix(target) in MESH_SUFFIXES else ""


BINARY_STL = 84
"""Bytes before the triangles of a binary STL file, the count of triangles at their end."""

OBJ_WORDS = frozenset(
    (b"v", b"vn", b"vt", b"vp", b"f", b"l", b"p", b"o", b"g", b"s", b"usemtl", b"mtllib")
)
"""Words with which lines of an OBJ file begin."""


def _mesh_page(target: Target, options: ViewOptions) -> Page:
    wanted = _format(target) if target.is_file and not target.names_body else ""
    if wanted and _suffix(target) != wanted and _suffix(target) not in CONVERTIBLE:
        raise ObjectError(
            f"{target.path} holds a mesh of the format {wanted} and is named otherwise; rename it "
            f"to end in {wanted}"
        )
    touch = None
    if options.touch or options.avoid:
        touch = TouchRegion(
            allowed=tuple(parse_region(text) for text in options.touch),
            forbidden=tuple(parse_region(text) for text in options.avoid),
        )
    item = parse_object(target.text, repair=options.repair, strict=options.strict, touch=touch)
    return mesh_page(item, spec=target.text, touch=options.touch, avoid=options.avoid)


MESH = Kind(
    name="an object or mesh (mug, box:0.05x0.05x0.08, part.stl*0.001, scene.xml#body)",
    recognises=_is_mesh,
    shown=_mesh_page,
    takes=frozenset({"touch", "avoid", "repair", "strict"}),
)
"""See ``sim.show.targets``."""
