"""An open cube for type checkers: `zarr.Group` types arrays and groups alike."""

from collections.abc import Iterator
from typing import Any, Protocol


class CubeGroup(Protocol):
    """The arrays and attributes of an open store, by name."""

    @property
    def attrs(self) -> Any:
        """Its attributes."""
        ...

    @property
    def store_path(self) -> Any:
        """Where it is."""
        ...

    def __getitem__(self, name: str) -> Any: ...

    def __contains__(self, name: str) -> bool: ...

    def arrays(self) -> Iterator[tuple[str, Any]]:
        """All arrays with their names."""
        ...
