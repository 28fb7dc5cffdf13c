"""Files without one of their elements, which readers read or refuse, but never fail on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from xml.etree import ElementTree

import numpy as np

from spm_pin.errors import DescriptionError


def count_refused(read: Callable[[str], Any], text: str, most: int) -> tuple[int, int]:
    """Leave out each of at most `most` random elements in turn; return how many files were refused, of how many."""
    whole = ElementTree.fromstring(text)
    parents = {child: parent for parent in whole.iter() for child in parent}
    elements = list(parents)
    chosen = np.random.default_rng(0).choice(len(elements), size=min(most, len(elements)), replace=False)
    refused = 0
    for k in chosen:
        element, parent = elements[k], parents[elements[k]]
        at = list(parent).index(element)
        parent.remove(element)
        try:
            read(ElementTree.tostring(whole, encoding="unicode"))
        except DescriptionError:
            refused += 1
        parent.insert(at, element)
    return refused, len(chosen)
