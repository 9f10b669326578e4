"""Arrays of taxels: where they are, how their images are disturbed, what an image tells.

``TaxelLayout``: where the taxels of a pad are and which way they face.

A pad is a sphere. Its array is a square grid in the chart of the sphere that keeps distances from
the middle (azimuthal equidistant): the taxel at (u, v) lies in the direction of (u, v) from the
middle, at the arc length sqrt(u^2 + v^2). v runs along the bone, u around it. Whoever reads or
estimates images takes places and axes from here.

``TaxelArray``: an array with noise, threshold, dead taxels, rate and latency.

Turns perfect images into those that arrive. Called by the sense ``taxels`` once a time step.

``Texture``: how a rough surface that slides over a pad makes its taxels shiver.

Sliding is felt through the unevenness of what slides: asperities load now this spot of the skin and
now that one (R. D. Howe and M. R. Cutkosky, Sensing skin acceleration for slip and texture
perception, ICRA 1989; M. R. Tremblay and M. R. Cutkosky, Estimating friction using incipient slip
sensing during a manipulation task, ICRA 1993). MuJoCo's contacts are smooth, so this is a model of
its own: the force on each taxel is larger or smaller by a share with standard deviation ``SHARE``,
which forgets its value over a slid distance ``LENGTH`` and stays as it is while the pad sticks or
rolls. The force of the whole contact stays what it is. A polished object has none of it
(``share`` 0): then only joints tell that a pad slips.

``ContactEstimator``: place, normal, force and torsion of a contact from an image of taxels.

What it knows is the layout: no joint, no object, no contact of the simulator. Dead taxels, which a
driver knows, are filled with the mean of their live neighbours. The place is the centroid of the
normal force in the chart of the pad; the force is the sum over the taxels, each in its own axes;
the normal is that of the pad's sphere there. Who has the pose of the pad's body turns it all into
the world (``sim.sensing.touch.taxels``).

``TaxelFrictionEstimator``: the friction of n pads, from how far their shear spreads.

Where a share (used) of the friction cone is in use, the shear is spread wider than the pressure by
(1 - (1 - used)^(5/3)) / used, 5/3 at no load and 1 at the edge (``sim.sensing.touch.exact``). With
the measured ratio r of tangential to normal force, used = r / mu: each image makes some mu likelier
than others. Their likelihoods are kept on a grid of mu and forgotten over ``MEMORY``. What slips
has all of its friction in use: r is mu then.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from planner.joints.description import FingerDescription, PadDescription, TaxelDescription
from planner.spatial import FloatArray

DEFAULT_SPACING = 0.002
"""Spacing (m) of an array that no ``hand.toml`` describes."""

SMALL = 1e-12
"""Lengths and sines below this are 0: rounding."""


def default_array(pad: PadDescription) -> TaxelDescription:
    """An array 2 mm apart that covers the cone within which contacts may roll."""
    half = math.radians(pad.rolling_half_angle_deg or pad.half_angle_deg)
    each_way = max(1, math.ceil(pad.radius * half / DEFAULT_SPACING - 1e-9))
    count = 2 * each_way + 1
    return TaxelDescription(rows=count, columns=count, spacing=DEFAULT_SPACING)


@dataclass(frozen=True, kw_only=True, eq=False)
class TaxelLayout:
    """Geometry of one array, in the frame of the body that carries the pad.

    Attributes:
        finger: Whose pad it is on.
        geom: Geom that carries the pad, without the hand's prefix.
        center: (3,), centre of the pad's sphere, m.
        radius: Of the sphere, m.
        axes: (3, 3), columns [u, v, outward] at the middle of the array.
        array: Rows, columns, spacing and errors.
    """

    finger: str
    geom: str
    center: FloatArray
    radius: float
    axes: FloatArray
    array: TaxelDescription

    @classmethod
    def of(cls, finger: FingerDescription) -> TaxelLayout:
        """The array that a hand's description gives a finger, or the default one."""
        pad = finger.pad
        outward = np.array(pad.axis if pad.rolling_axis is None else pad.rolling_axis)
        center = np.array(pad.center)
        for bone in (center, np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])):
            along = bone - (bone @ outward) * outward
            length = float(np.linalg.norm(along))
            if length > 0.1 * float(np.linalg.norm(bone)) > 0.0:
                break
        v = along / length
        return cls(
            finger=finger.name,
            geom=pad.geom,
            center=center,
            radius=pad.radius,
            axes=np.column_stack([np.cross(v, outward), v, outward]),
            array=pad.taxels or default_array(pad),
        )

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.array.rows, self.array.columns

    @cached_property
    def u(self) -> FloatArray:
        """Place of every column along the chart's first axis, (columns,), m."""
        n = self.array.columns
        return np.asarray((np.arange(n) - (n - 1) / 2) * self.array.spacing)

    @cached_property
    def v(self) -> FloatArray:
        """Place of every row along the chart's second axis, (rows,), m."""
        n = self.array.rows
        return np.asarray((np.arange(n) - (n - 1) / 2) * self.array.spacing)

    @cached_property
    def edges(self) -> tuple[FloatArray, FloatArray]:
        """Borders of the columns' and of the rows' cells, (columns + 1,) and (rows + 1,), m."""
        half = self.array.spacing / 2
        return np.append(self.u - half, self.u[-1] + half), np.append(
            self.v - half, self.v[-1] + half
        )

    @cached_property
    def frames(self) -> FloatArray:
        """Axes of every taxel, (rows, columns, 3, 3), columns [outward, u, v]."""
        rows, columns = self.shape
        grid = np.stack(np.meshgrid(self.u, self.v), axis=-1).reshape(-1, 2)
        return np.array([self.frame_at(place) for place in grid]).reshape(rows, columns, 3, 3)

    @cached_property
    def image_axes(self) -> FloatArray:
        """Axis of every number of an image in the body's frame, (rows * columns * 3, 3).

        A flat image times this is the force of all taxels; this times a force is that force in
        the axes of every taxel.
        """
        return np.ascontiguousarray(self.frames.swapaxes(2, 3).reshape(-1, 3))

    @cached_property
    def positions(self) -> FloatArray:
        """Middles of the taxels, (rows, columns, 3), m."""
        return np.asarray(self.center + self.radius * self.frames[..., 0])

    def frame_at(self, place: FloatArray) -> FloatArray:
        """Axes (3, 3), columns [outward, u, v], at a place (2,) of the chart, m.

        Those at the middle, carried along the great circle that leads there.
        """
        u, v = place.tolist()
        arc = math.hypot(u, v)
        if arc < SMALL:
            return self.axes[:, (2, 0, 1)]
        u, v = u / arc, v / arc
        c, s = math.cos(arc / self.radius), math.sin(arc / self.radius)
        # Rodrigues' formula about the axis (-v, u, 0) in the axes at the middle
        mixed = (c - 1.0) * u * v
        turned = ((s * u, c * u * u + v * v, mixed), (s * v, mixed, c * v * v + u * u))
        return np.asarray(self.axes @ np.array((*turned, (c, -s * u, -s * v))))

    def chart(self, point: FloatArray) -> FloatArray:
        """Place (2,), m, in the chart of what lies above a point (3,) of the body's frame."""
        x, y, z = (self.axes.T @ (point - self.center)).tolist()
        across = math.hypot(x, y)
        if across < SMALL:
            return np.zeros(2)
        arc = self.radius * math.atan2(across, z)
        return np.array([arc * x / across, arc * y / across])

    def point(self, place: FloatArray) -> FloatArray:
        """Point (3,) of the pad's surface at a place (2,) of the chart, m, the body's frame."""
        return np.asarray(self.center + self.radius * self.frame_at(place)[:, 0])


