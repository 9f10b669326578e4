"""Tactile pads: arrays of taxels, what follows from their images, and cheaper senses of touch."""

from sim.controllers.readings import EXACT
from sim.tactile.binary import BinarySense
from sim.tactile.effort import EffortSense
from sim.tactile.estimate import ContactEstimate, ContactEstimator, TaxelFrictionEstimator
from sim.tactile.exact import (
    PadContact,
    contact_image,
    exact_images,
    layouts_of,
    pad_contacts,
    read_touch,
)
from sim.tactile.layout import TaxelArray, TaxelLayout, Texture, default_array
from sim.tactile.senses import (
    TOUCH_SENSES,
    ExactSense,
    TouchContext,
    TouchSense,
    check_touch,
    make_sense,
    register_touch,
)
from sim.tactile.slip import TaxelSlipDetector
from sim.tactile.taxels import TaxelSense

__all__ = [
    "EXACT",
    "TOUCH_SENSES",
    "BinarySense",
    "ContactEstimate",
    "ContactEstimator",
    "EffortSense",
    "ExactSense",
    "PadContact",
    "TaxelArray",
    "TaxelFrictionEstimator",
    "TaxelLayout",
    "TaxelSense",
    "TaxelSlipDetector",
    "Texture",
    "TouchContext",
    "TouchSense",
    "check_touch",
    "contact_image",
    "default_array",
    "exact_images",
    "layouts_of",
    "make_sense",
    "pad_contacts",
    "read_touch",
    "register_touch",
]
