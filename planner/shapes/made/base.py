"""Base class of the meshes that a few sizes determine."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from functools import cached_property
from typing import Any, ClassVar, Self

from planner.shapes.base import checked_length, sized_spec
from planner.shapes.mesh import Mesh
from planner.shapes.meshes.polyhedron import Polyhedron
from planner.spatial import FloatArray, IntArray


class Made(Mesh):
    """A mesh that is made from a few sizes.

    A subclass is a frozen dataclass, compared as meshes are (``eq=False``), whose fields are its
    sizes, in the order of ``size_names``.
    """

    source: ClassVar[None] = None  # type: ignore[misc]

    def __post_init__(self) -> None:
        """Check the sizes."""
        for name in self.size_names:
            if name not in self.pure_numbers:
                value = checked_length(self.kind, name, getattr(self, name))
                object.__setattr__(self, name, value)
        self._check()

    def _check(self) -> None:
        """Whether the sizes fit each other; ObjectError if not."""

    @abstractmethod
    def _triangles(self) -> tuple[FloatArray, IntArray]:
        """Vertices (n, 3), m, and outward faces (m, 3)."""

    @cached_property
    def _solid(self) -> Polyhedron:  # type: ignore[override]
        return Polyhedron.centred(*self._triangles())

    @classmethod
    def from_sizes(cls, sizes: Sequence[float]) -> Self:
        """From the numbers of the specification."""
        make: Any = cls
        shape: Self = make(*sizes)
        return shape

    @property
    def sizes(self) -> tuple[float, ...]:
        """The numbers of the specification."""
        return tuple(getattr(self, name) for name in self.size_names)

    @property
    def spec(self) -> str:
        """See ``Shape``."""
        return sized_spec(self.kind, self.sizes)
