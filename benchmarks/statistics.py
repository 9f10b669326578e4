"""Medians, quantiles and exponents of measurements; None where there is nothing to measure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binomtest


def quantile_of(values: Iterable[float], share: float) -> float | None:
    """The value below which a share of them lies, interpolated."""
    known = list(values)
    return float(np.quantile(known, share)) if known else None


def median_of(values: Iterable[float]) -> float | None:
    """The middle one."""
    return quantile_of(values, 0.5)


def ratio(above: float, below: float) -> float | None:
    """A quotient."""
    return above / below if below else None


def wilson(held: int, n: int, confidence: float = 0.95) -> tuple[float, float]:
    """The interval of Wilson about a share of n trials; (0, 1) without any."""
    if n == 0:
        return 0.0, 1.0
    interval = binomtest(held, n).proportion_ci(confidence_level=confidence, method="wilson")
    return float(interval.low), float(interval.high)


def summed(parts: Iterable[Mapping[str, float]]) -> dict[str, float]:
    """Numbers by name, added up, largest first."""
    total: dict[str, float] = {}
    for part in parts:
        for name, value in part.items():
            total[name] = total.get(name, 0) + value
    return dict(sorted(total.items(), key=lambda item: -item[1]))


@dataclass(frozen=True, kw_only=True)
class PowerLaw:
    """y = factor x^exponent, fitted by least squares of the logarithms.

    Attributes:
        exponent: (-).
        factor: In the unit of y.
        spread: Standard deviation of log y about the line: 0.1 means about 10 %.
    """

    exponent: float
    factor: float
    spread: float


def power_law(x: Sequence[float], y: Sequence[float]) -> PowerLaw | None:
    """The power law through points; None for fewer than two different x, or where y is not > 0."""
    points = [(a, b) for a, b in zip(x, y, strict=True) if a > 0 and b > 0]
    if len({a for a, _ in points}) < 2:
        return None
    log_x, log_y = np.log(np.array(points)).T
    exponent, offset = np.polyfit(log_x, log_y, 1)
    left = log_y - exponent * log_x - offset
    return PowerLaw(
        exponent=float(exponent),
        factor=float(np.exp(offset)),
        spread=float(np.sqrt(np.mean(left**2))),
    )
