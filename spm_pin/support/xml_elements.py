"""Elements of the XML files that are written: numbers with all their digits, and the text of a file."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

Value = str | float | Iterable[float]


def written(value: Any) -> str:
    """Return a text, or numbers with all their digits."""
    return value if isinstance(value, str) else " ".join(repr(float(x) + 0.0) for x in np.atleast_1d(value))


def element(tag: str, *children: Element | None, text: Any = None, **attributes: Value | None) -> Element:
    """Return an element with its text and attributes; children and attributes may be None."""
    made = ElementTree.Element(tag, {name: written(value) for name, value in attributes.items() if value is not None})
    made.text = None if text is None else written(text)
    made.extend(child for child in children if child is not None)
    return made


def texts(**values: Any) -> list[Element]:
    """Return an element for each value, with the value as its text."""
    return [element(tag, text=value) for tag, value in values.items()]


def document(root: Element, comment: str = "") -> str:
    """Return the text of an XML file, with a comment above its root if one is given."""
    ElementTree.indent(root)
    above = f"<!-- {comment} -->\n" if comment else ""
    return f'<?xml version="1.0"?>\n{above}{ElementTree.tostring(root, encoding="unicode")}\n'
