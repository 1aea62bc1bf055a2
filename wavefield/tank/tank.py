"""A tank: the sea, the cameras and the beads of a scene, and the images that the cameras take."""

from collections.abc import Iterable
from dataclasses import replace
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import gaussian_filter

from wavefield.rig import Camera, Rig
from wavefield.tank import beads as floating
from wavefield.tank import light_sheet_scene, rendered_targets, rigs, scene_parts, sensor, texture
from wavefield.tank.basin import Basin
from wavefield.tank.scene import Scene
from wavefield.tank.sea import Sea
from wavefield.tank.truth import Truth, truth

Array = NDArray[np.float64]

_SOUND = scene_parts.Fault()


class Tank:
    """The tank of a scene.

    Parameters
    ----------
    scene : Scene
        What to simulate.

    Examples
    --------
    >>> from wavefield.tank import Scene
    >>> small = Scene.load("demo").with_(rig={"crop": 0.1}, sea={"shortest": 0.3})
    >>> tank = Tank(small)
    >>> tank.render(0)["cam1"].shape
    (102, 102)
    """

    def __init__(self, scene: Scene):
        self.scene = scene
        self.rig: Rig = scene.build_rig()
        self.sea: Sea = scene.build_sea()
        reach = max(self.sea.reach, 0.01)
        margin = 0.01 if isinstance(scene.surface, scene_parts.Sheet) else 0.05
        self.x, self.y = rigs.bounds(self.rig, -reach, reach, margin)
        # what moves between two frames must stay inside the basin
        air = 0.15 + 2.0 * max(np.hypot(*self.sea.current) / scene.frame_rate, 0.0)
        self.basin = Basin(self.sea, (self.x[0] - air, self.x[1] + air), (self.y[0] - air, self.y[1] + air))

        self._drift: tuple[int, list[RectBivariateSpline]] = (-1, [])

    def time(self, frame: float) -> float:
        """Time of the sea at a frame (or between two), as the frame rate has it, s."""
        return self.scene.start + frame / self.scene.frame_rate

    def frame_time(self, frame: float) -> float:
        """Time of the sea when a frame is taken, s."""
        jitter = self.scene.timing.jitter
        if not jitter:
            return self.time(frame)
        return self.time(frame) + jitter * float(
            np.random.default_rng([self.scene.seed, 11, int(frame)]).normal()
        )

    @cached_property
    def population(self) -> floating.Population | light_sheet_scene.Particles:
        """The beads, or the particles of a light sheet."""
        settings = self.scene.surface
        if isinstance(settings, scene_parts.Sheet):
            return light_sheet_scene.Particles(
                settings, self.x, self.y, len(self.rig), self.scene.frame_rate, self.scene.seed
            )
        if not isinstance(settings, scene_parts.Beads):
            raise ValueError("this scene has a painted surface, no beads")
        rng = np.random.default_rng([self.scene.seed, 6])
        # holes where all cameras look, so that a scene has as many as it says
        number = settings.holes
        places = [
            rng.uniform(0.9 * lo + 0.1 * hi, 0.1 * lo + 0.9 * hi, number)
            for lo, hi in (self.scene.grid.x, self.scene.grid.y)
        ]
        low, high = np.broadcast_to(np.array(settings.hole_diameter), 2)
        holes = np.stack([*places, rng.uniform(low, high, number)], axis=1)
        return floating.Population(
            self.basin,
            self.x,
            self.y,
            density=settings.density,
            clustered=settings.clustered,
            holes=holes,
            renewal=settings.renewal,
            one_camera=settings.one_camera,
            spread=settings.spread,
            spread_between=settings.spread_between,
            cameras=len(self.rig),
            submerged=(settings.submerged, settings.submerged_depth),
            time=self.frame_time,
            frame_rate=self.scene.frame_rate,
            seed=self.scene.seed,
        )

    @cached_property
    def _light(self) -> dict[str, NDArray[np.float32]]:
        light = self.scene.light
        return {
            name: sensor.uneven(self.rig[name].size, light.unevenness, self.scene.seed * 97 + number)
            for number, name in enumerate(self.rig)
        }

    @cached_property
    def _paint(self) -> texture.Paint:
        settings = self.scene.surface
        assert isinstance(settings, scene_parts.Texture)
        mesh = settings.mesh or 1.5 * max(max(rigs.pixel_footprint(self.rig[name])) for name in self.rig)
        return texture.Paint(self.basin.x, self.basin.y, mesh, self.scene.seed)

    def truth(self, step: int) -> Truth:
        """Exact answer for the step from a frame to the next.

        Parameters
        ----------
        step : int
            Number of the step's first frame.

        Returns
        -------
        Truth
        """
        if isinstance(self.scene.surface, scene_parts.Sheet):
            particles = self.population
            assert isinstance(particles, light_sheet_scene.Particles)
            nodes = np.meshgrid(self.scene.grid.x_nodes, self.scene.grid.y_nodes)
            return particles.truth(nodes[0], nodes[1], self.time(step + 0.5))
        return truth(self.basin, self.scene.grid, self.time(step + 0.5), 1.0 / self.scene.frame_rate)

    def spot_width(self, camera: Camera) -> float:
        """Standard deviation of a bead's image before the pixels integrate it.

        Parameters
        ----------
        camera : Camera
            The camera.

        Returns
        -------
        float
            px: the blur and the bead's own size (variance of a disc: a quarter of its radius squared).
        """
        size = 0.0 if isinstance(self.scene.surface, scene_parts.Texture) else self.scene.surface.diameter
        pixel = float(np.sqrt(np.prod(rigs.pixel_footprint(camera))))
        return float(np.hypot(self.scene.light.blur, size / 4 / pixel))

    def render(self, frame: int, cameras: Iterable[str] | None = None) -> dict[str, NDArray[Any]]:
        """Images that the cameras take at one frame.

        Parameters
        ----------
        frame : int
            Frame number, from 0; ask in rising order (beads are followed from frame to frame).
        cameras : iterable of str, optional
            Which cameras; all by default.

        Returns
        -------
        dict of str to ndarray, (row, column), uint8 or uint16
        """
        out = {}
        for name in self.rig if cameras is None else cameras:
            fault = self.scene.faults.get(name, _SOUND)
            taken, source = max(frame - fault.late, 0), fault.shows or name
            if not isinstance(self.scene.surface, scene_parts.Texture):
                image = self._beads(self.population.frame(taken), taken, source, fault)
            else:
                image = self._painted(taken, source, fault)
            out[name] = np.ascontiguousarray(image[:, ::-1]) if fault.mirrored else image
        return out

    def photograph(
        self, beads: floating.BeadField, frame: int, cameras: Iterable[str] | None = None
    ) -> dict[str, NDArray[Any]]:
        """Images of given beads.

        Parameters
        ----------
        beads : Beads
            Positions and brightness.
        frame : int
            Frame number: it chooses the noise and the flicker.
        cameras : iterable of str, optional
            Which cameras; all by default.

        Returns
        -------
        dict of str to ndarray, (row, column), uint8 or uint16
        """
        return {
            name: self._beads(beads, frame, name, _SOUND)
            for name in (self.rig if cameras is None else cameras)
        }

    def _beads(
        self, beads: floating.BeadField, frame: int, name: str, fault: scene_parts.Fault
    ) -> NDArray[Any]:
        settings, camera = self.scene.surface, _shifted(self.rig[name], fault.shift)
        assert not isinstance(settings, scene_parts.Texture)
        if any(fault.turned) and frame >= fault.since:
            camera = _turned(camera, fault.turned)
        if fault.delay:
            beads = self._later(beads, self.frame_time(frame), fault.delay)
        X, Y = camera.project(beads.x, beads.y, beads.z)
        if fault.row_time:
            X, Y = self._rolling(camera, beads, frame, fault.row_time)
        sharp = self.spot_width(self.rig[name])
        image = np.zeros(camera.size[::-1], np.float32)
        flux = settings.brightness * 2 * np.pi * sharp**2 * beads.brightness[list(self.rig).index(name)]
        sensor.splat(image, X, Y, flux, float(np.hypot(sharp, fault.defocus)))
        return self._expose(image, name, frame)

    def _later(self, beads: floating.BeadField, time: float, delay: float) -> floating.BeadField:
        """The same beads a moment later."""
        x, y = floating.carry(self.basin, beads.x, beads.y, time, time + delay)
        x, y = np.where(np.isnan(x), beads.x, x), np.where(np.isnan(y), beads.y, y)
        (z,) = self.basin.snapshot(time + delay, ("z",))(x, y)
        return replace(beads, x=x, y=y, z=z)

    def _rolling(
        self, camera: Camera, beads: floating.BeadField, frame: int, row_time: float
    ) -> tuple[Array, Array]:
        """Columns and rows of beads where each row is read `row_time` after the one above it, px."""
        middle = (camera.size[1] - 1) / 2
        half = row_time * middle
        at = [beads, self._later(beads, self.frame_time(frame), half)]
        at.insert(0, self._later(beads, self.frame_time(frame), -half))
        before, here, after = (np.stack(camera.project(b.x, b.y, b.z)) for b in at)
        image = here
        for _ in range(4):  # the row is read when it is; a bead moves by a few rows at most
            s = np.clip((image[1] - middle) / middle, -1.5, 1.5)
            image = here + 0.5 * s * (after - before) + 0.5 * s * s * (after - 2 * here + before)
        return image[0], image[1]

    @cached_property
    def target_poses(self) -> dict[str, rendered_targets.Pose]:
        """Poses of the target by name of the image: ``tilt_0``, ``tilt_1``, ..., ``flat``."""
        settings, grid = self.scene.calibration, self.scene.grid
        tilted = rendered_targets.poses(settings.tilted, settings.tilt, grid.x, grid.y, self.scene.seed)
        flat = rendered_targets.Pose(np.eye(3), np.array([0.0, 0.0, settings.level]))
        return {f"tilt_{i}": pose for i, pose in enumerate(tilted)} | {"flat": flat}

    @cached_property
    def target_offsets(self) -> Array | None:
        """Errors of the target's crossings, (n, n, 3), metres; None for other targets than strings."""
        target = self.scene.calibration.target
        return (
            rendered_targets.node_offsets(target, self.scene.seed)
            if isinstance(target, scene_parts.Strings)
            else None
        )

    def target_image(self, name: str, camera: str) -> NDArray[Any]:
        """Image of the calibration target.

        Parameters
        ----------
        name : str
            A name of `target_poses`.
        camera : str
            Which camera.

        Returns
        -------
        ndarray, (row, column), uint8 or uint16
        """
        image = rendered_targets.draw(
            self.rig[camera],
            self.scene.calibration.target,
            self.target_poses[name],
            self.scene.light.blur,
            self.target_offsets,
        )
        return self._expose(image, camera, -1 - list(self.target_poses).index(name))

    def _painted(self, frame: int, name: str, fault: scene_parts.Fault) -> NDArray[Any]:
        settings = self.scene.surface
        assert isinstance(settings, scene_parts.Texture)
        snapshot = self.basin.snapshot(self.time(frame), ("z",))
        x, y = texture.cast(_shifted(self.rig[name], fault.shift), snapshot)
        if settings.carried and frame:
            x, y = self._origin(x, y, frame)
        image = settings.mean + settings.contrast * self._paint(x, y)
        if fault.defocus:
            image = gaussian_filter(image, fault.defocus, mode="nearest")
        return self._expose(image, name, frame)

    def _origin(self, x: Array, y: Array, frame: int) -> tuple[Array, Array]:
        """Where the water now at (x, y) was at the first frame: followed backwards from a lattice."""
        drift = self._drift  # one name for it: other threads may be drawing other frames
        if drift[0] != frame:
            axes = [np.arange(lo, hi, 0.01) for lo, hi in (self.x, self.y)]
            px, py = np.meshgrid(*axes)
            ax, ay = floating.carry(self.basin, px, py, self.time(frame), self.time(0))
            lost = np.isnan(ax) | np.isnan(ay)
            back = [np.where(lost, 0.0, a - p) for a, p in ((ax, px), (ay, py))]
            self._drift = drift = (frame, [RectBivariateSpline(axes[1], axes[0], b) for b in back])
        return x + drift[1][0].ev(y, x), y + drift[1][1].ev(y, x)

    def _expose(self, image: NDArray[np.float32], name: str, frame: int) -> NDArray[Any]:
        light, number = self.scene.light, list(self.rig).index(name)
        rng = np.random.Generator(np.random.SFC64([self.scene.seed, 7, number, frame + 1000]))
        factor = light.gain.get(name, 1.0) * max(0.05, 1.0 + light.flicker * rng.standard_normal())
        image = (image + np.float32(light.background)) * (self._light[name] * np.float32(factor))
        return sensor.expose(image, light.read_noise, light.shot_noise, light.bits, rng)


def _shifted(camera: Camera, shift: tuple[float, float]) -> Camera:
    """A camera whose whole picture has moved by columns and rows, px."""
    return replace(camera, cx=camera.cx + shift[0], cy=camera.cy + shift[1]) if any(shift) else camera


def _turned(camera: Camera, degrees: tuple[float, float, float]) -> Camera:
    """A camera turned about its own centre."""
    turn = cv2.Rodrigues(np.radians(degrees))[0]
    return replace(camera, rotation=turn @ camera.R, translation=turn @ camera.T)


def render(scene: Scene, frame: int) -> dict[str, NDArray[Any]]:
    """Images of one frame of a scene.

    For several frames make a `Tank` and use its `render`, which remembers the beads.

    Parameters
    ----------
    scene : Scene
        What to simulate.
    frame : int
        Frame number, from 0.

    Returns
    -------
    dict of str to ndarray, (row, column), uint8 or uint16
    """
    return Tank(scene).render(frame)
