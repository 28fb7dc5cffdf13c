from __future__ import annotations

import os
import signal
import threading

import numpy as np
import pytest
from problems import in_leg_space

import spm_pin as spm
from spm_pin import nlp
from spm_pin.mechanism.solutions import Status

GEOMETRY = spm.Geometry.paper()
EXAMPLE = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
FAR = spm.pose([3.0, 3.0, 2.0], xyx=[0.1, 0.5, 0.3])


def test_ipopt_finds_the_paper_s_six_branches_and_prints_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    found = nlp.search(GEOMETRY, EXAMPLE, solver="ipopt", starts=80, seed=1)
    closed = spm.inverse_displacement(GEOMETRY, EXAMPLE)
    np.testing.assert_array_equal(found.solutions.exists, closed.exists)
    assert np.nanmax(np.abs(found.solutions.middle_joints - closed.middle_joints)) < 1e-9
    assert np.nanmax(found.solutions.residual) < 1e-14
    assert found.hits.sum() > 60
    captured = capfd.readouterr()
    assert captured.out == captured.err == ""


def test_ipopt_detects_infeasibility_of_an_unreachable_pose() -> None:
    found = nlp.search(GEOMETRY, FAR, solver="ipopt", starts=20)
    assert found.solutions.status is Status.UNREACHABLE
    assert found.infeasibility > 0.0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"ipopt.max_iters": 3}, "No such IPOPT option: max_iters"),
        ({"foo": 1}, "options: expected options of casadi.nlpsol"),
        ({"ipopt.tol": "small"}, "options: expected"),
        ({"ipopt.linear_solver": "ma27"}, "Invalid_Option"),
    ],
)
def test_bad_options_raise_an_argument_error(options: dict[str, object], words: str) -> None:
    with pytest.raises(spm.ArgumentError, match=words):
        nlp.search(GEOMETRY, EXAMPLE, solver="ipopt", starts=2, options=options)


def test_ctrl_c_during_a_solve_ends_the_search() -> None:
    """CasADi swallows the signal and reports a failed solve."""
    poses = in_leg_space(GEOMETRY, 500, 8).pose
    nlp.search(GEOMETRY, poses[:1], solver="ipopt", starts=4)  # the solver is made before the clock runs
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    timer = threading.Timer(0.6, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            nlp.search(GEOMETRY, poses, solver="ipopt", starts=4)
    finally:
        timer.cancel()
        signal.signal(signal.SIGINT, before)
