"""The closed forms outside of Python: CasADi functions with derivatives of any order, and C99 for controllers."""

from spm_pin.symbolic.c_export import c_sources, write_c

__all__ = ["c_sources", "write_c"]
