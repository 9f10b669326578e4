"""The sense ``taxels``: arrays of taxels on the pads, and what follows from their images.

Every step: perfect images from MuJoCo's contacts (``exact``), through noise, threshold, dead
taxels, rate and latency (``layout``), to a contact per pad (``estimate``); from their shiver,
whether it slips (``slip``); from the spread of their shear, the friction (``estimate``). How fast
it slides is seen in the joints (``senses``). A pad feels whatever presses on it, the table too, and
only what presses on its array.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any
from zlib import crc32

import numpy as np

from planner.spatial import FloatArray
from sim.controllers import Observation, PadReading, TouchReading
from sim.sensing.touch.exact import exact_images, layouts_of
from sim.sensing.touch.layout import (
    SHARE,
    ContactEstimate,
    ContactEstimator,
    TaxelArray,
    TaxelFrictionEstimator,
    Texture,
)
from sim.sensing.touch.senses import PadBodies, TouchContext, pad_reading, register_touch
from sim.sensing.touch.slip import TaxelSlipDetector


class TaxelSense:
    """Arrays of taxels during one trial.

    Attributes:
        slips: Which pads slip.
        friction: Their friction, and how much of it is in use.
        estimates: Contacts of the last step, in the frames of the pads' bodies.
        touch: Images of the last step.
        fullest: Images of the last step at which most pads touched.
    """

    def __init__(self, context: TouchContext, texture: float = SHARE) -> None:
        """Nothing has been felt.

        Args:
            context: What it is made from.
            texture: Of the object, see ``Texture``; 0 for a polished one.
        """
        scene, fingers = context.scene, context.plan.task.finger_names
        self._scene, self._data = scene, context.data
        self._layouts = layouts_of(scene, fingers)
        self._bodies = PadBodies.of(scene, context.data, self._layouts)
        streams = np.random.SeedSequence(context.seed, spawn_key=(crc32(b"taxels"),))
        own = [np.random.default_rng(one) for one in streams.spawn(2 * len(fingers))]
        self._arrays = [
            TaxelArray(layout, rng) for layout, rng in zip(self._layouts, own[::2], strict=True)
        ]
        self._textures = [
            Texture(layout.shape, rng, texture)
            for layout, rng in zip(self._layouts, own[1::2], strict=True)
        ]
        self._estimators = [ContactEstimator(layout) for layout in self._layouts]
        self.slips = TaxelSlipDetector(self._layouts)
        self.friction = TaxelFrictionEstimator([one.array.spacing for one in self._layouts])
        self.estimates: tuple[ContactEstimate, ...] = ()
        self.touch = self.fullest = TouchReading.nothing()
        self._most = 0
        self._time = 0.0

    def read(self, truth: Observation) -> Observation:
        """The observation with what the taxels say."""
        elapsed, self._time = truth.time - self._time, truth.time
        for texture, speed in zip(self._textures, truth.pads.sliding_speed.tolist(), strict=True):
            texture.slide(elapsed * speed)
        exact = exact_images(self._scene, self._data, self._layouts, self._textures)
        read = [a.read(truth.time, image) for a, image in zip(self._arrays, exact, strict=True)]
        touch = TouchReading(
            time=np.array([time for time, _ in read]), images=tuple(image for _, image in read)
        )
        self.touch = touch
        self.estimates = tuple(
            e.estimate(image) for e, image in zip(self._estimators, touch.images, strict=True)
        )
        touching = sum(one.normal_force > 0 for one in self.estimates)
        if touching >= max(self._most, 1):
            self._most, self.fullest = touching, touch
        self.slips.step(touch.time, touch.images, self.estimates)
        self.friction.step(elapsed, self.estimates, self.slips.slipping)
        reading = self._reading()
        return replace(
            truth,
            normal_forces=reading.normal_force,
            read_pads=lambda: reading,
            read_touch=lambda: touch,
        )

    def felt(self) -> dict[str, Any]:
        """The images of ``fullest`` as plain data for a report, mN exact; empty without any.

        "time_s" is that of the newest; each pad has the time of its own, as latencies differ.
        """
        touch = self.fullest
        if not touch.images:
            return {}
        return {
            "time_s": float(touch.time.max()),
            "pads": [
                {
                    "finger": one.finger,
                    "spacing_m": one.array.spacing,
                    "time_s": time,
                    "image_N": _plain(image),
                }
                for one, time, image in zip(
                    self._layouts, touch.time.tolist(), touch.images, strict=True
                )
            ],
        }

    def _reading(self) -> PadReading:
        seen = self.estimates
        touching = np.array([one.normal_force > 0 for one in seen])
        turns, places = self._bodies.turns(), self._bodies.places()
        vectors = np.array([[one.point, one.normal, one.force] for one in seen])
        vectors = vectors @ turns.transpose(0, 2, 1)
        position = vectors[:, 0] + places
        stick = 1.0 - self.friction.used
        sliding = self._bodies.sliding(position, vectors[:, 1], touching, stick)
        return pad_reading(
            touching=touching,
            force=vectors[:, 2],
            normal=vectors[:, 1],
            position=position,
            sliding=sliding,
            slipping=self.slips.slipping.copy(),
        )


def _plain(image: FloatArray) -> list[Any]:
    """An image as lists, rounded to 1 mN; no negative zero."""
    rows: list[Any] = (np.round(image, 3) + 0.0).tolist()
    return rows


register_touch("taxels", TaxelSense)