TIME_TOL = 1e-9
"""Times that differ by less (s) are the same: rounding of sums of time steps."""


T = TypeVar("T")


class Delayed(Generic[T]):
    """What is sampled at a rate and arrives late.

    Attributes:
        before: The sample that arrived before the newest, with its time (s); None without.
    """

    def __init__(self, rate: float, delay: float) -> None:
        """Nothing has been sampled.

        Args:
            rate: Hz; 0 for every time step.
            delay: From a sample to its arrival, s.
        """
        self._rate, self._delay, self._next = rate, delay, -math.inf
        self._under_way: deque[tuple[float, T]] = deque()
        self.before: tuple[float, T] | None = None

    def due(self, now: float) -> bool:
        """Whether a sample is taken at a time (s), never earlier than at the last call."""
        if now < self._next - TIME_TOL:
            return False
        if self._rate > 0:
            self._next = (math.floor(now * self._rate + TIME_TOL) + 1) / self._rate
        return True

    def add(self, now: float, sample: T) -> None:
        """Send a sample on its way at a time (s)."""
        self._under_way.append((now, sample))

    @property
    def last_time(self) -> float | None:
        """When the last sample was taken, s; None before the first."""
        return self._under_way[-1][0] if self._under_way else None

    def newest(self, now: float) -> tuple[float, T]:
        """When the newest sample that has arrived was taken (s), and it; at first the oldest."""
        waiting = self._under_way
        while len(waiting) > 1 and waiting[1][0] <= now - self._delay + TIME_TOL:
            self.before = waiting.popleft()
        return waiting[0]


