"""Objects that lie on palm and fingers without closure, turned by contact-implicit control.

One call::

    from sim.palm import reorient_in_palm

    print(reorient_in_palm("allegro_hand", "box:0.05x0.05x0.05", goal).success)

``model`` is the contact model, ``control`` the controller, ``loop`` what looks further ahead.
"""

from sim.palm.report import PalmReport
from sim.palm.run import reorient_in_palm
from sim.palm.settings import PalmSettings

__all__ = ["PalmReport", "PalmSettings", "reorient_in_palm"]
