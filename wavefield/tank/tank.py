"""A simulated tank: the sea, the beads and the cameras of a scene, and the images that cameras take of it."""

from collections.abc import Iterable
from dataclasses import replace
from functools import cached_property
from threading import Lock

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import gaussian_filter

from wavefield.rig import Camera, Rig
from wavefield.rig.field import view_on_water
from wavefield.tank import rigs, sensor, targets, texture
from wavefield.tank.beads import BeadField, FrameHistory, Population, carry
from wavefield.tank.light_sheet_scene import Particles
from wavefield.tank.scene import Scene
from wavefield.tank.scene_parts import Fault, SeaSurface, Sheet, Strings, Texture
from wavefield.tank.sea import Basin, Sea
from wavefield.tank.truth import Truth, truth

Array = NDArray[np.float64]
GreyImage = NDArray[np.unsignedinteger]

MIN_REACH = 0.01  # beads cover what the cameras see up to this height at least, m
MARGIN = 0.05  # width of the strip of beads around what the cameras see, m
SHEET_MARGIN = 0.01  # width of the strip of particles around the view of a light sheet, m
DRIFT_STEPS = 300  # lattice steps along x on which painted water is followed back in time

_NO_FAULT = Fault()


class Tank:
    """The simulated tank of a scene. It renders images and gives the exact fields.

    Parameters
    ----------
    scene : Scene
        Settings of the simulated experiment.

    Examples
    --------
    >>> from wavefield.tank import Scene
    >>> small = Scene.load("demo").with_(rig={"crop": 0.1}, sea={"shortest": 0.3})
    >>> tank = Tank(small)
    >>> tank.render(0)["cam1"].shape
    (102, 102)
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.time = scene.time
        self.frame_time = scene.frame_time
        self.rig: Rig = scene.build_rig()
        self.sea: Sea = scene.build_sea()
        reach = max(self.sea.reach, MIN_REACH)
        margin = SHEET_MARGIN if isinstance(scene.surface, Sheet) else MARGIN
        self.x, self.y = rigs.bounds(self.rig, -reach, reach, margin)
        # beads that move between two frames must stay inside the basin
        air = 0.15 + 2.0 * np.hypot(*self.sea.current) / scene.frame_rate
        self.basin = Basin(self.sea, (self.x[0] - air, self.x[1] + air), (self.y[0] - air, self.y[1] + air))
        self._drift_step = (self.x[1] - self.x[0]) / DRIFT_STEPS
        self._drift_lock = Lock()

    @cached_property
    def population(self) -> Population | Particles:
        """The beads of the scene, or the particles of its light sheet; ValueError if it has neither."""
        if isinstance(self.scene.surface, Sheet):
            return Particles(self.scene, self.scene.surface, self.x, self.y, len(self.rig))
        return Population(self.scene, self.basin, self.x, self.y, len(self.rig))

    def truth(self, step: int) -> Truth:
        """Return the exact fields of a step, which goes from frame `step`, counted from 0, to the next."""
        grid, time = self.scene.grid, self.time(step + 0.5)
        if isinstance(self.scene.surface, Sheet):
            assert isinstance(self.population, Particles)
            node_x, node_y = np.meshgrid(grid.x_nodes, grid.y_nodes)
            return self.population.truth(node_x, node_y, time)
        return truth(self.basin, grid, time, 1.0 / self.scene.frame_rate)

    def spot_width(self, camera: Camera) -> float:
        """Return the standard deviation of a bead's image, px, due to the lens blur and the bead's size."""
        surface = self.scene.surface
        size = 0.0 if isinstance(surface, (Texture, SeaSurface)) else surface.diameter
        pixel = float(np.sqrt(np.prod(rigs.pixel_footprint(camera))))
        return float(np.hypot(self.scene.light.blur, size / 4 / pixel))

    def render(self, frame: int, cameras: Iterable[str] | None = None) -> dict[str, GreyImage]:
        """Return the images (row, column) of a frame, counted from 0, by camera; None means all cameras.
        Requests in rising order of frames are fast, because beads are followed from frame to frame."""
        names = self.rig if cameras is None else cameras
        return {name: self.draw(name, frame, self.beads(name, frame)) for name in names}

    def beads(self, name: str, frame: int) -> BeadField | None:
        """Return the beads that the camera `name` records in a frame; a late camera records an earlier frame.
        Returns None if the water has no beads (painted surface or open sea)."""
        if isinstance(self.scene.surface, (Texture, SeaSurface)):
            return None
        return self.population.frame(self._frame_taken(name, frame))

    def draw(self, name: str, frame: int, beads: BeadField | None) -> GreyImage:
        """Return the image (row, column) of the camera `name` for a frame, with the faults of the camera.
        `beads` is the result of `Tank.beads` for this camera and frame. Threads may call `draw`
        concurrently."""
        fault = self.scene.faults.get(name, _NO_FAULT)
        frame, source = self._frame_taken(name, frame), fault.shows or name
        if isinstance(self.scene.surface, SeaSurface):
            light = self._open_sea(frame, source, self.scene.surface)
        elif beads is None:
            light = self._painted(frame, source, fault)
        else:
            light = self._beads(beads, frame, source, fault)
        image = self._expose(light, source, frame)
        return np.ascontiguousarray(image[:, ::-1]) if fault.mirrored else image

    def _frame_taken(self, name: str, frame: int) -> int:
        return max(frame - self.scene.faults.get(name, _NO_FAULT).late, 0)

    def _beads(self, beads: BeadField, frame: int, name: str, fault: Fault) -> NDArray[np.float32]:
        """Return the noise-free image (row, column) of the beads in camera `name`, grey levels 0 to 255.
        `fault` holds shift, turn, delay and defocus of the camera."""
        assert not isinstance(self.scene.surface, (Texture, SeaSurface))
        camera = _shifted(self.rig[name], fault.shift)
        if any(fault.turned) and frame >= fault.since:
            camera = _turned(camera, fault.turned)
        if fault.delay:
            beads = self._delayed(beads, self.frame_time(frame), fault.delay)
        X, Y = camera.project(beads.x, beads.y, beads.z)
        if fault.row_time:
            X, Y = self._rolling(camera, beads, frame, fault.row_time)
        width = self.spot_width(self.rig[name])
        spot_flux = self.scene.surface.brightness * 2 * np.pi * width**2
        flux = spot_flux * beads.brightness[list(self.rig).index(name)]
        image = np.zeros(camera.size[::-1], np.float32)
        sensor.splat(image, X, Y, flux, float(np.hypot(width, fault.defocus)))
        return image

    def _delayed(self, beads: BeadField, time: float, delay: float) -> BeadField:
        x, y = carry(self.basin, beads.x, beads.y, time, time + delay)
        x, y = np.where(np.isnan(x), beads.x, x), np.where(np.isnan(y), beads.y, y)
        (z,) = self.basin.snapshot(time + delay, ("z",))(x, y)
        return replace(beads, x=x, y=y, z=z)

    def _rolling(self, camera: Camera, beads: BeadField, frame: int, row_time: float) -> tuple[Array, Array]:
        """Return columns and rows (n,), px, of beads in an image whose rows are exposed one after the other.
        `row_time`, s, is the time from one row to the next; the middle row is exposed at the time of
        `frame`."""
        middle = (camera.size[1] - 1) / 2
        time, half = self.frame_time(frame), row_time * middle
        moments = (self._delayed(beads, time, -half), beads, self._delayed(beads, time, half))
        before, here, after = (np.stack(camera.project(b.x, b.y, b.z)) for b in moments)
        image = here
        for _ in range(4):  # a bead moves by a few rows at most while the image is read
            s = np.clip((image[1] - middle) / middle, -1.5, 1.5)
            image = here + 0.5 * s * (after - before) + 0.5 * s * s * (after - 2 * here + before)
        return image[0], image[1]

    @cached_property
    def _paint(self) -> texture.Paint:
        assert isinstance(self.scene.surface, Texture)
        coarsest = max(max(rigs.pixel_footprint(self.rig[name])) for name in self.rig)
        mesh = self.scene.surface.mesh or 1.5 * coarsest
        return texture.Paint(self.basin.x, self.basin.y, mesh, self.scene.seed)

    def _painted(self, frame: int, name: str, fault: Fault) -> NDArray[np.float32]:
        """Return the noise-free image (row, column) of textured water in camera `name`, grey levels 0 to 255.
        `fault` holds shift and defocus of the camera."""
        settings = self.scene.surface
        assert isinstance(settings, Texture)
        snapshot = self.basin.snapshot(self.time(frame), ("z", "z_x", "z_y"))
        seen = texture.visible_water(
            _shifted(self.rig[name], fault.shift), snapshot, max(self.sea.reach, MIN_REACH)
        )
        x, y = seen.x, seen.y
        if settings.carried:  # look up the texture where the water was at the first frame
            drift = self._drift_since_start(frame)
            x, y = x + drift[0].ev(y, x), y + drift[1].ev(y, x)
        image = settings.mean + settings.contrast * self._paint(x, y)
        return gaussian_filter(image, fault.defocus, mode="nearest") if fault.defocus else image

    @cached_property
    def _sea_paints(self) -> tuple[tuple[texture.Paint, ...], ...]:
        """Two textures of ripples, then two of foam; the two of a kind have grains of different sizes."""
        settings = self.scene.surface
        assert isinstance(settings, SeaSurface)

        def paint(kind: int, size: int) -> texture.Paint:
            mesh, seed = settings.mesh * 2 ** (kind + size), self.scene.seed + 100 * kind + size
            return texture.Paint(self.basin.x, self.basin.y, mesh, seed)

        return tuple((paint(kind, 0), paint(kind, 1)) for kind in range(2))

    def _open_sea(self, frame: int, name: str, settings: SeaSurface) -> NDArray[np.float32]:
        """Return the noise-free image (row, column) of sea and sky in camera `name`, grey levels 0 to 255."""
        camera = self.rig[name]
        snapshot = self.basin.snapshot(self.time(frame), ("z", "z_x", "z_y"))
        seen = texture.visible_water(camera, snapshot, self.sea.reach)
        moved = self._drift_since_start(frame)
        far = float(np.hypot(*view_on_water(camera).T).max())
        ripples, foam = (
            texture.texture_at(seen, moved, paints, far) / np.float32(np.sqrt(len(paints)))
            for paints in self._sea_paints
        )
        image = texture.sea_image(camera, seen, settings, foam, ripples)
        return np.asarray(gaussian_filter(image, self.scene.light.blur, mode="nearest"), np.float32)

    def _drift_since_start(self, frame: int) -> list[RectBivariateSpline]:
        """Return the displacement, m, from the position of water at `frame` back to its position at frame 0.
        The result is a spline for x and one for y; both are functions of (y, x) at `frame`, m."""
        with self._drift_lock:  # other threads may be drawing other frames
            return self._drifts[frame]

    @cached_property
    def _drifts(self) -> FrameHistory[list[RectBivariateSpline]]:
        x, y = (np.arange(low, high, self._drift_step) for low, high in (self.x, self.y))
        lattice_x, lattice_y = np.meshgrid(x, y)

        def advance(earlier: list[RectBivariateSpline], frame: int) -> list[RectBivariateSpline]:
            before = carry(self.basin, lattice_x, lattice_y, self.time(frame + 1), self.time(frame))
            moved = np.stack([before[0] - lattice_x, before[1] - lattice_y])
            moved[:, np.isnan(moved).any(axis=0)] = 0.0
            at = lattice_y + moved[1], lattice_x + moved[0]
            return [RectBivariateSpline(y, x, d + e.ev(*at)) for d, e in zip(moved, earlier, strict=True)]

        still = [RectBivariateSpline(y, x, np.zeros_like(lattice_x)) for _ in range(2)]
        return FrameHistory(still, advance)

    @cached_property
    def target_poses(self) -> dict[str, targets.Pose]:
        """Poses of the target by name of the image (``tilt_0``, ``tilt_1``, ..., ``flat``); empty at sea."""
        settings, grid = self.scene.calibration, self.scene.grid
        if isinstance(self.scene.surface, SeaSurface):
            return {}  # there is no target at sea
        tilted = targets.poses(settings.tilted, settings.tilt, grid.x, grid.y, self.scene.seed)
        if not isinstance(settings.target, Strings):
            cameras = [self.rig[name] for name in self.rig]
            middle = np.array([np.mean(grid.x), np.mean(grid.y), 0.0])
            tilted = [targets.move_into_view(pose, settings.target, middle, cameras) for pose in tilted]
        flat = targets.Pose(np.eye(3), np.array([0.0, 0.0, settings.level]))
        return {f"tilt_{i}": pose for i, pose in enumerate(tilted)} | {"flat": flat}

    def target_image(self, name: str, camera: str) -> GreyImage:
        """Return the image (row, column) that `camera` takes of the target in the pose called `name`."""
        target, pose = self.scene.calibration.target, self.target_poses[name]
        light = targets.draw(self.rig[camera], target, pose, self.scene.light.blur)
        return self._expose(light, camera, -1 - list(self.target_poses).index(name))

    @cached_property
    def _light(self) -> dict[str, NDArray[np.float32]]:
        """Relative illumination of the pixels, (row, column), by camera."""
        unevenness, seed = self.scene.light.unevenness, self.scene.seed * 97
        return {
            name: sensor.illumination(self.rig[name].size, unevenness, seed + number)
            for number, name in enumerate(self.rig)
        }

    def _expose(self, image: NDArray[np.float32], name: str, frame: int) -> GreyImage:
        light, number = self.scene.light, list(self.rig).index(name)
        rng = np.random.Generator(np.random.SFC64([self.scene.seed, 7, number, frame + 1000]))
        factor = light.gain.get(name, 1.0) * max(0.05, 1.0 + light.flicker * rng.standard_normal())
        image = (image + np.float32(light.background)) * (self._light[name] * np.float32(factor))
        return sensor.expose(image, light.read_noise, light.shot_noise, light.bits, rng)


def _shifted(camera: Camera, shift: tuple[float, float]) -> Camera:
    """Return a camera whose image has moved by `shift`: columns and rows, px."""
    return replace(camera, cx=camera.cx + shift[0], cy=camera.cy + shift[1]) if any(shift) else camera


def _turned(camera: Camera, degrees: tuple[float, float, float]) -> Camera:
    """Return a camera turned about its centre by a rotation vector, degrees, in the axes of the camera."""
    turn = cv2.Rodrigues(np.radians(degrees))[0]
    return replace(camera, rotation=turn @ camera.R, translation=turn @ camera.T)
