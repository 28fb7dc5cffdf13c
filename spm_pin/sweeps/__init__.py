"""Metrics over any number of poses or leg lengths: domains, metrics, and runs that can be resumed."""

from spm_pin.sweeps.domains import (
    Axis,
    Domain,
    Sample,
    leg_grid,
    leg_sample,
    pose_grid,
    pose_sample,
    tilt_grid,
    tilt_sample,
)
from spm_pin.sweeps.metrics import METRICS, Metric, condition, metric
from spm_pin.sweeps.points import Points
from spm_pin.sweeps.runner import SweepStatus, resume_sweep, run_sweep, sweep_status
from spm_pin.sweeps.store import StoreError, StoreLockedError, SweepError

__all__ = [
    "METRICS",
    "Axis",
    "Domain",
    "Metric",
    "Points",
    "Sample",
    "StoreError",
    "StoreLockedError",
    "SweepError",
    "SweepStatus",
    "condition",
    "leg_grid",
    "leg_sample",
    "metric",
    "pose_grid",
    "pose_sample",
    "resume_sweep",
    "run_sweep",
    "sweep_status",
    "tilt_grid",
    "tilt_sample",
]
