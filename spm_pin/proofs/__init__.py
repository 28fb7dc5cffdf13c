"""Proofs by interval arithmetic: leg limits without singularities."""

from spm_pin.proofs.certificate import Certificate, certify, largest_certified_limits
from spm_pin.proofs.inverse_certificate import InverseCertificate, certify_inverse
from spm_pin.proofs.stage_proof import StageProof

__all__ = [
    "Certificate",
    "InverseCertificate",
    "StageProof",
    "certify",
    "certify_inverse",
    "largest_certified_limits",
]