class TaxelArray:
    """One array over time.

    Attributes:
        layout: Its geometry and errors.
    """

    def __init__(self, layout: TaxelLayout, rng: np.random.Generator) -> None:
        """Nothing has been read.

        Args:
            layout: Its geometry and errors.
            rng: Of the noise.
        """
        self.layout = layout
        self._rng = rng
        self._alive = np.ones((*layout.shape, 1))
        for row, column in layout.array.dead:
            self._alive[row, column] = 0.0
        self._images: Delayed[FloatArray] = Delayed(layout.array.rate, layout.array.latency)
        self._nothing = 0.0, np.zeros((*layout.shape, 3))

    def read(self, time: float, exact: FloatArray) -> tuple[float, FloatArray]:
        """When the newest image that has arrived was taken (s), and the image.

        Args:
            time: Now, s; never earlier than at the last call.
            exact: What perfect taxels would read now, (rows, columns, 3), N.
        """
        if self._images.due(time):
            self._images.add(time, self.measured(exact))
        taken, image = self._images.newest(time)
        arrived = taken <= time - self.layout.array.latency + TIME_TOL
        return (taken, image) if arrived else self._nothing

    def measured(self, exact: FloatArray) -> FloatArray:
        """An image (rows, columns, 3) with noise, without what is below the threshold or dead."""
        array, image = self.layout.array, exact
        if array.noise > 0:
            deviation = array.noise * np.maximum(np.abs(exact[..., :1]), array.threshold)
            image = exact + deviation * self._rng.standard_normal(exact.shape)
        felt = np.abs(image[..., :1]) >= array.threshold
        return np.asarray(image * (felt * self._alive))


SHARE = 0.1
"""Standard deviation (-) of the force on a taxel over the texture: twice the noise of a taxel."""

LENGTH = 1e-4
"""Slid distance (m) over which the texture under a taxel becomes another: paper, cloth, wood."""


