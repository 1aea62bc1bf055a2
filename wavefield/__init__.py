"""Water-surface elevation and velocity from three cameras, and the waves in them."""

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import Any

try:
    __version__ = version("wavefield")
except PackageNotFoundError:  # run from a source tree that is not installed
    __version__ = "0+unknown"

# public name -> where it lives; imported on first use, so that `import wavefield` stays quick
_PUBLIC = {
    "Camera": "wavefield.rig",
    "Rig": "wavefield.rig",
    "load_rig": "wavefield.rig.formats",
    "Grid": "wavefield.grid",
    "Experiment": "wavefield.series",
    "Settings": "wavefield.measurement",
    "reconstruct": "wavefield.cubes",
    "open_cube": "wavefield.cubes",
    "spectrum": "wavefield.waves",
    "komega": "wavefield.waves",
    "analyze": "wavefield.waves",
    "Scene": "wavefield.tank",
    "simulate": "wavefield.tank",
}

__all__ = ["__version__", *sorted(_PUBLIC)]


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module 'wavefield' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
