"""Draw the README's picture from a demo: `python docs/make_picture.py wavefield-demo`."""

import sys
from pathlib import Path

import cv2
import numpy as np

from wavefield import figures
from wavefield.pipeline import open_cube
from wavefield.reports.numbers import snapshot

PAGE = Path(__file__).with_name("surface.jpg")


def drawn(figure: object) -> np.ndarray:
    """A figure as an image, (row, column, BGR)."""
    return cv2.imdecode(np.frombuffer(figure._repr_png_(), np.uint8), cv2.IMREAD_COLOR)  # type: ignore[attr-defined]


def main(demo: Path) -> None:
    """Put the surface and its velocity side by side."""
    moment = snapshot(open_cube(demo / "cube.zarr"))
    panels = [drawn(figures.surface_3d(moment)), drawn(figures.velocity_map(moment))]
    height = min(panel.shape[0] for panel in panels)
    sized = [
        cv2.resize(p, (round(p.shape[1] * height / p.shape[0]), height), interpolation=cv2.INTER_AREA)
        for p in panels
    ]
    cv2.imwrite(str(PAGE), np.hstack(sized), [cv2.IMWRITE_JPEG_QUALITY, 88])
    print(f"wrote {PAGE}, {PAGE.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "wavefield-demo"))
