"""``Contact``, ``ContactSet`` and the grasp map.

A ``ContactSet`` is what planning and simulation have in common: planned contacts and the contacts
that MuJoCo reports are both one, and everything in ``planner.quality`` and ``planner.forces`` is a
function of it. It works on bare arrays, with no hand and no simulator::

    contacts = ContactSet.from_arrays(positions, normals, mu=0.5, center=[0, 0, 0])

Friction law of contact i, in its own frame (f_n along the normal, into the object, >= 0):

    frictionless    f = [f_n]
    point           f = [f_n, f_t1, f_t2],         f_t1^2 + f_t2^2 <= mu^2 f_n^2
    soft            f = [f_n, f_t1, f_t2, tau_n],  (f_t1^2 + f_t2^2)/mu^2 + (tau_n/mu_torsion)^2
                                                   <= f_n^2

The last is MuJoCo's elliptic cone with condim 4. mu has no unit, mu_torsion is in metres.

A set is made at every attempt of a search and at every step of a controller, so each check of its
numbers is one or two calls; only where that fails is there a look at every number.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner.arrays import SHORT, checked_number, float_array, per_item
from planner.contacts.friction import cone_utilisation
from planner.errors import ContactError, shown
from planner.showing import in_notebook
from planner.spatial import FloatArray, contact_frames, skew

if TYPE_CHECKING:
    from planner.spatial import SE3


FARTHEST = 1e6
"""Largest coordinate (m): beyond it torques lose the digits that a verdict needs."""

MOST_FRICTION = 1e3
"""Largest sliding friction (-) and torsional friction (m): a force may be 89.94 degrees off the
normal. Beyond it the normal parts drown in the tangential ones, and rank is misjudged."""

_IDENTITY = np.eye(3)

_ORTHONORMAL_TOL = 1e-6
"""How far a given frame may be from a rotation matrix (-)."""


def check_frames(frames: FloatArray, name: str = "frames") -> None:
    """Refuse contact frames (n, 3, 3) that are not right-handed rotation matrices.

    Raises:
        ContactError: So, or they hold NaN.
    """
    if len(frames) == 0:
        return
    if np.shape(frames)[1:] != (3, 3):
        raise ContactError(f"{name} has shape {np.shape(frames)}; give (n, 3, 3)")
    if not math.isfinite(float(np.vdot(frames, frames))):
        _check_finite(frames, name)
    error = frames.transpose(0, 2, 1) @ frames
    error -= _IDENTITY
    # the sum of squares is the larger; where it is small, none needs a look of its own
    size = float(np.vdot(error, error))
    fits = size <= _ORTHONORMAL_TOL**2 or max(error.max(), -error.min()) <= _ORTHONORMAL_TOL
    if not (fits and _least_handedness(frames) > 0.0):
        raise ContactError(
            "a contact frame is not a right-handed rotation matrix; give [normal, tangent1, "
            "tangent2] in its columns, as contact_frames makes them"
        )


def _least_handedness(frames: FloatArray) -> float:
    """Least determinant of frames (n, 3, 3) that are orthonormal: 1 or, left-handed, -1."""
    least: float = min(
        a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g)
        for (a, b, c), (d, e, f), (g, h, i) in frames.tolist()
    )
    return least


def check_positions(value: FloatArray, name: str) -> None:
    """Refuse what is not finite, or too far away."""
    # one product instead of a look at every number; it is infinite or NaN where one of them is
    size = float(np.vdot(value, value))
    if not math.isfinite(size):
        _check_finite(value, name)
    if not size <= FARTHEST**2 and np.abs(value).max() > FARTHEST:
        raise ContactError(f"a position is farther than {FARTHEST:g} m away; give metres")


def check_friction(value: FloatArray, name: str) -> None:
    """Refuse friction that is not finite, negative or out of proportion."""
    numbers = value.tolist()
    if not math.isfinite(sum(numbers)):
        _check_finite(value, name)
    if min(numbers, default=0.0) < 0.0:
        raise ContactError("friction is negative; mu and mu_torsion must be >= 0")
    if max(numbers, default=0.0) > MOST_FRICTION:
        raise ContactError(f"friction is above {MOST_FRICTION:g}; give mu and mu_torsion below")


def check_forces(value: FloatArray, name: str) -> None:
    """Refuse infinite forces; NaN stands for unknown ones."""
    if not math.isfinite(float(np.vdot(value, value))) and np.isinf(value).any():
        raise ContactError("forces hold infinity; give finite numbers, NaN where unknown")


def _check_finite(value: FloatArray, name: str) -> None:
    """Refuse NaN and infinity."""
    if not np.isfinite(value).all():
        raise ContactError(f"{name} holds NaN or infinity; give finite numbers")


ContactModel: TypeAlias = Literal["frictionless", "point", "soft"]
"""What a contact transmits: a normal force, friction too, or torsion about the normal as well."""

CONTACT_DIM: dict[str, int] = {"frictionless": 1, "point": 3, "soft": 4}
"""Number of force components that each contact model transmits."""


@dataclass(frozen=True, kw_only=True)
class Contact:
    """One contact on the object.

    Attributes:
        position: Point on the object's surface, (3,), m.
        frame: Rotation matrix (3, 3), columns [normal into the object, tangent1, tangent2].
        model: Friction law, see the module.
        mu: Sliding friction (-).
        mu_torsion: Torsional friction (m); used by ``soft`` only.
        force: What the hand does to the object in the contact frame, (4,): f_n, f_t1, f_t2 in N
            and tau_n in N m; NaN where unknown.
        finger: Name of the finger that touches, "" where none is known.
    """

    position: FloatArray
    frame: FloatArray
    model: ContactModel = "point"
    mu: float = 0.5
    mu_torsion: float = 0.0
    force: FloatArray = field(default_factory=lambda: np.full(4, np.nan))
    finger: str = ""

    def __post_init__(self) -> None:
        """Check every number.

        Raises:
            ContactError: Another shape, not finite, or friction out of range.
        """
        for name in ("position", "frame", "force"):
            value, shape = getattr(self, name), _SHAPES[f"{name}s"]
            if type(value) is not np.ndarray:
                value = float_array(name, value, copy=True)
                object.__setattr__(self, name, value)
            if value.shape != shape:
                raise ContactError(f"the {name} of a contact has shape {value.shape}; give {shape}")
            _RANGES[f"{name}s"](value[None], name)
        for name in ("mu", "mu_torsion"):
            checked_number(name, getattr(self, name), least=0.0, most=MOST_FRICTION)


@dataclass(frozen=True, kw_only=True)
class ContactSet:
    """Contacts on one object, all in one frame of reference.

    Attributes:
        positions: (n, 3), m.
        frames: (n, 3, 3), columns [normal into the object, tangent1, tangent2].
        models: n friction laws.
        mu: (n,), sliding friction (-).
        mu_torsion: (n,), torsional friction (m).
        forces: (n, 4), f_n, f_t1, f_t2 (N) and tau_n (N m) on the object, in the contact frames;
            NaN where unknown.
        fingers: n names, "" where unknown.
        center: (3,), the object's centre of mass in the same frame, m. Torques are about it.
    """

    positions: FloatArray
    frames: FloatArray
    models: tuple[ContactModel, ...]
    mu: FloatArray
    mu_torsion: FloatArray
    forces: FloatArray
    fingers: tuple[str, ...]
    center: FloatArray

    def __post_init__(self) -> None:
        """Check shapes, finiteness and ranges; freeze the arrays."""
        self._take({name: getattr(self, name) for name in _SHAPES})
        if len(self.fingers) != len(self.models):
            raise ContactError(f"{len(self.fingers)} finger names for {len(self.models)} contacts")
        for model in self.models:
            if not isinstance(model, str):
                raise ContactError(f"contact models are names; use some of {list(CONTACT_DIM)}")
        if not CONTACT_DIM.keys() >= set(self.models):
            unknown = sorted({m for m in self.models if m not in CONTACT_DIM})
            raise ContactError(f"unknown contact model {unknown}; use one of {list(CONTACT_DIM)}")

    def _take(self, arrays: dict[str, Any]) -> None:
        """Keep read-only copies of arrays after checking them."""
        n = len(self.models)
        for name, given in arrays.items():
            if type(given) is np.ndarray and given.dtype == np.float64:
                value = given.copy()
            else:
                value = float_array(name, given, copy=True)
            shape = _SHAPES[name] if name == "center" else (n, *_SHAPES[name])
            if value.shape != shape:
                raise ContactError(f"{name} has shape {value.shape}, but {n} contacts need {shape}")
            _RANGES[name](value, name)
            value.flags.writeable = False
            self.__dict__[name] = value

    def _changed(self, **arrays: FloatArray) -> ContactSet:
        """The same contacts with other arrays; those that stay need no check."""
        other = object.__new__(type(self))
        other.__dict__.update({name: self.__dict__[name] for name in _FIELDS})
        other._take(arrays)
        return other

    @classmethod
    def from_arrays(
        cls,
        positions: ArrayLike,
        normals: ArrayLike,
        *,
        mu: ArrayLike = 0.5,
        mu_torsion: ArrayLike = 0.0,
        model: ContactModel | Sequence[ContactModel] = "point",
        center: ArrayLike = (0.0, 0.0, 0.0),
        forces: ArrayLike | None = None,
        fingers: Sequence[str] | None = None,
    ) -> ContactSet:
        """Contacts from bare arrays; tangents are chosen by ``spatial.contact_frames``.

        Args:
            positions: (n, 3), m.
            normals: (n, 3), into the object, any positive length.
            mu: Sliding friction, a number or (n,).
            mu_torsion: Torsional friction in m, a number or (n,).
            model: One friction law for all, or n of them.
            center: Centre of mass (3,), m.
            forces: (n, 4) in the contact frames, or None where unknown.
            fingers: n names, or None.

        Raises:
            ContactError: Shapes do not fit, NaN, a normal without length, negative friction.
        """
        p = float_array("positions", positions)
        p = p.reshape(0, 3) if p.size == 0 else p
        if p.ndim != 2 or p.shape[1] != 3:
            raise ContactError(f"positions have shape {p.shape}; give an array of shape (n, 3)")
        n = len(p)
        given = float_array("normals", normals)
        given = given.reshape(0, 3) if given.size == 0 else given
        if given.shape != (n, 3):
            raise ContactError(
                f"normals have shape {given.shape}; {n} positions need {(n, 3)}, a row per contact"
            )
        return cls(
            positions=p,
            frames=contact_frames(given) if n else np.zeros((0, 3, 3)),
            models=(model,) * n if isinstance(model, str) else _listed("model", model),
            mu=per_item("mu", mu, n),
            mu_torsion=per_item("mu_torsion", mu_torsion, n),
            forces=np.full((n, 4), np.nan) if forces is None else float_array("forces", forces),
            fingers=("",) * n if fingers is None else _listed("fingers", fingers),
            center=float_array("center", center),
        )

    @classmethod
    def from_contacts(cls, contacts: Sequence[Contact], *, center: ArrayLike) -> ContactSet:
        """A set from single contacts that share a frame of reference.

        Raises:
            ContactError: As ``from_arrays`` does.
        """
        n = len(contacts)

        def stacked(what: str, values: list[Any], shape: tuple[int, ...]) -> FloatArray:
            array = float_array(what, values)
            return array if n else array.reshape(0, *shape)

        return cls(
            positions=stacked("positions", [c.position for c in contacts], (3,)),
            frames=stacked("frames", [c.frame for c in contacts], (3, 3)),
            models=tuple(c.model for c in contacts),
            mu=stacked("mu", [c.mu for c in contacts], ()),
            mu_torsion=stacked("mu_torsion", [c.mu_torsion for c in contacts], ()),
            forces=stacked("forces", [c.force for c in contacts], (4,)),
            fingers=tuple(c.finger for c in contacts),
            center=float_array("center", center),
        )

    def __repr__(self) -> str:
        """One line; the attributes hold the rest."""
        text = f"<ContactSet of {len(self)} contacts: {', '.join(self.fingers)}"
        return f"{text}>" if len(text) < SHORT else f"{text[: SHORT - 4]}...>"

    def _repr_html_(self) -> str:
        """What a notebook shows of it: a table and a picture, made once."""
        return in_notebook(self)

    def __len__(self) -> int:
        """Number of contacts."""
        return len(self.models)

    def __getitem__(self, i: int) -> Contact:
        """Contact number i."""
        return Contact(
            position=self.positions[i],
            frame=self.frames[i],
            model=self.models[i],
            mu=float(self.mu[i]),
            mu_torsion=float(self.mu_torsion[i]),
            force=self.forces[i],
            finger=self.fingers[i],
        )

    @property
    def normals(self) -> FloatArray:
        """Unit normals into the object, (n, 3)."""
        return self.frames[:, :, 0]

    @property
    def dims(self) -> tuple[int, ...]:
        """Number of force components per contact: 1, 3 or 4."""
        return tuple(CONTACT_DIM[m] for m in self.models)

    @property
    def friction(self) -> FloatArray:
        """Sliding (-) and torsional friction (m) as far as the models have them, (n, 2)."""
        dims = np.array(self.dims, dtype=int)
        return np.stack([self.mu * (dims >= 3), self.mu_torsion * (dims == 4)], axis=1)

    def with_forces(self, forces: ArrayLike) -> ContactSet:
        """The same contacts with forces (n, 4) in the contact frames."""
        return self._changed(forces=float_array("forces", forces))

    def with_friction(self, mu: ArrayLike, mu_torsion: ArrayLike | None = None) -> ContactSet:
        """The same contacts with another friction, a number or (n,) each."""
        n = len(self)
        torsion = self.mu_torsion if mu_torsion is None else mu_torsion
        return self._changed(
            mu=per_item("mu", mu, n),
            mu_torsion=per_item("mu_torsion", torsion, n),
        )

    def transformed(self, T_new_old: SE3) -> ContactSet:
        """The same contacts seen from another frame; forces stay, their frames turn along.

        Args:
            T_new_old: Pose of the present frame of reference in the new one.
        """
        rotation, shift = T_new_old.rotation, T_new_old.translation
        return self._changed(
            positions=self.positions @ rotation.T + shift,
            frames=rotation @ self.frames,
            center=rotation @ self.center + shift,
        )

    def grasp_map(self) -> FloatArray:
        """Grasp map G, shape (6, sum of dims): contact force components -> wrench on the object.

        Columns run contact by contact in the order f_n, f_t1, f_t2, tau_n as far as the model has
        them; rows are [force; torque about ``center``] in the set's axes, unscaled (N, N m).
        (Murray, Li, Sastry 1994, section 5.2.)
        """
        n = len(self.models)
        maps = np.zeros((6, n, 4))
        by_contact = maps.transpose(1, 0, 2)
        by_contact[:, :3, :3] = self.frames
        np.matmul(skew(self.positions - self.center), self.frames, out=by_contact[:, 3:, :3])
        by_contact[:, 3:, 3] = self.frames[:, :, 0]
        return maps.reshape(6, -1)[:, self._transmitted.ravel()]

    @property
    def _transmitted(self) -> NDArray[np.bool_]:
        """Which of f_n, f_t1, f_t2, tau_n each contact transmits, (n, 4)."""
        return np.array([_TRANSMITTED[m] for m in self.models], dtype=np.bool_).reshape(-1, 4)

    def forces_in_axes(self) -> FloatArray:
        """Contact forces turned into the set's axes, (n, 3), N."""
        return np.asarray(np.einsum("nij,nj->ni", self.frames, self.forces[:, :3]))

    def wrench(self) -> FloatArray:
        """Sum of the contact forces as a wrench (6,) about ``center``; NaN if a force is unknown.

        Components that a contact's model does not transmit are left out.
        """
        return self.wrench_of(self.forces)

    def wrench_of(self, forces: FloatArray) -> FloatArray:
        """Sum of forces (n, 4) in the contact frames as a wrench (6,), like ``wrench``.

        Raises:
            ContactError: The forces have another shape.
        """
        forces = float_array("forces", forces)
        if forces.shape != self.forces.shape:
            raise ContactError(f"forces have shape {forces.shape}; give {self.forces.shape}")
        carried = np.where(self._transmitted, forces, 0.0)
        force = (self.frames @ carried[:, :3, None])[:, :, 0]
        arms = skew(self.positions - self.center)
        torque = (arms @ force[:, :, None])[:, :, 0] + carried[:, 3:] * self.frames[:, :, 0]
        return np.concatenate([force.sum(axis=0), torque.sum(axis=0)])

    def friction_utilisation(self) -> FloatArray:
        """Share of the friction cone in use, (n,): 0 on the normal, 1 on the cone, above 1 outside.

        Infinite where a tangential force meets no friction or no normal force.
        """
        torsion = np.where([m == "soft" for m in self.models], self.mu_torsion, np.nan)
        return cone_utilisation(self.forces, self.mu, torsion)