class Texture:
    """The texture under one array.

    Attributes:
        gains: (rows, columns), by which the force on each taxel differs (-).
    """

    def __init__(self, shape: tuple[int, int], rng: np.random.Generator, share: float) -> None:
        """Draw what lies under the taxels.

        Args:
            shape: Rows and columns.
            rng: Its random numbers.
            share: Standard deviation of the gains (-); 0 for a polished object.
        """
        self._rng, self._share = rng, share
        self._state = rng.standard_normal(shape)
        self.gains: FloatArray = 1.0 + share * self._state

    def slide(self, distance: float) -> None:
        """Slide the object over the pad by a distance (m)."""
        if distance <= 0.0 or self._share == 0.0:
            return
        kept = math.exp(-distance / LENGTH)
        fresh = self._rng.standard_normal(self._state.shape)
        self._state = kept * self._state + math.sqrt(1.0 - kept * kept) * fresh
        self.gains = np.maximum(1.0 + self._share * self._state, 0.0)


@dataclass(frozen=True, kw_only=True)
class ContactEstimate:
    """What an image says of the contact, in the frame of the pad's body.

    Attributes:
        normal_force: N; 0 without contact, and then nothing else means anything.
        place: (2,), centroid in the chart, m.
        point: (3,), on the pad's surface, m.
        normal: (3,), unit, outward.
        force: (3,), on what touches, N.
        torsion: On what touches, about the normal, N m.
        pressure_spread: Mean square distance of the normal force from the centroid, m2.
        shear_spread: The same of the shear along its mean direction, m2; NaN without shear.
    """

    normal_force: float
    place: FloatArray
    point: FloatArray
    normal: FloatArray
    force: FloatArray
    torsion: float
    pressure_spread: float
    shear_spread: float

    @property
    def friction_ratio(self) -> float:
        """Tangential over normal force (-)."""
        if self.normal_force <= 0:
            return 0.0
        along = float(self.force @ self.normal)
        rest = self.force - along * self.normal
        return math.sqrt(float(rest @ rest)) / self.normal_force


class ContactEstimator:
    """Estimates of one array."""

    def __init__(self, layout: TaxelLayout, least_force: float = 0.02) -> None:
        """Prepare sums.

        Args:
            layout: Geometry of the array.
            least_force: Sum (N) of the normal force below which nothing touches.
        """
        self.layout = layout
        self._least = least_force
        rows, columns = layout.shape
        self._places = np.array([np.tile(layout.u, rows), np.repeat(layout.v, columns)])
        self._ones = np.ones(rows * columns)
        self._fill = _fill_of(layout)
        none = np.full(3, np.nan)
        self._nothing = ContactEstimate(
            normal_force=0.0,
            place=none[:2],
            point=none,
            normal=none,
            force=np.zeros(3),
            torsion=0.0,
            pressure_spread=math.nan,
            shear_spread=math.nan,
        )

    def estimate(self, image: FloatArray) -> ContactEstimate:
        """What an image (rows, columns, 3) says."""
        taxels = image.reshape(-1, 3)
        if self._fill is not None:
            dead, weights = self._fill
            taxels = taxels.copy()
            taxels[dead] = weights @ taxels
        pressure = np.maximum(taxels[:, 0], 0.0)
        total = float(pressure @ self._ones)
        if total < self._least:
            return self._nothing
        place = self._places @ pressure / total
        du, dv = self._places - place[:, None]
        square = du * du + dv * dv
        frame = self.layout.frame_at(place)
        normal = frame[:, 0]
        force = taxels.reshape(-1) @ self.layout.image_axes
        along = float(force @ normal)
        _, *shear = (self._ones @ taxels).tolist()
        size = math.hypot(*shear)
        sheared = math.nan
        if size > self._least:
            # the pressure's own tilt against the neighbours' axes has no part in the sums
            sheared = float(square @ taxels @ (0.0, *shear)) / size**2
        return ContactEstimate(
            normal_force=max(along, 0.0),
            place=place,
            point=self.layout.center + self.layout.radius * normal,
            normal=normal,
            force=force,
            torsion=float(du @ taxels[:, 2] - dv @ taxels[:, 1]),
            pressure_spread=float(square @ pressure) / total,
            shear_spread=sheared,
        )


