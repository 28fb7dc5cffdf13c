"""Compiling all kernels in advance."""

from __future__ import annotations

import pkgutil
from importlib import import_module


def compile_kernels() -> None:
    """Compile all functions for this computer, in about a minute, and keep them on disk for later processes.

    Otherwise each is compiled when first called, which delays that call by up to 20 s. Compiled code is kept where
    `NUMBA_CACHE_DIR` says, else beside the sources, else in the user's cache directory. Call it when a container
    image is built, or before many processes start. Another processor model, or another version of spm_pin or Numba,
    compiles anew.
    """
    from spm_pin.kinematics import kernels
    from spm_pin.kinematics.kernels.compilation import Kernel

    for module in pkgutil.iter_modules(kernels.__path__, f"{kernels.__name__}."):
        for member in vars(import_module(module.name)).values():
            if isinstance(member, Kernel):
                member.compile()
