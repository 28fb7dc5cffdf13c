"""Witness 2: the closed form beyond the paper."""
