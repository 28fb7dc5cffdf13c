"""The mechanism as a Pinocchio model with closures: the only floor that imports pinocchio."""