def _fill_of(layout: TaxelLayout) -> tuple[list[int], FloatArray] | None:
    """Which taxels are dead, and the weights (dead, taxels) of what stands in for them."""
    rows, columns = layout.shape
    dead = sorted({row * columns + column for row, column in layout.array.dead})
    if not dead:
        return None
    weights = np.zeros((len(dead), rows * columns))
    for row_of, k in zip(weights, dead, strict=True):
        row, column = divmod(k, columns)
        beside = [
            (row + i) * columns + column + j
            for i in (-1, 0, 1)
            for j in (-1, 0, 1)
            if 0 <= row + i < rows and 0 <= column + j < columns
        ]
        alive = [n for n in beside if n not in dead]
        row_of[alive] = 1.0 / max(len(alive), 1)
    return dead, weights


GRID = np.geomspace(0.1, 2.0, 49)
"""Frictions (-) between which is chosen; neighbours differ by 6 %."""

MEMORY = 1.0
"""Time (s) over which images are forgotten: friction differs from place to place."""

SPREAD_NOISE = 0.25
"""Standard deviation (-) of the ratio of spreads in one image, at a tangential force as large as
the normal one; it grows as the tangential force shrinks."""

MOST_OFF = 3.0
"""Standard deviations (-) beyond which an image counts no more: two patches, the array's edge."""

RATIO_NOISE = 0.03
"""Standard deviation (-) of r, as a share of it."""


class TaxelFrictionEstimator:
    """Friction of n pads over time.

    Attributes:
        friction: (n,), believed friction (-).
        deviation: (n,), its standard deviation (-).
        used: (n,), share of it in use (-), 0 to 1.
    """

    def __init__(self, spacings: Sequence[float]) -> None:
        """Nothing is known: all of the grid is as likely.

        Args:
            spacings: Of the taxels of each pad, m.
        """
        n = len(spacings)
        self._cell = np.array(spacings) ** 2 / 6.0  # spread of a cell itself, m2
        self._log = np.zeros((n, len(GRID)))
        self.used = np.zeros(n)
        self._believe()

    def step(
        self, elapsed: float, seen: Sequence[ContactEstimate], slipping: NDArray[np.bool_]
    ) -> None:
        """Take over the images of a time step.

        Args:
            elapsed: Since the last step, s.
            seen: One contact per pad.
            slipping: (n,), which of them slip.
        """
        ratio = np.array([one.friction_ratio for one in seen])
        shear = np.array([one.shear_spread for one in seen]) - self._cell
        pressure = np.array([one.pressure_spread for one in seen]) - self._cell
        self._log *= 1.0 - min(1.0, elapsed / MEMORY)
        known = np.isfinite(shear) & (pressure > 0) & (ratio > GRID[0] / 2)
        if known.any():
            share = ratio[:, None] / GRID
            used = np.clip(share, 1e-3, 1.0)
            wider = np.where(known, shear, 1.0) / np.where(known, pressure, 1.0)
            expected = (1.0 - (1.0 - used) ** (5.0 / 3.0)) / used
            off = (wider[:, None] - expected) * (ratio / SPREAD_NOISE)[:, None]
            over = np.where(slipping[:, None], share - 1.0, np.maximum(share - 1.0, 0.0))
            over = np.minimum(np.abs(over) / RATIO_NOISE, MOST_OFF)
            off = np.minimum(np.abs(off), MOST_OFF)
            self._log -= np.where(known[:, None], 0.5 * (off * off + over * over), 0.0)
            self._believe()
        self.used = np.clip(ratio / self.friction, 0.0, 1.0)

    def _believe(self) -> None:
        weight = np.exp(self._log - self._log.max(axis=1, keepdims=True))
        weight /= weight.sum(axis=1, keepdims=True)
        self.friction = weight @ GRID
        self.deviation = np.sqrt(np.maximum(weight @ GRID**2 - self.friction**2, 0.0))
