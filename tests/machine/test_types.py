"""Types that an editor sees where a function returns one of several: mypy checks this file, `make test` runs mypy."""

from __future__ import annotations

from typing import assert_type

import numpy as np
import numpy.typing as npt

import spm_pin as spm
from spm_pin.machine import Configuration, SolutionSet, Status


def test_items_of_a_set_have_types() -> None:
    branches = spm.inverse_displacement(spm.Manipulator.paper(), spm.pose([0, 0, 2], rpy=[0, 0, 0]))
    assert_type(branches[0], Configuration | SolutionSet)
    assert_type(branches["TT+"], Configuration)
    assert_type(branches.physical(), Configuration)
    for branch in branches:
        assert_type(branch, Configuration)
        assert isinstance(branch, Configuration)
    assert_type(branches.status, Status | npt.NDArray[np.int8])
