"""What the objects that are made from sizes share."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, Self

from planner.shapes.base import Shape, checked_length
from planner.shapes.mesh import Mesh
from planner.spatial import FloatArray, IntArray

__all__ = ["Made"]


class Made(Mesh):
    """A mesh that is made from a few sizes; two are equal if their sizes are.

    A subclass is a frozen dataclass whose fields are its sizes, in the order of ``size_names``.

    """

    def __post_init__(self) -> None:
        """Check the sizes and make the triangles."""
        for name in self.size_names:
            if name not in self.pure_numbers:
                value = checked_length(self.kind, name, getattr(self, name))
                object.__setattr__(self, name, value)
        self._check()
        vertices, faces = self._triangles()
        Mesh.__init__(self, vertices, faces)

    def _check(self) -> None:
        """Whether the sizes fit each other; ObjectError if not."""

    @abstractmethod
    def _triangles(self) -> tuple[FloatArray, IntArray]:
        """Vertices (n, 3), m, and outward faces (m, 3)."""

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
        spec: str = Shape.spec.fget(self)  # type: ignore[attr-defined]
        return spec
