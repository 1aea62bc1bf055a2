"""How well the cameras agree: the paper's accuracy section, from one step of frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.measurement import surface as stereo
from wavefield.measurement import velocity as motion
from wavefield.measurement.measure import look
from wavefield.measurement.plan import Plan
from wavefield.measurement.rectify import bin_pixels
from wavefield.variables import Quality

Pair = tuple[str, str]


@dataclass(frozen=True)
class Diagnosis:
    """Internal errors of one step; NaN where not measured.

    Parameters
    ----------
    pixel : float
        Length that counts as one pixel, metres.
    z : dict of (str, str) to ndarray, (ny, nx)
        Elevation from each pair alone at the first frame, metres: the planned pairs and the direct pairs
        among their partners.
    eps_y : dict of (str, str) to ndarray, (n,)
        Mismatch across the line of sight at all blocks that were matched, before rejection by it, metres.
    z_std : dict of (str, str) to float
        eps_y's rms over |dD|: the standard uncertainty of z under isotropy of the matching error, metres.
    difference : dict of ((str, str), (str, str)) to ndarray, (ny, nx)
        Elevation by one pair minus that by another, metres.
    recombined : dict of (str, str) to ndarray, (ny, nx)
        Elevation by a direct pair's displacement made of the two planned ones, minus that matched directly.
    eps_piv : ndarray, (ny, nx)
        Misfit of the cameras' displacements from the first frame to the second, px of the binned images.
    """

    pixel: float
    z: dict[Pair, NDArray]
    eps_y: dict[Pair, NDArray]
    z_std: dict[Pair, float]
    difference: dict[tuple[Pair, Pair], NDArray]
    recombined: dict[Pair, NDArray]
    eps_piv: NDArray

    def table(self) -> list[dict[str, Any]]:
        """The rms of every error.

        Returns
        -------
        list of dict
            ``name``, ``cm`` (None for those in the images), ``px``, and ``share`` of nodes or blocks beyond
            three times the rms, which are left out of it once.
        """
        rows = []
        for pair, values in self.eps_y.items():
            rows.append(self._row(f"eps_Y {_name(pair)}", values))
            rows.append({"name": f"sigma_z {_name(pair)}", **self._units(self.z_std[pair]), "share": None})
        for (one, other), values in self.difference.items():
            rows.append(self._row(f"(z {_name(one)} - z {_name(other)}) / sqrt 2", values / np.sqrt(2.0)))
        for pair, values in self.recombined.items():
            rows.append(self._row(f"z {_name(pair)} recombined - direct", values))
        rms, share = _rms(self.eps_piv)
        rows.append({"name": "eps'", "cm": None, "px": rms, "share": share})
        return rows

    def _row(self, name: str, values: NDArray) -> dict[str, Any]:
        rms, share = _rms(values)
        return {"name": name, **self._units(rms), "share": share}

    def _units(self, metres: float) -> dict[str, float]:
        return {"cm": 100.0 * metres, "px": metres / self.pixel}


def _name(pair: Pair) -> str:
    return f"{pair[0]}-{pair[1]}"


def _rms(values: NDArray) -> tuple[float, float]:
    """Rms without what exceeds three times it, and the share that does."""
    values = values[np.isfinite(values)]
    if values.size == 0:
        return float("nan"), 0.0
    large = np.abs(values) > 3.0 * np.sqrt(np.mean(np.square(values)))
    return float(np.sqrt(np.mean(np.square(values[~large])))), float(large.mean())


def diagnose(
    frames: Mapping[str, Sequence[NDArray | None]], plan: Plan, pixel: float | None = None
) -> Diagnosis:
    """Compare what pairs of cameras say about the same surface, and cameras about the same motion.

    Parameters
    ----------
    frames : mapping of str to sequence of 2 ndarray
        Per camera the two frames of one step.
    plan : Plan
        Rig, grid and settings.
    pixel : float, optional
        Length that counts as one pixel, metres; that of the rectified images if left out.

    Returns
    -------
    Diagnosis

    Raises
    ------
    ValueError
        If a camera's frame is missing or cannot be used, or nothing can be matched.

    Notes
    -----
    Recombined: (x_1 - x_2) = (x_1 - x_3) - (x_2 - x_3), with the middle camera 3 as reference.
    """
    first, second = (look({n: frames[n][k] for n in frames}, plan, plan.velocity_cameras) for k in (0, 1))
    for instant in (first, second):
        if instant.missing:
            raise ValueError(
                f"camera {sorted(instant.missing)[0]} has no usable frame: nothing to compare with"
            )
    if first.surface is None or second.surface is None:
        raise ValueError("the frames cannot be matched: nothing to compare with")
    raw = {n: np.asarray(frames[n][0]) for n in plan.surface_cameras}
    flat = {n: stereo.prepare(bin_pixels(raw[n], plan.binning[n]), n, plan) for n in plan.surface_cameras}
    partners = [b for _, b in plan.pairs]
    direct = [(a, b) for k, a in enumerate(partners) for b in partners[k + 1 :]]
    matches = {
        pair: stereo.match_pair(flat[pair[0]], flat[pair[1]], pair, plan) for pair in (*plan.pairs, *direct)
    }
    z = {pair: _nodes([match], plan) for pair, match in matches.items()}
    eps_y = {pair: match.eps_y[match.matched] for pair, match in matches.items()}
    z_std = {}
    for pair, match in matches.items():
        length = np.hypot(*match.parallax)[match.matched]
        z_std[pair] = _rms(eps_y[pair] / length)[0]
    names = list(z)
    difference = {(p, q): z[p] - z[q] for k, p in enumerate(names) for q in names[k + 1 :]}
    reference = plan.reference
    recombined = {}
    for a, b in direct:
        to_a, to_b = matches[reference, a], matches[reference, b]
        both = stereo.difference_of(to_b, to_a)
        recombined[a, b] = _nodes([both], plan) - z[a, b]
    moved = motion.velocity(first.images, second.images, 0.5 * (first.surface.z + second.surface.z), plan)
    eps_piv = np.full(plan.grid.shape, np.nan) if moved is None else moved.eps_piv
    return Diagnosis(pixel or plan.pixel, z, eps_y, z_std, difference, recombined, eps_piv)


def _nodes(matches: Sequence[stereo.PairMatch], plan: Plan) -> NDArray:
    blocks = stereo.combine(matches)
    if not blocks.valid.any():
        return np.full(plan.grid.shape, np.nan, np.float32)
    found = stereo.to_nodes(blocks, matches, plan)
    return np.where((found.quality & Quality.MEASURED) > 0, found.z, np.float32(np.nan))
