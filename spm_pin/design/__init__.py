"""Dimensions compared and searched: many machines over one sample of states, and fronts of what they can do."""

from spm_pin.design.designs import VARIABLES, DesignProblem, Designs, Front, evaluate_designs, pareto_front
from spm_pin.design.task import Task

__all__ = ["VARIABLES", "DesignProblem", "Designs", "Front", "Task", "evaluate_designs", "pareto_front"]
