"""Loop equations of the manipulator in CasADi, and a numerical inverse displacement by certified multi-start.

`closure`, `readings` and `leg_jacobian` make symbolic functions, for optimal control problems of one's own and for
generated C code. `search` finds the branches of a pose without the mechanism's algebra.
"""

from spm_pin.crosscheck.nlp.branch_search import SOLVERS, Search, search
from spm_pin.crosscheck.nlp.loop_equations import closure, inverse_jacobian, leg_jacobian, readings

__all__ = [
    "SOLVERS",
    "Search",
    "closure",
    "inverse_jacobian",
    "leg_jacobian",
    "readings",
    "search",
]
