"""The paper's tables recomputed, cell by cell, beside what it printed."""