_SHAPES: dict[str, tuple[int, ...]] = {
    "positions": (3,),
    "frames": (3, 3),
    "mu": (),
    "mu_torsion": (),
    "forces": (4,),
    "center": (3,),
}
"""Arrays of a set, with their shape for each contact; there is one centre."""

_RANGES: dict[str, Callable[[FloatArray, str], None]] = {
    "positions": check_positions,
    "frames": check_frames,
    "mu": check_friction,
    "mu_torsion": check_friction,
    "forces": check_forces,
    "center": check_positions,
}
"""What refuses the numbers of each."""

_FIELDS = (*_SHAPES, "models", "fingers")

_TRANSMITTED = {model: [i < dim for i in range(4)] for model, dim in CONTACT_DIM.items()}
"""Which of f_n, f_t1, f_t2, tau_n each contact model transmits."""


def check_contacts(given: Any) -> None:
    """Refuse what is no ``ContactSet``, and say where one is.

    Raises:
        ContactError: So.
    """
    if not isinstance(given, ContactSet):
        has = (
            "give its .contacts"
            if hasattr(given, "contacts")
            else "ContactSet.from_arrays makes one"
        )
        raise ContactError(f"{shown(given)} is a {type(given).__name__}, no ContactSet; {has}")


def _listed(what: str, value: Any) -> tuple[Any, ...]:
    """A sequence of names as a tuple; their number is checked later.

    Raises:
        ContactError: Something else.
    """
    if isinstance(value, str) or not isinstance(value, Sequence):
        raise ContactError(f"{what} is {shown(value)}; give a list of names, one per contact")
    return tuple(value)
