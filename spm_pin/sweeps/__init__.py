"""Metrics over any number of poses or leg lengths: domains, metrics, and runs that can be resumed."""

from spm_pin.sweeps.axes import Axis
from spm_pin.sweeps.domains import Domain, Sample, leg_grid, leg_sample, pose_grid, pose_sample
from spm_pin.sweeps.metric import Metric, metric
from spm_pin.sweeps.metrics import METRICS
from spm_pin.sweeps.points import Points
from spm_pin.sweeps.runner import SweepStatus, resume, run, status
from spm_pin.sweeps.runner import open_store as open  # noqa: A004
from spm_pin.sweeps.sweep_errors import StoreError, StoreLockedError, SweepError

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
    "leg_grid",
    "leg_sample",
    "metric",
    "open",
    "pose_grid",
    "pose_sample",
    "resume",
    "run",
    "status",
]
