"""``pressure_blocks``: what taxels felt, as a picture per finger, for pages of trials.

Called by the pages of trials and manipulations with the ``reality`` of their report; trials without
taxels have nothing to show.
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping
from html import escape
from typing import Any

import numpy as np

from planner.pages.blocks import Block, Heading, Image, Sentence

CELL, MARGIN, GAP, TEXT = 10, 4, 14, 16
"""Side of a taxel, margin, distance of arrays and height of a line of text, pixels."""

DARK = np.array([13.0, 59.0, 102.0])
"""Colour of the most loaded taxel; one without load is white."""

LEAST_ARROW = 0.02
"""Shear (N) of a taxel from which on an arrow shows it."""


def pressure_blocks(reality: Mapping[str, Any] | None) -> list[Block]:
    """Heading and picture of what taxels felt; nothing where there were none."""
    felt = None if reality is None else reality.get("felt")
    if not felt:
        return []
    source = b64encode(pressure_svg(felt).encode()).decode()
    text = (
        f"Force on each taxel at {felt['time_s']:.2f} s, the last moment at which most pads "
        "touched: normal force by shade, shear by arrows; rows run along the bone, its tip above"
    )
    return [
        Heading(text="Pressure on the pads"),
        Image(source=f"data:image/svg+xml;base64,{source}", text=text),
        Sentence(text="Sums of the taxels; the darkest taxel is the most loaded of its pad."),
    ]


def pressure_svg(felt: Mapping[str, Any]) -> str:
    """The arrays side by side as SVG.

    Args:
        felt: "pads", a list with "finger" and "image_N", (rows, columns, 3).
    """
    x, parts, height = MARGIN, [], 0
    for pad in felt["pads"]:
        image = np.array(pad["image_N"], dtype=np.float64)
        rows, columns = image.shape[:2]
        parts.append(f'<g transform="translate({x},{MARGIN + TEXT})">{_array(image)}</g>')
        label = f"{pad['finger']}: {image[..., 0].sum():.2f} N"
        parts.append(f'<text x="{x}" y="{MARGIN + TEXT - 5}">{escape(label)}</text>')
        x += max(columns * CELL, 11 * CELL) + GAP
        height = max(height, rows * CELL)
    width, tall = x - GAP + MARGIN, height + TEXT + 2 * MARGIN
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {tall}" width="{width}" '
        f'height="{tall}" font-family="sans-serif" font-size="11">'
        f'<rect width="{width}" height="{tall}" fill="white"/>{"".join(parts)}</svg>'
    )


def _array(image: Any) -> str:
    rows, columns = image.shape[:2]
    most = max(float(image[..., 0].max()), 1e-9)
    longest = max(float(np.hypot(image[..., 1], image[..., 2]).max()), 1e-9)
    cells, arrows = [], []
    for row in range(rows):
        y = (rows - 1 - row) * CELL
        for column in range(columns):
            normal, across, along = image[row, column].tolist()
            share = float(np.clip(normal / most, 0.0, 1.0)) ** 0.5
            red, green, blue = (255.0 + share * (DARK - 255.0)).round().astype(int).tolist()
            cells.append(
                f'<rect x="{column * CELL}" y="{y}" width="{CELL - 1}" height="{CELL - 1}" '
                f'fill="rgb({red},{green},{blue})" stroke="#c9d2da" stroke-width="0.5"/>'
            )
            if float(np.hypot(across, along)) >= LEAST_ARROW:
                scale = 1.8 * CELL / longest
                x0, y0 = (column + 0.45) * CELL, y + 0.45 * CELL
                x1, y1 = x0 + scale * across, y0 - scale * along
                arrows.append(
                    f'<path d="M{x0:.1f} {y0:.1f}L{x1:.1f} {y1:.1f}" stroke="#d55e00" '
                    f'stroke-width="1.3"/><circle cx="{x0:.1f}" cy="{y0:.1f}" r="1.3" '
                    'fill="#d55e00"/>'
                )
    return "".join([*cells, *arrows])
