"""The identity of a metric's function: a digest of its code and of every value that it uses.

Two functions of one digest compute the same. The digest does not depend on addresses, line numbers, the order of
sets, or the process. Code and values of the user's own modules are included as they are; modules, classes and
functions that come with Python or from installed packages are included by name.
"""

from __future__ import annotations

import copyreg
import functools
import hashlib
import sys
import sysconfig
import types
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType, MappingProxyType, ModuleType
from typing import Any

import numpy as np

from spm_pin.errors import ArgumentError

_PLAIN = (type(None), bool, int, float, complex, str, bytes, type(Ellipsis))
_WRAPPERS = (staticmethod, classmethod, type(functools.cache(len)))
_DESCRIPTORS = (types.MemberDescriptorType, types.GetSetDescriptorType, types.WrapperDescriptorType)
_LEFT_OUT = {
    *("__dict__", "__weakref__", "__doc__", "__module__", "__annotations__", "__annotate_func__"),
    *("__annotations_cache__", "__firstlineno__", "__static_attributes__", "__abstractmethods__", "_abc_impl"),
    *("__dataclass_fields__", "__dataclass_params__"),
}
"""Attributes of a class that do not change what its methods compute."""
_CAUSE = (
    "The identity decides whether the values in a store are kept. State one yourself, version=..., and change it "
    "whenever the values change"
)


def function_identity(function: Callable[..., Any]) -> str:
    """Return the name of a function of this package, or a digest of what another function does."""
    module, name = str(getattr(function, "__module__", "")), getattr(function, "__qualname__", "")
    if module.startswith("spm_pin.") and "<" not in name:
        return f"{module}.{name}"
    try:
        return f"code {_Reader(function).digest(function).hex()[:32]}"
    except RecursionError as error:
        raise _unreadable("with values nested too deeply") from error


def _unreadable(reason: str) -> ArgumentError:
    return ArgumentError("metric", "a function that can be identified", f"one {reason}", _CAUSE)


