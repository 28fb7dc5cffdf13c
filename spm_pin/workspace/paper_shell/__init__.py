"""The 24 surfaces of Table 6, joined to one closed mesh: the paper's workspace."""
