"""Proofs by interval arithmetic: leg limits without forward singularities."""

from spm_pin.proofs.certificate import Certificate, certify, largest_certified_limits

__all__ = ["Certificate", "certify", "largest_certified_limits"]
