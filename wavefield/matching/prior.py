"""What is known of a field on a lattice of blocks before its images are looked at: its spectrum.

Measured once per run from sample frames, and kept with the results, so that every frame is weighed alike.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from wavefield.matching.transfer import footprint

Float = NDArray[np.floating[Any]]

_BINS = 40  # of wavenumber, from 0 to pi per block
_SEEN = 0.15  # squared gain of the windows below which their field says nothing of a wave
_STANDS_OUT = 3.0  # times the plateau of noise: what a windowed field shows there is signal
_HEARD = 0.3  # of the noise: what the posterior tells apart of a spectrum
_NOTHING = 0.01  # of the noise: no spectrum is thought to be less before it drowns
_SLOPES = -9.0, -3.0  # of the power law by which a spectrum goes on
_FEW = 6  # bins from which its slope is taken


@dataclass(frozen=True)
class Prior:
    """Isotropic spectrum of a field, and how much its blocks tell of it.

    Parameters
    ----------
    k : tuple of float
        Wavenumbers, rad per block.
    power : tuple of float
        Mean square of the field's cosine coefficients (orthonormal) there, in the field's unit squared.
    information : float
        Typical information of a block: inverse variance of its own say, per unit squared.
    noise : float
        Noise of the scores over what their clusters in one field tell, from the misfit of several fields.
    """

    k: tuple[float, ...]
    power: tuple[float, ...]
    information: float
    noise: float = 1.0

    def spectrum(self, k: NDArray[Any]) -> NDArray[np.float64]:
        """Spectrum at any wavenumbers.

        Parameters
        ----------
        k : ndarray
            Rad per block.

        Returns
        -------
        ndarray of float64
            In the field's unit squared.
        """
        out: NDArray[np.float64] = np.exp(np.interp(k, self.k, np.log(self.power)))
        return out

    def gain(self, k: NDArray[Any]) -> NDArray[np.float64]:
        """How much of a wave the most probable field keeps.

        Parameters
        ----------
        k : ndarray
            Rad per block.

        Returns
        -------
        ndarray of float64
            F^2 A S / (F^2 A S + 1), with F the footprint of a block and A the typical information.
        """
        ratio = footprint(k, np.zeros(1)) ** 2 * self.information * self.spectrum(k)
        return ratio / (ratio + 1.0)

    def noise_kept(self, k: NDArray[Any]) -> NDArray[np.float64]:
        """Noise in the power of the most probable field's cosines.

        Parameters
        ----------
        k : ndarray
            Rad per block.

        Returns
        -------
        ndarray of float64
            G^2 / (F^2 A), in the field's unit squared; 0 beyond the shortest wave of the lattice.
        """
        told = footprint(k, np.zeros(1)) ** 2 * self.information
        return np.where(k < np.pi, self.gain(k) ** 2 / np.maximum(told, 1e-30), 0.0)

    def to_dict(self) -> dict[str, Any]:
        """Plain data for a recipe.

        Returns
        -------
        dict
        """
        return {key: list(v) if isinstance(v, tuple) else v for key, v in asdict(self).items()}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Prior:
        """Inverse of `to_dict`.

        Parameters
        ----------
        data : mapping
            As given by `to_dict`.

        Returns
        -------
        Prior
        """
        return cls(
            tuple(map(float, data["k"])),
            tuple(map(float, data["power"])),
            float(data["information"]),
            float(data["noise"]),
        )


def wavenumbers(shape: tuple[int, int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Wavenumbers of a lattice's cosines along columns (nx,) and along rows (ny, 1), rad per block."""
    ky, kx = (np.pi * np.arange(n) / n for n in shape)
    return kx, ky[:, None]


def first_prior(fields: Sequence[Float], window: Float, information: float) -> Prior:
    """Prior from fields that windows have been over.

    Parameters
    ----------
    fields : sequence of ndarray, (c, ny, nx)
        Windowed fields without holes, of sample frames, their edge slopes taken off.
    window : ndarray, (ny, nx)
        Gain that the windows leave of every cosine mode.
    information : float
        Typical information of a block.

    Returns
    -------
    Prior

    Notes
    -----
    The spectrum over the windows' gain, less the plateau where waves drown in noise; it goes on as a power
    law from where it no longer stands three times above.
    """
    shape = window.shape
    kx, ky = wavenumbers(shape)
    power = np.mean([np.square(_waves(f)).mean(axis=0) for f in fields], axis=0)
    bins = _Bins(np.hypot(kx, ky))
    seen, gain = bins.mean(window**2), bins.mean(footprint(kx, ky) ** 2)
    raw = bins.mean(power) / np.maximum(seen, 1e-9)
    plateau = float(raw[seen > _SEEN].min())
    signal = np.maximum(raw - plateau, 0.0) / gain
    last = bins.until((seen > _SEEN) & (raw > _STANDS_OUT * plateau))
    return Prior(bins.k, _continued(bins.middle, signal, last, plateau), information)


