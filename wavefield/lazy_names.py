"""Import the public names of a package on first use, so that `import wavefield` is fast.

Used instead of lazy_loader.attach_stub, which accepts neither absolute imports nor `as` in a stub.
"""

import ast
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any


def lazy_names(
    package: str, init_file: str
) -> tuple[list[str], Callable[[str], Any], Callable[[], list[str]]]:
    """Return the sorted public names of a package, and functions for its `__getattr__` and `__dir__`.
    These names are imported in the stub (.pyi) next to `init_file`, the package's ``__init__.py``."""
    stub = ast.parse(Path(init_file).with_suffix(".pyi").read_text(encoding="utf-8"))
    places = {
        alias.asname or alias.name: (statement.module or "", alias.name)
        for statement in stub.body
        if isinstance(statement, ast.ImportFrom)
        for alias in statement.names
    }

    def get(name: str) -> Any:
        if name not in places:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module, name_there = places[name]
        return getattr(import_module(module), name_there)

    names = sorted(places)
    return names, get, lambda: names
