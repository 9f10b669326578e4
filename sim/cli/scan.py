"""The command that makes clouds of known objects: ``scan``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from sim.cli.common import check_folder, tell
from sim.cli.options import SCENE, MassOption, ObjectArgument, SeedOption, command, option
from sim.cli.tasks import error_of, length_of, object_of

CAMERA = "Camera"
"""Group of options in the help."""


@command
def scan(
    object: ObjectArgument,
    output: Annotated[Path, option("The cloud.", "FILE", None, "--out", "-o")] = Path("cloud.ply"),
    views: Annotated[int, option("Cameras, around it at equal angles.", "N", CAMERA, min=1)] = 1,
    noise: Annotated[
        str, option("Standard deviation of depth; 0: an ideal camera.", "LENGTH", CAMERA)
    ] = "2mm",
    calibration: Annotated[
        str, option("How far all cameras are off together: 5mm,5 (degrees).", "ERROR", CAMERA)
    ] = "0",
    apart: Annotated[
        str, option("How far each is off beside that, likewise.", "ERROR", CAMERA)
    ] = "0",
    camera: Annotated[
        list[str] | None,
        option("x,y,z of a camera, m, looking at the object; repeatable.", "PLACE", CAMERA),
    ] = None,
    pose: Annotated[int, option("Which of its stable poses it stands in.", "N", SCENE, min=0)] = 0,
    mass: MassOption = None,
    seed: SeedOption = 0,
) -> None:
    """Look at an object on a table with depth cameras; writes a cloud.

    Noise is that of stereo cameras: steps of disparity, bleeding edges, shadows, specks. The file
    says what was there, for trials alone: `run HAND cloud.ply` plans on the points and executes on
    the true object.
    """
    import numpy as np

    from planner.errors import TaskError
    from sim.cli.options import numbers
    from sim.scan import Calibration, look_at, write_scan
    from sim.scan import scan as look

    check_folder(output)
    if output.suffix.lower() != ".ply":
        raise TaskError(f"--out {str(output)!r}: a scan is written as PLY; name it .ply")
    item = object_of(object, mass=mass)
    T_world_object = item.resting_pose(0.0, pose)
    target = T_world_object.translation
    places = tuple(look_at(np.array(numbers("--camera", text, 3)), target) for text in camera or ())
    if places and views != 1:
        raise TaskError("--camera gives the places of cameras, and --views draws them; give one")
    (shift, turn), (own_shift, own_turn) = (
        error_of("--calibration", calibration),
        error_of("--apart", apart),
    )
    found = look(
        item,
        views=places or views,
        noise=length_of("--noise", noise),
        calibration=Calibration(shift=shift, turn=turn, view_shift=own_shift, view_turn=own_turn),
        T_world_object=T_world_object,
        seed=seed,
    )
    write_scan(found, output)
    seen = sum(int(mask.sum()) for mask in found.on_object)
    tell(
        f"written to {output}: {item.name} from {len(found.views)} view(s), {seen} points on it; "
        f"plan on it with: opposable run HAND {output}"
    )
