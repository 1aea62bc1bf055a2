import numpy as np

from wavefield.matching import match
from wavefield.measurement import Settings
from wavefield.measurement.images import BETWEEN_CAMERAS, ready, sharpened


def test_beads_that_cameras_see_differently_bright_pull_less_where_images_are_sharp() -> None:
    rng = np.random.default_rng(4)
    y, x = np.mgrid[:160, :200]
    one, other = np.full((2, 160, 200), 12.0)
    for px, py, a in zip(rng.uniform(0, 200, 1000), rng.uniform(0, 160, 1000), rng.uniform(50, 200, 1000)):
        bead = a * np.exp(-((x - px) ** 2 + (y - py) ** 2) / 1.2)
        one += bead * rng.uniform(0.7, 1.3)
        other += bead * rng.uniform(0.7, 1.3)
    settings = Settings().stereo

    def error(amount: float) -> float:
        d = match(*(sharpened(ready(image, 1), amount) for image in (one, other)), settings)
        return float(np.sqrt(np.mean(np.square(d.u[2:-2, 2:-2]))))

    assert error(BETWEEN_CAMERAS) < 0.75 * error(0.0)
