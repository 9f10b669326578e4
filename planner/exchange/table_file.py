"""Schema of ``table``: poses and joints by names with units, the easy door for every other tool.

One content in three forms:

    .json   this schema, grasp by grasp
    .npz    arrays of the same names, one row per grasp; "" or NaN for what a grasp lacks
    .csv    one row per grasp; units are part of the names of columns, see ``table_forms``

Poses are of ``base_body`` of the hand in the frame of the object's own file; quaternions are
w, x, y, z.
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from planner.schema import StrictData

LENGTHS = {"m": 1.0, "mm": 1e-3}
"""Unit of lengths and of slides -> metres."""

ANGLES = {"rad": 1.0, "deg": 0.017453292519943295}
"""Unit of hinges -> radians."""

PARTS = ("joints", "pregrasp_joints", "squeeze_joints")
"""Fields that hold a number per joint."""

Position = Annotated[tuple[float, float, float], "position"]
Quaternion = Annotated[tuple[float, float, float, float], "quaternion"]


class TableGrasp(StrictData):
    """One grasp.

    Attributes:
        name: What to call it; its row if empty.
        position: Of the hand's body in the object's frame, in the file's unit.
        quaternion_wxyz: Its orientation.
        joints: At the grasp, in the order of ``TableFile.joint_names``.
        pregrasp_joints: Before it.
        squeeze_joints: Commanded to press.
        object: The object's name or path.
        scale: Factor on the object's mesh.
        object_position: Of the object's frame in the world.
        object_quaternion_wxyz: Its orientation.
        confidence: Of whoever made it.
    """

    name: str = ""
    position: Position
    quaternion_wxyz: Quaternion
    joints: tuple[float, ...]
    pregrasp_joints: tuple[float, ...] | None = None
    squeeze_joints: tuple[float, ...] | None = None
    object: str = ""
    scale: Annotated[float, Field(gt=0.0)] = 1.0
    object_position: Position | None = None
    object_quaternion_wxyz: Quaternion | None = None
    confidence: float | None = None


class TableFile(StrictData):
    """A file of grasps.

    Attributes:
        format: What it is.
        version: Of this schema.
        hand: Name of the hand; "" for any.
        base_body: Body whose pose is told; "" for the hand's base.
        length: Unit of positions, and of joints that slide.
        angle: Unit of joints that turn.
        joint_names: Order of the joints.
        slides: Those of them that slide, in the unit of lengths; the others turn.
        grasps: The grasps.
    """

    format: Literal["opposable-grasp-table"] = "opposable-grasp-table"
    version: Literal[1] = 1
    hand: str = ""
    base_body: str = ""
    length: Literal["m", "mm"] = "m"
    angle: Literal["rad", "deg"] = "rad"
    joint_names: tuple[str, ...]
    slides: tuple[str, ...] = ()
    grasps: tuple[TableGrasp, ...]

    @model_validator(mode="after")
    def _same_number(self) -> Self:
        """As many joints as names; whole poses."""
        for i, grasp in enumerate(self.grasps):
            for part in PARTS:
                values = getattr(grasp, part)
                if values is not None and len(values) != len(self.joint_names):
                    raise ValueError(
                        f"grasps.{i}.{part} has {len(values)} numbers for "
                        f"{len(self.joint_names)} joint names"
                    )
            if (grasp.object_position is None) != (grasp.object_quaternion_wxyz is None):
                raise ValueError(f"grasps.{i} has half a pose of the object")
        return self
