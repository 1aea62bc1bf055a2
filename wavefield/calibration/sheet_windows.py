"""Windows of images dewarped to z = 0: the disparity of the cameras in a light sheet, and its thickness."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from wavefield.calibration.disparity import Correlation, disparities, particles, peak_length
from wavefield.measurement.frame import usable
from wavefield.measurement.rectify import rectify, sight_map
from wavefield.rig import Rig
from wavefield.rig.field import common_field
from wavefield.rig.lens import Array
from wavefield.rig.pairs import pairs_of
from wavefield.rig.resolution import pixel_at

MIN_WINDOWS = 100  # windows overlap where fewer would fit next to each other
STD_PER_THICKNESS = 4.0  # standard deviations of a Gaussian sheet between the places where its light is 1/e2

Read = Callable[[str, int], NDArray[np.generic] | None]  # an image by camera and frame


class SheetWindows:
    """Disparity of each pair of cameras in windows of the dewarped images, from all instants together."""

    def __init__(self, rig: Rig, side: int, read: Read, instants: Sequence[int]) -> None:
        self.rig = rig
        field = common_field(rig.cameras.values(), height=0.0, margin=4.0)
        self.pixel = max(pixel_at(rig[n], float(np.mean(field.x)), float(np.mean(field.y))) for n in rig)
        x, y = (np.arange(lo, hi, self.pixel) for lo, hi in (field.x, field.y))
        side = min(side, x.size, y.size) // 2 * 2
        step, rows, columns = side, range(0), range(0)
        while len(rows) * len(columns) < MIN_WINDOWS and step > 4:
            step //= 2
            rows, columns = (range(0, n - side + 1, step) for n in (y.size, x.size))
        self.count = len(rows) * len(columns)
        middle = (side - 1) / 2
        self.x, self.y = np.meshgrid(
            x[0] + self.pixel * (np.array(columns) + middle), y[0] + self.pixel * (np.array(rows) + middle)
        )
        self.pairs = pairs_of(rig, tuple(rig))
        self._correlations = {pair: Correlation(rows, columns, side) for pair in self.pairs}
        self.instants = self._add(read, instants, x, y)
        self._planes = {pair: total.planes() for pair, total in self._correlations.items()}
        self._disparities = {pair: disparities(planes) for pair, planes in self._planes.items()}

    def _add(self, read: Read, instants: Sequence[int], x: Array, y: Array) -> int:
        """Correlate all instants; returns how many had the images of a pair."""
        maps = {name: sight_map(self.rig[name], x, y) for name in self.rig}
        used = 0
        for k in instants:
            flat = {}
            for name, (X, Y, visible) in maps.items():
                image = read(name, k)
                if image is not None and usable(image, self.rig[name].size):
                    flat[name] = particles(rectify(image, X, Y).astype(np.float32), visible)
            pairs = [(a, b) for a, b in self.pairs if a in flat and b in flat]
            for a, b in pairs:
                self._correlations[a, b].add(flat[a], flat[b])
            used += bool(pairs)
        return used

    def matches(self) -> dict[str, Array]:
        """Pixels of the same places of the sheet in each camera, (windows, 2); NaN where there is none."""
        reference = self.pairs[0][0]
        out = {reference: self._pixels(reference, np.zeros((*self.x.shape, 2)))}
        out |= {name: self._pixels(name, shift) for (_, name), shift in self._disparities.items()}
        return {name: out[name] for name in self.rig}

    def _pixels(self, name: str, shift: Array) -> Array:
        dx, dy = np.moveaxis(shift * self.pixel, -1, 0)
        return np.stack(self.rig[name].project(self.x + dx, self.y + dy, 0.0), axis=-1).reshape(-1, 2)

    def rms(self) -> float:
        """Disparity, px."""
        squares = [np.sum(np.square(shift), axis=-1) for shift in self._disparities.values()]
        return float(np.sqrt(np.nanmean(squares)))

    def thickness(self) -> float:
        """Thickness of the sheet at 1/e2, metres.
        The light of both cameras makes the correlation, which is therefore narrower by root 2.
        """
        out = []
        for (a, b), planes in self._planes.items():
            lines = [np.stack(self.rig[n].sight_line(self.x, self.y), axis=-1) for n in (a, b)]
            along = (lines[1] - lines[0]) / self.pixel
            length = peak_length(planes, self._correlations[a, b].own(), self._disparities[a, b], along)
            parallax = float(np.mean(np.linalg.norm(along, axis=-1)))
            out.append(STD_PER_THICKNESS * np.sqrt(2.0) * length / parallax)
        return float(np.mean(out))
