"""Scenes for other simulators: the scene of a trial as MJCF, URDF, meshes and numbers.

The scene is that of our trials, with the hand's base fixed, so it is made here and not in
``planner.exchange``. Importing this room registers the format "mjcf-scene"
(``planner.exchange.formats``). ``export_scene(plan, "folder")`` writes one::

    $ python folder/check.py
    held: the object moved 0.04 mm and turned 0.10 deg
"""

from __future__ import annotations

from sim.scene.export.write import MJCF_SCENE, export_scene

__all__ = ["MJCF_SCENE", "export_scene"]
