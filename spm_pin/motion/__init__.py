"""Motion of the machine: paths between two states, and the fastest way along them."""

from spm_pin.motion.paths import LegMotion, LegPath
from spm_pin.motion.planning import MotionPlan, plan
from spm_pin.motion.time_optimal import Payload, TimedMotion, time_optimal

__all__ = ["LegMotion", "LegPath", "MotionPlan", "Payload", "TimedMotion", "plan", "time_optimal"]
