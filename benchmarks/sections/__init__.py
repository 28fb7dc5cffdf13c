"""The sections of the results, in order."""
