"""Independent methods compared on random poses, with tolerances from conditioning and rounding.

`compare_methods` runs a comparison and returns a `Report`; `METHODS` are the methods of this package, `Method` the
base of one's own, and `Conditioning` turns rounding into the tolerance of an answer.
"""

from spm_pin.crosscheck.methods import METHODS, ClosedForm, Ipopt, Method, Nlp, Paper, Pinocchio, make_methods
from spm_pin.crosscheck.random_poses import in_leg_space, on_all_rotations
from spm_pin.crosscheck.report import Report, compare_in_batches, compare_methods
from spm_pin.crosscheck.scores import MethodScore, PairDifference, Quantity
from spm_pin.crosscheck.tolerances import Conditioning
from spm_pin.paper.jacobian import Table5Mistakes

__all__ = [
    "METHODS",
    "ClosedForm",
    "Conditioning",
    "Ipopt",
    "Method",
    "MethodScore",
    "Nlp",
    "PairDifference",
    "Paper",
    "Pinocchio",
    "Quantity",
    "Report",
    "Table5Mistakes",
    "compare_in_batches",
    "compare_methods",
    "in_leg_space",
    "make_methods",
    "on_all_rotations",
]
