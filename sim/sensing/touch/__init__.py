"""Tactile pads: arrays of taxels, what follows from their images, and cheaper senses of touch."""

from sim.controllers.base import EXACT
from sim.sensing.touch.effort import BinarySense, EffortSense
from sim.sensing.touch.exact import (
    PadContact,
    contact_image,
    exact_images,
    layouts_of,
    pad_contacts,
    read_touch,
)
from sim.sensing.touch.layout import (
    ContactEstimate,
    ContactEstimator,
    TaxelArray,
    TaxelFrictionEstimator,
    TaxelLayout,
    Texture,
    default_array,
)
from sim.sensing.touch.senses import (
    TOUCH_SENSES,
    ExactSense,
    TouchContext,
    TouchSense,
    check_touch,
    make_sense,
    register_touch,
)
from sim.sensing.touch.slip import TaxelSlipDetector
from sim.sensing.touch.taxels import TaxelSense

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