class _Reader:
    """Computes digests of values, each from the digests of what it is made of."""

    def __init__(self, function: Callable[..., Any]) -> None:
        # The package of the metric itself counts as the user's, also if it is installed.
        self._root_module = _root(function.__module__) if isinstance(function, FunctionType) else ""
        # The values are kept beside their digests, so that no address is used twice.
        self._done: dict[int, tuple[bytes, Any]] = {}
        self._open: dict[int, int] = {}

    def digest(self, value: Any) -> bytes:
        """Return the digest of a value."""
        if type(value) in _PLAIN:
            content = value if isinstance(value, bytes) else repr(value).encode("utf-8", "surrogatepass")
            return hashlib.sha256(type(value).__name__.encode() + b" " + content).digest()
        if id(value) in self._done:
            return self._done[id(value)][0]
        if id(value) in self._open:
            return b"cycle %d" % (len(self._open) - self._open[id(value)])
        self._open[id(value)] = len(self._open)
        digest = hashlib.sha256(type(value).__qualname__.encode())
        for part in map(self.digest, self._parts(value)):
            digest.update(b"%d " % len(part))
            digest.update(part)
        del self._open[id(value)]
        self._done[id(value)] = digest.digest(), value
        return digest.digest()

    def _parts(self, value: Any) -> Iterable[Any]:
        """Return the values that a value is made of."""
        if isinstance(value, FunctionType):
            return self._function(value)
        if isinstance(value, CodeType):
            names = value.co_names, value.co_varnames, value.co_freevars
            return value.co_code, getattr(value, "co_exceptiontable", b""), value.co_consts, *names, value.co_flags
        if isinstance(value, ModuleType):
            members = {name: member for name, member in vars(value).items() if not name.startswith("__")}
            return value.__name__, None if self._is_installed(value.__name__) else members
        if isinstance(value, type):
            return self._class(value)
        if type(value) in (tuple, list):
            return tuple(value)
        if type(value) in (dict, MappingProxyType):
            return tuple(value.items())
        if type(value) in (set, frozenset):
            return sorted(map(self.digest, value))
        if isinstance(value, _WRAPPERS):
            return (value.__wrapped__,)
        if isinstance(value, property):
            return value.fget, value.fset, value.fdel
        if isinstance(value, functools.cached_property):
            return (value.func,)
        if isinstance(value, _DESCRIPTORS):  # of slots and the like: a name without content
            return value.__objclass__.__module__, value.__qualname__
        if isinstance(value, np.ufunc) and not _has_name(value):
            raise _unreadable(f"that uses {value.__name__}, a ufunc whose function cannot be read")
        if isinstance(value, BuiltinFunctionType | np.ufunc):
            owner = getattr(value, "__self__", None)
            return getattr(value, "__module__", ""), value.__name__, None if isinstance(owner, ModuleType) else owner
        if callable(getattr(value, "py_func", None)):  # Numba's functions, whose pickles differ from run to run
            return (value.py_func,)
        return self._object(value)

    def _function(self, function: FunctionType) -> Iterator[Any]:
        if self._by_name(function):
            yield from (function.__module__, function.__qualname__)
            return
        yield from (function.__code__, function.__defaults__, function.__kwdefaults__, vars(function))
        for cell in function.__closure__ or ():
            try:
                yield cell.cell_contents
            except ValueError:
                yield "an empty cell"
        yield from self._globals(function.__code__, function.__globals__)

    def _globals(self, code: CodeType, names: dict[str, Any]) -> Iterator[Any]:
        for name in code.co_names:
            if name not in names:
                continue
            value = names[name]
            if isinstance(value, ModuleType) and not self._is_installed(value.__name__):
                # Each name may be an attribute of the module; a module inside it is read as a whole.
                value = {name: member for name, member in vars(value).items() if name in code.co_names}
            yield from (name, value)
        for constant in code.co_consts:
            if isinstance(constant, CodeType):
                yield from self._globals(constant, names)

    def _class(self, kind: type) -> Iterator[Any]:
        yield from (kind.__module__, kind.__qualname__)
        if not self._by_name(kind):
            yield kind.__bases__
            yield {name: value for name, value in vars(kind).items() if name not in _LEFT_OUT}

    def _object(self, value: Any) -> tuple[Any, ...]:
        """Return an object as it is pickled: its class, the arguments that make it, and its state."""
        kind = type(value)
        try:
            reduce = copyreg.dispatch_table.get(kind)
            reduced = value.__reduce_ex__(4) if reduce is None else reduce(value)
        except Exception as error:
            raise _unreadable(f"that uses a {kind.__qualname__}, which cannot be read: {error}") from error
        if isinstance(reduced, str):
            if not self._is_installed(getattr(value, "__module__", None) or kind.__module__):
                raise _unreadable(f"that uses {reduced}, a {kind.__qualname__} that is known by name alone")
            return kind, reduced
        make, arguments, state, items, pairs = (*reduced, None, None, None)[:5]
        return kind, make, arguments, state, list(items or ()), dict(pairs or ())

    def _by_name(self, value: FunctionType | type) -> bool:
        return self._is_installed(value.__module__) and "<locals>" not in value.__qualname__

    def _is_installed(self, module: str | None) -> bool:
        return bool(module) and _root(module) != self._root_module and _is_installed(_root(module))


def _has_name(function: np.ufunc) -> bool:
    """Return whether a ufunc is the one that NumPy or SciPy has below its name."""
    modules = (sys.modules.get(name) for name in ("numpy", "scipy.special"))
    return any(getattr(module, function.__name__, None) is function for module in modules)


def _root(module: str | None) -> str:
    return str(module).partition(".")[0]


@functools.cache
def _is_installed(root: str) -> bool:
    """Return whether a top-level module comes with Python or from an installed package."""
    if root in sys.stdlib_module_names or root == "spm_pin":
        return True
    module = sys.modules.get(root)
    file = getattr(module, "__file__", None)
    files = [file] if file else getattr(module, "__path__", ())
    folders = [Path(sysconfig.get_path(name)).resolve() for name in ("purelib", "platlib")]
    return any(Path(file).resolve().is_relative_to(folder) for file in files for folder in folders)
