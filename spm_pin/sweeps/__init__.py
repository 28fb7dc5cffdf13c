"""Metrics over any number of poses or leg lengths: domains, metrics, and runs that can be resumed."""

from spm_pin.sweeps.grids import leg_grid, leg_sample, pose_grid, pose_sample
from spm_pin.sweeps.metric import Index as Metric
from spm_pin.sweeps.metrics import INDICES as METRICS
from spm_pin.sweeps.runner import SweepStatus
from spm_pin.sweeps.runner import open_sweep as open  # noqa: A004
from spm_pin.sweeps.runner import resume_sweep as resume
from spm_pin.sweeps.runner import sweep as run
from spm_pin.sweeps.runner import sweep_status as status

__all__ = [
    "METRICS",
    "Metric",
    "SweepStatus",
    "leg_grid",
    "leg_sample",
    "open",
    "pose_grid",
    "pose_sample",
    "resume",
    "run",
    "status",
]