def better_prior(
    prior: Prior, k: NDArray[Any], foot: NDArray[Any], waves: Sequence[Float], information: float
) -> Prior:
    """Prior from the most probable fields that a prior gave.

    Parameters
    ----------
    prior : Prior
        The one used.
    k, foot : ndarray, (my, mx)
        Wavenumber of every mode, rad per block, and the gain of a block's footprint there.
    waves : sequence of ndarray, (c, my, mx)
        Cosine coefficients of the most probable fields of sample frames, less those of their prior mean.
    information : float
        Mean information of a block in them.

    Returns
    -------
    Prior

    Notes
    -----
    Of a mode with spectrum S and noise N = 1 / (F^2 A), the most probable field keeps G = S / (S + N), and so
    G^2 (S + N) of its power: S = sum(|D|^2 - G^2 N) / sum G^2 over the modes of a ring. Where S stands out no
    more from N it goes on as a power law.
    """
    if information == 0.0:  # nothing was seen: there is nothing to learn
        return prior
    noise = 1.0 / (np.square(foot, dtype=np.float64) * information)
    spectrum = prior.spectrum(k)
    gain = spectrum / (spectrum + noise)
    power = np.mean([np.square(f, dtype=np.float64).mean(axis=0) for f in waves], axis=0)
    bins = _Bins(k)
    weight = np.maximum(bins.mean(gain**2), 1e-30)
    drowned = bins.mean(gain**2 * noise) / weight
    whole = bins.mean(power) / weight
    drowned *= max(_plateau(whole / np.maximum(drowned, 1e-30), bins.count), 1.0)
    signal = whole - drowned
    last = bins.until((bins.count > 0) & (signal > _HEARD * drowned))
    least = float(noise.min())
    return Prior(bins.k, _continued(bins.middle, signal, last, least), information, prior.noise)


def _plateau(ratio: NDArray[np.float64], count: NDArray[Any]) -> float:
    """What power over noise falls to where there are no more waves: its least, of the mean of three rings."""
    some = ratio[count > 0]
    return float(np.convolve(some, np.ones(3) / 3, mode="valid").min()) if some.size > 3 else 1.0


class _Bins:
    """Rings of wavenumber."""

    def __init__(self, k: NDArray[Any]) -> None:
        edges = np.linspace(0, np.pi, _BINS + 1)
        self.middle = 0.5 * (edges[1:] + edges[:-1])
        self.k = tuple(map(float, self.middle))
        self._which = np.clip(np.digitize(k.ravel(), edges) - 1, 0, _BINS - 1)
        self.count = np.bincount(self._which, minlength=_BINS)

    def mean(self, field: NDArray[Any]) -> NDArray[np.float64]:
        total = np.bincount(self._which, field.ravel(), minlength=_BINS)
        return total / np.maximum(self.count, 1)

    @staticmethod
    def until(good: NDArray[np.bool_]) -> int:
        """Number of rings before the first that is not good, at least three."""
        return max(int(np.argmin(good)) if not good.all() else len(good), 3)


def _continued(
    k: NDArray[np.float64], power: NDArray[np.float64], last: int, noise: float
) -> tuple[float, ...]:
    """The spectrum with what lies beyond the first ``last`` rings replaced by a power law.

    Where it is far below the noise, as of water at rest, nothing can be said of it but that.
    """
    out = np.maximum(power, _NOTHING * noise)
    first = max(last - _FEW, 1)
    slope = _SLOPES[1]
    if last - first > 2:
        slope = float(np.polyfit(np.log(k[first:last]), np.log(out[first:last]), 1)[0])
    slope = float(np.clip(slope, *_SLOPES))
    out[last:] = out[last - 1] * (k[last:] / k[last - 1]) ** slope
    return tuple(map(float, out))


def _waves(field: Float) -> NDArray[Any]:
    out: NDArray[Any] = scipy.fft.dctn(np.asarray(field, np.float64), axes=(-2, -1), norm="ortho", workers=1)
    return out
