"""Measure the elevation and velocity of a water surface with several cameras, and analyse its waves."""

from typing import Any

from wavefield.lazy_names import lazy_names

_names, _get, _ = lazy_names(__name__, __file__)
__all__ = ["__version__", *_names]


def _version() -> str:
    """Return the version of the installed package; "0+unknown" if wavefield is not installed."""
    from importlib.metadata import PackageNotFoundError, version  # half of what `wavefield --help` would cost

    try:
        return version("wavefield")
    except PackageNotFoundError:  # run from a source tree that is not installed
        return "0+unknown"


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return globals().setdefault(name, _version())
    return _get(name)


def __dir__() -> list[str]:
    return sorted(__all__)
