"""A page that Opposable wrote, of whatever kind: it is shown as it is."""

from __future__ import annotations

from sim.viewing.kinds import Kind, ViewOptions, WrittenPage
from sim.viewing.target import Target


def _shown(target: Target, options: ViewOptions) -> WrittenPage:
    assert target.path is not None
    return WrittenPage(path=target.path, html=target.content)


KIND = Kind(
    name="a page that Opposable wrote (HTML)",
    recognises=lambda target: target.is_html and target.data is not None,
    shown=_shown,
)
"""See ``sim.viewing.kinds``; asked last: plans and reports are made anew from their pages."""
