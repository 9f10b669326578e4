"""An MJCF file as it is written: attributes that an element has itself, and those of its classes.

The compiled model knows all values and not where they came from; the known mistakes of Pinocchio's
reader depend on just that.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

_MAIN = "main"
"""Name of the class that applies where none is named."""


class MjcfText:
    """The elements of one MJCF file; files that it includes are not opened."""

    def __init__(self, path: Path) -> None:
        """Read the file, which MuJoCo has read before."""
        self.root = ElementTree.parse(path).getroot()
        self._parents = {child: parent for parent in self.root.iter() for child in parent}
        self._classes: dict[str, dict[str, dict[str, str]]] = {_MAIN: {}}
        for default in self.root.findall("default"):
            self._read_class(default, default.get("class", _MAIN), {})

    def _read_class(
        self, element: ElementTree.Element, name: str, above: dict[str, dict[str, str]]
    ) -> None:
        values = {tag: dict(attributes) for tag, attributes in above.items()}
        for child in element:
            if child.tag != "default":
                values.setdefault(child.tag, {}).update(child.attrib)
        self._classes[name] = values
        for child in element.findall("default"):
            self._read_class(child, child.get("class", ""), values)

    def element(self, tag: str, name: str) -> ElementTree.Element | None:
        """The element below the world with that tag and name."""
        world = self.root.find("worldbody")
        if world is None:
            return None
        return next((e for e in world.iter(tag) if e.get("name") == name), None)

    def ancestors(self, element: ElementTree.Element) -> Iterator[ElementTree.Element]:
        """Parent, grandparent and so on."""
        while element in self._parents:
            element = self._parents[element]
            yield element

    def inherited(self, element: ElementTree.Element) -> dict[str, str]:
        """Attributes that the element has from its class."""
        name = element.get("class")
        if name is None:
            classes = (a.get("childclass") for a in self.ancestors(element))
            name = next((c for c in classes if c is not None), _MAIN)
        return self._classes.get(name, {}).get(element.tag, {})

    def option(self, tag: str, attribute: str) -> str | None:
        """Attribute of a top-level element such as ``compiler``; None if it is not written."""
        values = [e.get(attribute) for e in self.root.findall(tag)]
        return next((v for v in reversed(values) if v is not None), None)

    @property
    def includes(self) -> bool:
        """Whether the file includes another one."""
        return self.root.find(".//include") is not None
