"""One camera: projection, sight lines and Jacobian.

The physical frame is right-handed, in metres, with z up. In the image X points to the right (column) and Y
down (row); the centre of the first pixel is (0, 0). The camera frame is Xc = R x + T, with zc along the
optical axis, away from the camera. The tangents (a, b) = (xc / zc, yc / zc) of a point are those of the
angles, along xc and yc, between the optical axis and the sight line of the point.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wavefield.errors import RigError
from wavefield.rig.lens import Array, apply_homography, distort, distort_jacobian, rotation_about, tilt_matrix


@dataclass(frozen=True)
class Camera:
    """A pinhole camera with radial and tangential lens distortion, and with a sensor that may be tilted.

    The model of Aubourg et al. has the terms fx, fy, cx, cy and k1. The other terms are those of OpenCV: k2,
    p1, p2, k3, and the Scheimpflug tilt tau_x, tau_y.

    Parameters
    ----------
    fx, fy : float
        Focal lengths along the sensor's X and Y, px.
    cx, cy : float
        Principal point, where the optical axis meets the sensor, px.
    rotation : 3 x 3 nested sequence of float
        Rotation R from the physical frame to the camera frame.
    translation : sequence of 3 float
        Translation T, metres: Xc = R x + T.
    size : tuple of int
        Image (width, height), px.
    k1, k2, k3 : float
        Radial distortion; k1 is k_c of Aubourg et al.
    p1, p2 : float
        Tangential distortion.
    tau_x, tau_y : float
        Tilt of the sensor (Scheimpflug mount), radians, in OpenCV's convention.
    skew : float
        Shear of the sensor axes, px: X = fx X' + skew Y' + cx.

    Examples
    --------
    A camera 4 m above the water, looking down, with y of the world pointing up in the image:

    >>> facing_down = ((1, 0, 0), (0, -1, 0), (0, 0, -1))
    >>> down = Camera(2700.0, 2700.0, 511.5, 511.5, facing_down, (0, 0, 4), (1024, 1024))
    >>> X, Y = down.project(0.1, 0.0, 0.0)
    >>> print(round(float(X), 6), round(float(Y), 6))
    579.0 511.5
    """

    fx: float
    fy: float
    cx: float
    cy: float
    rotation: Any
    translation: Any
    size: tuple[int, int]
    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0
    tau_x: float = 0.0
    tau_y: float = 0.0
    skew: float = 0.0

    def __post_init__(self) -> None:
        rotation = tuple(
            tuple(float(v) for v in row) for row in np.asarray(self.rotation, float).reshape(3, 3)
        )
        object.__setattr__(self, "rotation", rotation)
        object.__setattr__(self, "translation", tuple(float(v) for v in np.ravel(self.translation)))
        object.__setattr__(self, "size", (int(self.size[0]), int(self.size[1])))
        for f in fields(self):
            if f.type in (float, "float"):
                object.__setattr__(self, f.name, float(getattr(self, f.name)))

    # -- derived constants ---------------------------------------------------------------------------

    @cached_property
    def R(self) -> Array:
        """Rotation matrix from the physical frame to the camera frame, (3, 3)."""
        return np.array(self.rotation)

    @cached_property
    def T(self) -> Array:
        """Translation from the physical frame to the camera frame, (3,), metres: Xc = R x + T."""
        return np.array(self.translation)

    @cached_property
    def centre(self) -> Array:
        """Position of the camera's projection centre in the physical frame, (3,), metres."""
        return -self.R.T @ self.T

    @property
    def K(self) -> Array:
        """OpenCV's camera matrix, (3, 3), px."""
        return np.array([[self.fx, self.skew, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def D(self) -> Array:
        """OpenCV's distortion coefficients k1, k2, p1, p2, k3, (5,), or (14,) if the sensor is tilted."""
        D = np.array([self.k1, self.k2, self.p1, self.p2, self.k3, *[0.0] * 7, self.tau_x, self.tau_y])
        return D if D[5:].any() else D[:5]

    @cached_property
    def _tilt(self) -> Array | None:
        """Homography (3, 3) of the tilted sensor (OpenCV's CALIB_TILTED_MODEL); None if it is not tilted."""
        return tilt_matrix(self.tau_x, self.tau_y).real if self.tau_x or self.tau_y else None

    # -- sensor: tangents <-> pixels -----------------------------------------------------------------

    @property
    def _radial(self) -> tuple[float, float, float]:
        return self.k1, self.k2, self.k3

    @property
    def _tangential(self) -> tuple[float, float]:
        return self.p1, self.p2

    def _to_pixels(self, a: Array, b: Array) -> tuple[Array, Array]:
        """Return the pixels X, Y of tangents a, b, with lens distortion and sensor tilt."""
        x, y = distort(a, b, self._radial, self._tangential)
        if self._tilt is not None:
            x, y, _ = apply_homography(self._tilt, x, y)
        X = self.fx * x + self.cx
        if self.skew:
            X = X + self.skew * y
        return X, self.fy * y + self.cy

    def _to_tangents(self, X: Array, Y: Array) -> tuple[Array, Array]:
        """Return the tangents a, b of pixels X, Y: the inverse of `_to_pixels`."""
        y = (Y - self.cy) / self.fy
        x = (X - self.cx - self.skew * y) / self.fx
        if self._tilt is not None:
            x, y, _ = apply_homography(np.asarray(np.linalg.inv(self._tilt), float), x, y)
        k, p = self._radial, self._tangential
        if not any(k + p):
            return x, y
        a, b = x.copy(), y.copy()
        for _ in range(20):  # Newton; three steps reach machine precision for any usable lens
            fx, fy = distort(a, b, k, p)
            xa, cross, yb = distort_jacobian(a, b, k, p)
            det = xa * yb - cross * cross
            da = (yb * (x - fx) - cross * (y - fy)) / det
            db = (xa * (y - fy) - cross * (x - fx)) / det
            a, b = a + da, b + db
            if not np.nanmax(np.abs(da) + np.abs(db), initial=0.0) > 1e-15:
                break
        return a, b

    # -- physical frame <-> pixels --------------------------------------------------------------------

    def tangents(self, X: ArrayLike, Y: ArrayLike) -> tuple[Array, Array]:
        """Return the tangents a = xc / zc, b = yc / zc of points that project to pixels X, Y (column, row).
        Lens distortion is removed."""
        return self._to_tangents(*np.broadcast_arrays(np.asarray(X, float), np.asarray(Y, float)))

    def project(self, x: ArrayLike, y: ArrayLike, z: ArrayLike) -> tuple[Array, Array]:
        """Project points x, y, z, metres, onto the sensor.

        Parameters
        ----------
        x, y, z : array_like, broadcastable
            Positions, metres.

        Returns
        -------
        X, Y : ndarray
            Pixel coordinates (column, row); NaN for points behind the camera.
        """
        a, b, _ = self._tangents_of(x, y, z)
        return self._to_pixels(a, b)

    def _tangents_of(self, x: ArrayLike, y: ArrayLike, z: ArrayLike) -> tuple[Array, Array, Array]:
        """Return the tangents a, b of physical points, and their depth zc along the optical axis, metres.
        All three results are NaN for points behind the camera."""
        x, y, z = np.asarray(x, float), np.asarray(y, float), np.asarray(z, float)
        (r1, r2, r3), (r4, r5, r6), (r7, r8, r9) = self.rotation
        tx, ty, tz = self.translation
        zc = r7 * x + r8 * y + r9 * z + tz
        zc = np.where(zc > 0.0, zc, np.nan)
        return (r1 * x + r2 * y + r3 * z + tx) / zc, (r4 * x + r5 * y + r6 * z + ty) / zc, zc

    def unproject(self, X: ArrayLike, Y: ArrayLike, z: ArrayLike = 0.0) -> tuple[Array, Array]:
        """Return the points where the sight lines of pixels meet the horizontal plane of height z.

        Parameters
        ----------
        X, Y : array_like
            Pixel coordinates (column, row).
        z : array_like, default 0
            Height of the plane, metres.

        Returns
        -------
        x, y : ndarray
            Positions on the plane, metres; NaN if the sight line does not meet the plane.
        """
        a, b = self.tangents(X, Y)
        R, c = self.R, self.centre
        dx = R[0, 0] * a + R[1, 0] * b + R[2, 0]
        dy = R[0, 1] * a + R[1, 1] * b + R[2, 1]
        dz = R[0, 2] * a + R[1, 2] * b + R[2, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            s = (np.asarray(z, float) - c[2]) / dz
            s = np.where(s > 0.0, s, np.nan)
            return c[0] + s * dx, c[1] + s * dy

    def sight_line(self, x: ArrayLike, y: ArrayLike, z: ArrayLike = 0.0) -> tuple[Array, Array]:
        """Return the horizontal displacement per height along the sight lines through physical points.

        The sight line through (x, y, z) passes (x + Dx (h - z), y + Dy (h - z)) at height h. This is exact
        for straight rays. Aubourg et al. derive it from the projection, but with other signs.

        Parameters
        ----------
        x, y, z : array_like, broadcastable
            Positions, metres; with z = 0, those where the sight lines meet the plane of the still water.

        Returns
        -------
        Dx, Dy : ndarray
            Sight-line coefficients: tangents of the angle from the vertical, along x and y.
        """
        c = self.centre
        depth = np.asarray(z, float) - c[2]
        return (np.asarray(x, float) - c[0]) / depth, (np.asarray(y, float) - c[1]) / depth

    def jacobian(self, x: ArrayLike, y: ArrayLike, z: ArrayLike) -> Array:
        """Return the derivatives of pixel coordinates with respect to physical coordinates.

        Parameters
        ----------
        x, y, z : array_like, broadcastable to shape S
            Positions, metres.

        Returns
        -------
        ndarray, S + (2, 3)
            [[dX/dx, dX/dy, dX/dz], [dY/dx, dY/dy, dY/dz]], px per metre.
        """
        x, y, z = np.broadcast_arrays(np.asarray(x, float), np.asarray(y, float), np.asarray(z, float))
        a, b, zc = self._tangents_of(x, y, z)
        xa, xb, yb = distort_jacobian(a, b, self._radial, self._tangential)
        ya = xb
        if self._tilt is not None:
            h = self._tilt
            U, V, s = apply_homography(h, *distort(a, b, self._radial, self._tangential))
            t00, t01 = (h[0, 0] - U * h[2, 0]) / s, (h[0, 1] - U * h[2, 1]) / s
            t10, t11 = (h[1, 0] - V * h[2, 0]) / s, (h[1, 1] - V * h[2, 1]) / s
            xa, xb, ya, yb = (
                t00 * xa + t01 * ya,
                t00 * xb + t01 * yb,
                t10 * xa + t11 * ya,
                t10 * xb + t11 * yb,
            )
        Xa, Xb = self.fx * xa + self.skew * ya, self.fx * xb + self.skew * yb
        Ya, Yb = self.fy * ya, self.fy * yb
        out = np.empty((*a.shape, 2, 3))
        for j, (r1, r4, r7) in enumerate(zip(*self.rotation, strict=True)):
            da, db = (r1 - r7 * a) / zc, (r4 - r7 * b) / zc
            out[..., 0, j] = Xa * da + Xb * db
            out[..., 1, j] = Ya * da + Yb * db
        return out

    def corners(self, z: float = 0.0) -> Array:
        """Return the corners of the image on the plane of height z, (4, 2): x and y, metres.
        The order is upper left, upper right, lower right, lower left; NaN for a corner above the horizon."""
        w, h = self.size
        X = np.array([-0.5, w - 0.5, w - 0.5, -0.5])
        Y = np.array([-0.5, -0.5, h - 0.5, h - 0.5])
        return np.stack(self.unproject(X, Y, z), axis=-1)

    def sees(self, x: ArrayLike, y: ArrayLike, z: ArrayLike, margin: float = 0.0) -> NDArray[np.bool_]:
        """Return whether the camera sees points x, y, z, metres, at least `margin` px inside its image."""
        X, Y = self.project(x, y, z)
        w, h = self.size
        return (X >= margin) & (X <= w - 1 - margin) & (Y >= margin) & (Y <= h - 1 - margin)

    # -- plain data ----------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """Convert the camera to plain numbers and nested lists, by field name, for YAML and for hashing.
        Lens terms k1 to skew that are zero are left out."""
        out: dict[str, Any] = {}
        for f in fields(self):
            value = getattr(self, f.name)
            if value == 0.0 and f.name in _OPTIONAL:
                continue
            out[f.name] = (
                [list(v) if isinstance(v, tuple) else v for v in value] if isinstance(value, tuple) else value
            )
        return out

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "Camera":
        """Build a camera from the result of `to_dict`; an unknown key raises a TypeError."""
        return cls(**data)

    @classmethod
    def from_opencv(
        cls,
        K: ArrayLike,
        D: ArrayLike | None,
        rvec: ArrayLike,
        tvec: ArrayLike,
        size: tuple[int, int],
    ) -> "Camera":
        """Build a camera from the results of OpenCV's calibration functions.

        Parameters
        ----------
        K : array_like, (3, 3)
            Camera matrix, px.
        D : array_like, (0,), (4,), (5,), (8,), (12,) or (14,), optional
            Distortion coefficients k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [tau_x tau_y]]]].
        rvec : array_like, (3,) or (3, 3)
            Rotation from the physical frame to the camera frame, as a vector (rad) or a matrix.
        tvec : array_like, (3,)
            Translation from the physical frame to the camera frame, metres.
        size : (width, height)
            Image, px.

        Raises
        ------
        RigError
            If the lens model has rational or thin-prism terms, or if K or D has a wrong shape.

        Examples
        --------
        >>> K, D = [[900, 0, 320], [0, 900, 240], [0, 0, 1]], [-0.1, 0.01, 0, 0]
        >>> camera = Camera.from_opencv(K, D, [3.14159265, 0, 0], [0, 0, 4], (640, 480))
        >>> camera.k1, round(float(camera.centre[2]), 6)
        (-0.1, 4.0)
        """
        M = np.asarray(K, float)
        if M.shape != (3, 3) or not np.isfinite(M).all() or not (M[0, 0] > 0 and M[1, 1] > 0):
            raise RigError("a camera matrix is 3 x 3 with positive focal lengths")
        turn = np.asarray(rvec, float)
        R = turn if turn.shape == (3, 3) else rotation_about(turn.reshape(3))
        (fx, skew, cx), (_, fy, cy), _ = (M / M[2, 2]).tolist()
        return cls(fx, fy, cx, cy, R, tvec, size, skew=skew, **_terms_of_opencv(D))

    def scaled(self, factor: float) -> "Camera":
        """Return the camera of images that were resampled to `factor` times their width and height."""
        w, h = self.size
        return replace(
            self,
            fx=self.fx * factor,
            fy=self.fy * factor,
            skew=self.skew * factor,
            cx=(self.cx + 0.5) * factor - 0.5,
            cy=(self.cy + 0.5) * factor - 0.5,
            size=(round(w * factor), round(h * factor)),
        )


_OPTIONAL = {"k1", "k2", "p1", "p2", "k3", "tau_x", "tau_y", "skew"}


def _terms_of_opencv(D: ArrayLike | None) -> dict[str, float]:
    """Return the lens terms by name from OpenCV's distortion coefficients D.
    Raises a RigError if a coefficient that `Camera` lacks is not zero, or if D has a wrong number of them."""
    given = np.zeros(0) if D is None else np.ravel(np.asarray(D, float))
    if given.size not in (0, 4, 5, 8, 12, 14):
        raise RigError(f"it has {given.size} distortion coefficients; OpenCV's models have 4, 5, 8, 12 or 14")
    full = np.zeros(14)
    full[: given.size] = given
    if np.any(full[5:12] != 0.0):
        raise RigError(
            "its lens model has rational or thin-prism terms (k4-k6, s1-s4): "
            "calibrate again in OpenCV without CALIB_RATIONAL_MODEL and CALIB_THIN_PRISM_MODEL"
        )
    keys = ("k1", "k2", "p1", "p2", "k3", *[""] * 7, "tau_x", "tau_y")
    return {key: float(value) for key, value in zip(keys, full, strict=True) if key}
