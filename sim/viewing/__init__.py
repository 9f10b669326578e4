"""Viewing: what ``opposable view`` shows in the browser, and the local server behind it.

``kinds`` recognises what was named, by its content; each kind of thing is one module. ``opening``
brings the result to a browser.
"""

from sim.viewing.kinds import Kind, Target, ViewOptions, recognise, register_kind
from sim.viewing.opening import Answer, LocalServer, Opening, Site, show, warnings_of

__all__ = [
    "Answer",
    "Kind",
    "LocalServer",
    "Opening",
    "Site",
    "Target",
    "ViewOptions",
    "recognise",
    "register_kind",
    "show",
    "warnings_of",
]
