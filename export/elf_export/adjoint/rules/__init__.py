"""The rules, a file for each family of ops: every module here registers its own by being imported.

A rule opens with its equation and shapes.  It may import the registry and the emitting helpers
of `adjoint`, and neither the engine nor what is built on it.
"""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules

for _module in iter_modules(__path__):
    import_module(f"{__name__}.{_module.name}")
