"""The folder that ``opposable grasp`` writes into where none is named."""

from __future__ import annotations

from planner.objects import parse_object
from planner.system.package import models_dir
from sim.cli import grasp


def test_a_folder_is_named_after_the_sizes_of_an_object() -> None:
    # two boxes of different sizes do not overwrite each other's files
    assert grasp._folder_name(parse_object("box:0.05x0.05x0.08")) == "box-0.05x0.05x0.08"
    assert grasp._folder_name(parse_object("sphere:0.03")) == "sphere-0.03"


def test_a_folder_is_not_named_after_a_path_or_a_very_long_specification() -> None:
    third = repr(1 / 3 / 10)
    long = parse_object(f"box:{third}x{third}x{third}")
    assert len(long.shape.spec) > grasp.LONGEST_NAME
    assert grasp._folder_name(long) == long.name
    mug = parse_object(str(models_dir() / "objects" / "mug.ply"))
    assert "/" in mug.shape.spec
    assert grasp._folder_name(mug) == "mug"
