"""The paper's tables recomputed, every printed digit compared, every difference explained or marked as unexplained."""

from spm_pin.reproduction.cells import Cell, Verdict, matches
from spm_pin.reproduction.table_5 import Diagnosis, TrueValue
from spm_pin.reproduction.tables_1_to_4 import POSE, TABLES, MisprintedEquation, Reproduction, SolvedTwice, reproduce

__all__ = [
    "POSE",
    "TABLES",
    "Cell",
    "Diagnosis",
    "MisprintedEquation",
    "Reproduction",
    "SolvedTwice",
    "TrueValue",
    "Verdict",
    "matches",
    "reproduce",
]
