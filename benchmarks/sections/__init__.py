"""The parts of the results, in their order."""
