"""Water-surface elevation and velocity from three cameras, and the waves in them."""

import ast
from importlib import import_module
from pathlib import Path
from typing import Any


def _public() -> dict[str, tuple[str, str]]:
    """Public name -> module and name there, from the stub that type checkers read."""
    stub = ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    return {
        alias.asname or alias.name: (statement.module or "", alias.name)
        for statement in stub.body
        if isinstance(statement, ast.ImportFrom)
        for alias in statement.names
    }


_PUBLIC = _public()  # imported on first use, so that `import wavefield` stays quick
__all__ = ["__version__", *sorted(_PUBLIC)]


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version  # half of what `wavefield --help` would cost

    try:
        return version("wavefield")
    except PackageNotFoundError:  # run from a source tree that is not installed
        return "0+unknown"


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return globals().setdefault(name, _version())
    if name in _PUBLIC:
        module, there = _PUBLIC[name]
        return getattr(import_module(module), there)
    raise AttributeError(f"module 'wavefield' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
