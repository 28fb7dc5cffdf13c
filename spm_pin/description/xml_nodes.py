"""XML with the line of every element, and numbers written without loss."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from typing import Any
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np

from spm_pin.errors import DescriptionError

_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
"""As C++ reads it: other readers leave out what only Python takes for a number, a whole inertia for example."""


@dataclass(eq=False)
class Node:
    """An element read from a file."""

    tag: str
    attributes: dict[str, str]
    place: str
    children: list[Node] = field(default_factory=list)
    texts: list[str] = field(default_factory=list)

    @property
    def text(self) -> str:
        """The characters inside, without those of elements inside."""
        return "".join(self.texts)

    def error(self, expected: str, received: object, cause: str = "") -> DescriptionError:
        """Return an error that names the file and the line."""
        return DescriptionError(self.place, expected, received, cause)

    def check(self, *, children: Collection[str] = (), attributes: Collection[str] = ()) -> None:
        """Raise `DescriptionError` if there is an attribute or an element inside that the reader does not support."""
        for child in self.children:
            if child.tag not in children:
                expected = f"{', '.join(children)} in <{self.tag}>" if children else f"nothing inside <{self.tag}>"
                unexpanded = child.tag.startswith("xacro:")
                lost = "It would be lost: take it out, if it may be"
                cause = "Not expanded yet? xacro writes the URDF" if unexpanded else lost
                raise child.error(expected, f"<{child.tag}>", cause)
        for key in self.attributes:
            if key not in attributes:
                expected = f"no attributes of <{self.tag}> but {', '.join(attributes) or 'none'}"
                raise self.error(expected, key)

    def get(self, attribute: str) -> str:
        """Return an attribute that must be there."""
        if not self.attributes.get(attribute):
            raise self.error(f"the attribute {attribute} of <{self.tag}>", "none")
        return self.attributes[attribute]

    def all(self, tag: str) -> list[Node]:
        """Return the elements inside with a tag."""
        return [child for child in self.children if child.tag == tag]

    def optional(self, tag: str) -> Node | None:
        """Return the one element inside with a tag, or None."""
        found = self.all(tag)
        if len(found) > 1:
            raise found[1].error(f"one <{tag}> in <{self.tag}>", f"{len(found)}")
        return found[0] if found else None

    def one(self, tag: str) -> Node:
        """Return the one element inside with a tag."""
        found = self.optional(tag)
        if found is None:
            raise self.error(f"a <{tag}> in <{self.tag}>", "none")
        return found

    def floats(self, attribute: str, count: int, default: str | None = None) -> tuple[float, ...]:
        """Return the numbers in an attribute, all finite; without `default` it must be there."""
        text = self.attributes.get(attribute, default)
        if text is None:
            text = self.get(attribute)
        words = [text] if count == 1 else text.split()
        values = tuple(float(word) for word in words if _NUMBER.fullmatch(word))
        if len(words) != count or len(values) != count or not all(math.isfinite(value) for value in values):
            many = "a finite number" if count == 1 else f"{count} finite numbers"
            raise self.error(f"{many} as {attribute} of <{self.tag}>", repr(text))
        return values

    def triple(self, attribute: str, default: str | None = None) -> tuple[float, float, float]:
        """Return the three numbers in an attribute."""
        x, y, z = self.floats(attribute, 3, default)
        return x, y, z

    def number(self, attribute: str, default: str | None = None) -> float:
        """Return the number in an attribute."""
        return self.floats(attribute, 1, default)[0]


def parse(text: str, source: str) -> Node:
    """Return the root element of an XML text; `source` is what errors call it.

    Raises
    ------
    DescriptionError
        If the text is not XML; the error names the line.
    """
    parser = expat.ParserCreate()
    root: list[Node] = []
    stack: list[Node] = []

    def start(tag: str, attributes: dict[str, str]) -> None:
        node = Node(tag, attributes, f"{source}:{parser.CurrentLineNumber}")
        (stack[-1].children if stack else root).append(node)
        stack.append(node)

    def characters(data: str) -> None:
        if stack:
            stack[-1].texts.append(data)

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: stack.pop() and None
    parser.CharacterDataHandler = characters
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise DescriptionError(f"{source}:{error.lineno}", "XML", expat.ErrorString(error.code)) from error
    return root[0]


def element(
    tag: str, *children: ElementTree.Element | None, text: Any = None, **attributes: str | float | Iterable[float]
) -> ElementTree.Element:
    """Return an element with its text and attributes, numbers with all their digits; children may be None."""

    def written(value: Any) -> str:
        return value if isinstance(value, str) else " ".join(repr(float(x) + 0.0) for x in np.atleast_1d(value))

    made = ElementTree.Element(tag, {name: written(value) for name, value in attributes.items()})
    made.text = None if text is None else written(text)
    made.extend(child for child in children if child is not None)
    return made


def texts(**values: str | float | Iterable[float]) -> list[ElementTree.Element]:
    """Return an element for each value, which is its text."""
    return [element(tag, text=value) for tag, value in values.items()]


def document(root: ElementTree.Element) -> str:
    """Return the text of an XML file, with a comment above its root that says where it comes from."""
    ElementTree.indent(root)
    body = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0"?>\n<!-- Written by spm_pin, which is the place for changes. -->\n{body}\n'


def check_prefix(prefix: str) -> None:
    """Raise `DescriptionError` unless `prefix` can begin a name in xacro, URDF, SRDF and YAML."""
    well_formed = isinstance(prefix, str) and re.fullmatch(r"([A-Za-z_][A-Za-z0-9_./-]*)?", prefix)
    # xacro turns these words into numbers and truth values, and so into other names.
    if not well_formed or prefix.lower() in ("inf", "infinity", "nan", "true", "false"):
        expected = "a name such as left_, of letters, digits and _ . / -, beginning with a letter"
        raise DescriptionError("prefix", expected, repr(prefix))
