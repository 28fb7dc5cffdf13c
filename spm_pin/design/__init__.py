"""Comparison and search of dimensions: many machines over one sample of states, and Pareto fronts of their metrics."""

from spm_pin.design.designs import VARIABLES, DesignProblem, Designs, Front, evaluate_designs, pareto_front
from spm_pin.design.task import Task

__all__ = ["VARIABLES", "DesignProblem", "Designs", "Front", "Task", "evaluate_designs", "pareto_front"]
