"""Independent methods compared on random poses, and the paper's tables recomputed.

`compare_methods` runs a comparison and returns a `Report`; `METHODS` are the methods of this package, `Method` the
base of one's own, and `Conditioning` turns rounding into the tolerance of an answer. `reproduce` compares every printed
digit of the paper's tables and explains every difference, or marks it as unexplained. `workspace_shell` is the
paper's workspace of 24 surfaces, `paper` its own formulation, `nlp` the search for branches with CasADi.
"""

from importlib import import_module
from types import ModuleType

from spm_pin.crosscheck.comparison import (
    MethodScore,
    PairDifference,
    Quantity,
    Report,
    compare_in_batches,
    compare_methods,
)
from spm_pin.crosscheck.methods import METHODS, ClosedForm, Ipopt, Method, Nlp, Paper, Pinocchio, make_methods
from spm_pin.crosscheck.paper.jacobian import Table5Mistakes
from spm_pin.crosscheck.paper_shell import Convergence, LegSetting, Patch, Shell, workspace_shell
from spm_pin.crosscheck.paper_tables import (
    POSE,
    TABLES,
    Cell,
    Diagnosis,
    Reproduction,
    SolvedTwice,
    TrueValue,
    Verdict,
    reproduce,
)
from spm_pin.crosscheck.random_poses import in_leg_space, on_all_rotations
from spm_pin.crosscheck.tolerances import Conditioning

__all__ = [
    "METHODS",
    "POSE",
    "TABLES",
    "Cell",
    "ClosedForm",
    "Conditioning",
    "Convergence",
    "Diagnosis",
    "Ipopt",
    "LegSetting",
    "Method",
    "MethodScore",
    "Nlp",
    "PairDifference",
    "Paper",
    "Patch",
    "Pinocchio",
    "Quantity",
    "Report",
    "Reproduction",
    "Shell",
    "SolvedTwice",
    "Table5Mistakes",
    "TrueValue",
    "Verdict",
    "compare_in_batches",
    "compare_methods",
    "in_leg_space",
    "make_methods",
    "on_all_rotations",
    "reproduce",
    "workspace_shell",
]


def __getattr__(name: str) -> ModuleType:
    # Imported on first use: the search needs CasADi.
    if name in ("nlp", "paper"):
        return import_module(f"spm_pin.crosscheck.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
