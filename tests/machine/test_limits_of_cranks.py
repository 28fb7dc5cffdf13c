"""What limits of cranks beyond one turn are told."""

from __future__ import annotations

import re

import numpy as np
import pytest

import spm_pin as spm


def test_the_turn_of_the_readings_is_said() -> None:
    with pytest.raises(spm.GeometryError) as caught:
        spm.Stage(0.05, 0.10, spm.RRS(crank=0.04, rod=0.12), (-2.1, 4.3))
    turn = [float(number) for number in re.findall(r"-?[0-9]+[.][0-9]+", caught.value.expected)]
    np.testing.assert_allclose(turn, 0.5 * (-2.1 + 4.3) + np.array([-np.pi, np.pi]), atol=5e-4)
