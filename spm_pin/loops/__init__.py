"""Any closed chain on Pinocchio."""
