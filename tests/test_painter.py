"""Still pictures without a graphics processor: what is where, what hides what, marks, size."""

from __future__ import annotations

import io

import numpy as np
import pytest
import trimesh
from PIL import Image

from planner.pages.painter import FINGER_COLOURS, FLOOR, data_uri, paint
from planner.pages.scene import IDENTITY_ROW, Actor, Contacts, Joint, Layer, Model, Part, Scene
from planner.spatial import FloatArray

RED, BLUE = (0.9, 0.1, 0.1, 1.0), (0.1, 0.1, 0.9, 1.0)
SIZE, LARGE = (160, 120), (640, 480)
FRONT = (0.0, -1.0, 0.0)
"""The camera is at y < 0: x is to the right, z is up."""


def ball(colour: tuple[float, float, float, float], joint: int = -1, layer: Layer = "hand") -> Part:
    """A ball of 2 cm radius about a joint."""
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=0.02)
    return Part(
        name="ball",
        joint=joint,
        layer=layer,
        vertices=np.asarray(mesh.vertices, np.float64),
        triangles=np.asarray(mesh.faces, np.int64),
        colour=colour,
    )


def scene(*places: tuple[Part, tuple[float, float, float]], **more: object) -> Scene:
    """Parts at places, seen as far as 10 cm about the origin."""
    models = {f"m{k}": Model(joints=(), parts=(part,)) for k, (part, _) in enumerate(places)}
    actors = tuple(
        Actor(name=name, model=name, pose=np.array([*at, 1.0, 0, 0, 0]), q=np.zeros(0))
        for name, (_, at) in zip(models, places, strict=True)
    )
    return Scene(
        models=models,
        actors=actors,
        focus=np.zeros(3),
        radius=0.1,
        time=np.zeros(0),
        **more,  # type: ignore[arg-type]
    )


def pixels(picture: bytes) -> FloatArray:
    """Red, green, blue (height, width, 3), 0 to 255."""
    with Image.open(io.BytesIO(picture)) as image:
        assert image.format == "PNG"
        return np.asarray(image.convert("RGB"), dtype=np.float64)


def middle_of(shown: FloatArray, channel: int) -> FloatArray:
    """Mean column and row of what is mostly of one colour (0: red, 2: blue)."""
    others = np.delete(shown, channel, axis=2).max(axis=2)
    rows, columns = np.nonzero(shown[:, :, channel] > others + 40)
    assert len(rows) > 20
    return np.array([columns.mean(), rows.mean()])


