"""The few functions of SciPy that every plan needs, without the packages around them.

``from scipy.spatial import ConvexHull`` runs the whole package and three others: 0.4 s of CPU for
one compiled module, half of what a plan of a known object takes. Here a package of ``PARTS`` is
imported as an empty one while its compiled module loads, and is then forgotten, so that whoever
imports it afterwards gets the whole. All of it happens under Python's own import locks: another
thread that imports the package meanwhile waits, and then imports it whole.

Where SciPy has moved a module, the names come from their public places, as slowly as ever.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType
from typing import Any

PARTS: dict[str, tuple[str, ...]] = {
    "scipy.linalg": ("_flapack", "cython_lapack"),
    "scipy.spatial": ("_qhull",),
    "scipy.optimize": ("_nnls",),
}
"""Package -> its modules that are loaded; those of a package may need those before it."""


class _Loaded(ImportError):
    """Ends the import of an empty package: Python forgets it, and keeps its modules."""


class _EmptyPackages:
    """A finder and loader of packages: for one thread they are empty, and hold their modules."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names, self._thread = list(names), threading.get_ident()

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname not in self._names or threading.get_ident() != self._thread:
            return None
        found = PathFinder.find_spec(fullname, path)
        if found is None or found.submodule_search_locations is None:
            return None
        loader: Any = self
        spec = ModuleSpec(fullname, loader, is_package=True)
        spec.submodule_search_locations = found.submodule_search_locations
        return spec

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return None

    def exec_module(self, module: ModuleType) -> None:
        for part in PARTS[module.__name__]:
            import_module(f"{module.__name__}.{part}")
        self._names.remove(module.__name__)
        if self._names:  # inside this one, whose modules the next may need
            _load_empty(self._names[0])
        raise _Loaded


def _load_empty(name: str) -> None:
    with suppress(_Loaded):
        import_module(name)


def _load_parts() -> None:
    """Load the modules of ``PARTS``, as far as their packages are not loaded already."""
    import scipy  # noqa: F401  the package above is always whole

    missing = [name for name in PARTS if name not in sys.modules]
    if not missing:
        return
    finder = _EmptyPackages(missing)
    sys.meta_path.insert(0, finder)
    try:
        _load_empty(missing[0])
    except ImportError:
        pass  # moved: the public names below
    finally:
        sys.meta_path.remove(finder)


def _name(module: str, public: str, name: str) -> Any:
    """What a module defines, from the public one where SciPy has moved it."""
    home = sys.modules.get(module)
    return getattr(home if hasattr(home, name) else import_module(public), name)


_load_parts()
ConvexHull: Any = _name("scipy.spatial._qhull", "scipy.spatial", "ConvexHull")
QhullError: Any = _name("scipy.spatial._qhull", "scipy.spatial", "QhullError")
dposv: Any = _name("scipy.linalg._flapack", "scipy.linalg.lapack", "dposv")
nnls: Any = _name("scipy.optimize._nnls", "scipy.optimize", "nnls")
