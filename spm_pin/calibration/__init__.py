"""The calibrated machine identified from measurements, the poses to measure chosen, and what tolerances cost."""

from spm_pin.calibration.error_model import error_jacobian
from spm_pin.calibration.identification import Calibration, choose_poses, identify
from spm_pin.calibration.measurements import MeasurementError, read_measurements
from spm_pin.calibration.observables import Inclinations
from spm_pin.calibration.tolerance_analysis import ToleranceAnalysis, tolerance

__all__ = [
    "Calibration",
    "Inclinations",
    "MeasurementError",
    "ToleranceAnalysis",
    "choose_poses",
    "error_jacobian",
    "identify",
    "read_measurements",
    "tolerance",
]