def above_minus_below(shown: FloatArray) -> float:
    """How much brighter, 0 to 255, the upper quarter of a picture is than the lower, in red."""
    height, middle = shown.shape[0], shown.shape[1] // 2
    return float(shown[height // 4, middle, 0] - shown[3 * height // 4, middle, 0])


def test_right_is_right_and_up_is_up() -> None:
    shown = pixels(paint(scene((ball(RED), (-0.05, 0, 0)), (ball(BLUE), (0.05, 0, 0.02))), FRONT))
    red, blue = middle_of(shown, 0), middle_of(shown, 2)
    assert red[0] < blue[0]
    assert red[1] > blue[1]  # rows are counted from above
    behind = pixels(
        paint(scene((ball(RED), (-0.05, 0, 0)), (ball(BLUE), (0.05, 0, 0))), (0.0, 1.0, 0.0))
    )
    assert middle_of(behind, 0)[0] > middle_of(behind, 2)[0]


@pytest.mark.parametrize(("near", "far", "channel"), [(RED, BLUE, 0), (BLUE, RED, 2)])
def test_what_is_nearer_hides_what_is_behind(
    near: tuple[float, float, float, float], far: tuple[float, float, float, float], channel: int
) -> None:
    for order in (1, -1):  # whatever the order of the actors
        places = [(ball(near), (0.0, -0.05, 0.0)), (ball(far), (0.0, 0.05, 0.0))][::order]
        shown = pixels(paint(scene(*places), FRONT, size=SIZE))
        centre = shown[SIZE[1] // 2, SIZE[0] // 2]
        assert centre[channel] > np.delete(centre, channel).max() + 40


def test_joints_turn_what_they_carry() -> None:
    placement = np.array([0.0, 0, 0, 1, 0, 0, 0])
    turn = Joint(
        name="turn",
        parent=-1,
        placement=placement,
        axis=np.array([0.0, 1.0, 0.0]),
        kind="hinge",
        lower=-4.0,
        upper=4.0,
    )
    slide = Joint(
        name="slide",
        parent=0,
        placement=placement,
        axis=np.array([1.0, 0.0, 0.0]),
        kind="slide",
        lower=-1.0,
        upper=1.0,
    )
    model = Model(joints=(turn, slide), parts=(ball(RED, joint=1), ball(BLUE)))
    for angle, (dx, dz) in ((0.0, (1, 0)), (np.pi / 2, (0, -1)), (np.pi, (-1, 0))):
        actor = Actor(name="a", model="m", pose=IDENTITY_ROW, q=np.array([angle, 0.06]))
        moved = Scene(
            models={"m": model}, actors=(actor,), focus=np.zeros(3), radius=0.1, time=np.zeros(0)
        )
        shown = pixels(paint(moved, FRONT))
        step = middle_of(shown, 0) - middle_of(shown, 2)
        assert np.allclose(step / np.linalg.norm(step), [dx, -dz], atol=0.05)
        wide = np.ptp(np.nonzero(shown[:, :, 0] > shown[:, :, 2] + 40)[1])  # a ball of 4 cm
        assert np.linalg.norm(step) / wide == pytest.approx(0.06 / 0.04, rel=0.1)


def test_layers_that_start_off_and_the_other_side_of_triangles_are_not_painted() -> None:
    shown = pixels(
        paint(scene((ball(RED), (0, 0, 0)), (ball(BLUE, layer="collision"), (0, -0.05, 0))), FRONT)
    )
    assert (shown[:, :, 2] <= shown[:, :, 0] + 20).all()
    part = ball(RED)
    inside_out = Part(
        name="b",
        joint=-1,
        layer="hand",
        vertices=part.vertices,
        triangles=part.triangles[:, ::-1],
        colour=RED,
    )
    towards = pixels(paint(scene((part, (0, 0, 0))), FRONT))
    away = pixels(paint(scene((inside_out, (0, 0, 0))), FRONT))
    # light comes from above: it falls on the upper part outside, and on the lower part inside
    assert above_minus_below(towards) > 20
    assert above_minus_below(away) < -20


def contacts(normal: tuple[float, float, float]) -> Contacts:
    """One contact at the origin."""
    return Contacts(
        name="planned",
        layer="planned contacts",
        fingers=("thumb",),
        points=np.zeros((1, 1, 3)),
        normals=np.array(normal).reshape(1, 1, 3),
        forces=np.zeros((1, 1, 3)),
        mu=0.5,
    )


def test_contacts_are_marked_and_hollow_where_the_surface_faces_away() -> None:
    part = (ball(BLUE), (0.0, 0.0, 0.0))
    for normal, inner in (((0.0, 1.0, 0.0), FINGER_COLOURS[0]), ((0.0, -1.0, 0.0), (255,) * 3)):
        shown = pixels(paint(scene(part, contacts=(contacts(normal),)), FRONT, size=LARGE))
        assert np.abs(shown[LARGE[1] // 2, LARGE[0] // 2] - inner).max() < 40


def test_a_finger_that_does_not_touch_has_no_mark() -> None:
    apart = contacts((0.0, 1.0, 0.0))
    lifted = Contacts(
        name="planned",
        layer="planned contacts",
        fingers=apart.fingers,
        points=np.full((1, 1, 3), np.nan),
        normals=apart.normals,
        forces=apart.forces,
        mu=0.5,
    )
    part = (ball(BLUE), (0.0, 0.0, 0.0))
    assert paint(scene(part, contacts=(lifted,)), FRONT) == paint(scene(part), FRONT)


def test_a_table_is_below_everything_on_it() -> None:
    box = trimesh.creation.box(extents=(1.0, 1.0, 0.02))
    table = Part(
        name="table",
        joint=-1,
        layer="table",
        vertices=np.asarray(box.vertices, np.float64),
        triangles=np.asarray(box.faces, np.int64),
        colour=(0.5, 0.5, 0.5, 1.0),
    )
    shown = pixels(
        paint(scene((ball(RED), (0, 0, 0)), (table, (0, 0, -0.03))), (0.0, -1.0, 0.5), size=SIZE)
    )
    near_floor = np.abs(shown - FLOOR).max(axis=2) < 12
    assert near_floor.mean() > 0.1
    assert not near_floor[SIZE[1] // 2, SIZE[0] // 2]


def test_the_same_scene_gives_the_same_small_picture() -> None:
    places = [(ball(RED), (0.03 * k - 0.09, 0.0, 0.0)) for k in range(7)]
    picture = paint(scene(*places), (0.5, -1.0, 0.5))
    assert picture == paint(scene(*places), (0.5, -1.0, 0.5))
    assert len(picture) < 15_000
    assert data_uri(picture).startswith("data:image/png;base64,iVBOR")
