"""Paths of what is made from a cube."""

from pathlib import Path


def beside(store: Path, kind: str, ending: str) -> Path:
    """Default path of something that is made from a cube.

    Examples
    --------
    >>> beside(Path("a/cube.zarr"), "waves", ".zarr").as_posix()
    'a/waves.zarr'
    >>> beside(Path("a/run7.zarr"), "report", ".html").as_posix()
    'a/run7_report.html'
    """
    stem = store.name.removesuffix(".zarr")
    return store.with_name((stem.replace("cube", kind) if "cube" in stem else f"{stem}_{kind}") + ending)
