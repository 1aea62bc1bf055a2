"""Fourier lines of segments at wave vectors, their surrogates, and coherences of three and four of them."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import fft

from wavefield.errors import CubeError
from wavefield.waves.estimation.segments import Reader, spatial_window
from wavefield.waves.estimation.wave_record import Record
from wavefield.waves.estimation.windows import hann
from wavefield.waves.nonlinear.resonance_groups import FINE, RIDGE

Array = NDArray[Any]

MIN_SEGMENTS = 8  # overlapping by half
# from one segment to the next: products of four windowed waves are hardly correlated at a quarter
HOPS = 4
MAX_LAG = 24  # segments over which lines may be autocorrelated
TAIL = 0.02  # of the scores of surrogates: their tail is extrapolated by an exponential
TESTS_AT_A_TIME, STEPS_AT_A_TIME = 512, 256  # that fit the cache


def lines_of(
    field: xr.DataArray, record: Record, places: tuple[Array, Array], segment: int, kept: Array
) -> tuple[Array, list[int], list[Array]]:
    """Fourier lines (places, segments) of Hann-windowed segments at cells (places, 2) and fine lines.
    Amplitudes of exp(i (k . x - omega t)); where runs end; and for each run the amplitudes (kept, steps) in
    time of the cells (kept, 2). The record is read once, in pieces.
    """
    ny, nx = record.shape
    window = spatial_window(ny, nx).astype(np.float32)
    cells, index = np.unique(np.concatenate([places[0], kept]), axis=0, return_inverse=True)
    index, of_kept = np.split(index.ravel(), [len(places[0])])
    row, column = cells.T
    mirrored = column < 0  # F(-k) = F(k)* of a real field
    row, column = np.where(mirrored, -row, row) % ny, np.abs(column)
    in_time, hop = hann(segment).astype(np.float32), segment // HOPS
    read = Reader([field], record)
    lines: list[Array] = []
    ends, in_runs = [], []
    for run in record.runs:
        amplitudes = np.zeros((len(cells), 0), np.complex64)
        in_time_of_kept = []
        for (block,) in read.blocks(run, STEPS_AT_A_TIME):
            along_x = fft.rfft(block * window, axis=2)[:, :, : column.max() + 1]
            transform = fft.fft(along_x, axis=1)[:, row, column]
            new = np.where(mirrored, transform.conj(), transform).T.astype(np.complex64)
            in_time_of_kept.append(new[of_kept])
            amplitudes = np.concatenate([amplitudes, new], axis=1)
            while amplitudes.shape[1] >= segment:
                part = amplitudes[:, :segment]
                part = (part - part.mean(axis=1, keepdims=True)) * in_time
                # the origin of time is that of the segment: in groups whose lines add up it cancels
                lines.append(fft.ifft(part, n=FINE * segment, axis=1)[index, places[1]])
                amplitudes = amplitudes[:, hop:]
        ends.append(len(lines))
        in_runs.append(np.concatenate(in_time_of_kept, axis=1))
    halves = 2 * len(lines) // HOPS + 1
    if halves < MIN_SEGMENTS:
        raise CubeError(
            f"the record holds {halves} segments of {segment} steps: coherences of wave vectors need"
            f" {MIN_SEGMENTS}"
        )
    return np.stack(lines, axis=1), ends, in_runs


def scaled(lines: Array) -> Array:
    """Lines over their rms: coherences do not depend on it; products of four in single precision do."""
    rms = np.sqrt((np.abs(lines) ** 2).mean(axis=1, dtype=np.float64, keepdims=True))
    return np.asarray(np.divide(lines, rms, out=np.zeros_like(lines), where=rms > 0), np.complex64)


def surrogates(lines: Array, count: int, rng: np.random.Generator) -> Iterator[Array]:
    """Copies of lines with random phases of each line's spectrum over the record.
    They have the power and autocorrelation of each line and no relation between lines.
    """
    spectra = fft.fft(lines, axis=1)
    turn = np.empty_like(spectra)
    for _ in range(count):
        angle = rng.random(spectra.shape, dtype=np.float32) * np.float32(2 * np.pi)
        np.cos(angle, out=turn.real)
        np.sin(angle, out=turn.imag)
        turn *= spectra
        yield np.asarray(fft.ifft(turn, axis=1))


def autocorrelation(lines: Array, ends: list[int]) -> Array:
    """Autocorrelation within runs of lines (places, segments) at lags from 1 on, (places, lags), unbiased.
    Sums over a lag have fewer terms than the power: of four waves what that takes off would count four times.
    """
    lags = min(MAX_LAG, lines.shape[1] // 4)
    correlation = np.zeros((len(lines), lags + 1), np.complex128)
    pairs = np.zeros(lags + 1)
    for run in np.split(lines, ends[:-1], axis=1):
        pairs += np.maximum(run.shape[1] - np.arange(lags + 1), 0)
        power = np.abs(fft.fft(run, n=run.shape[1] + lags + 1, axis=1)) ** 2
        correlation += fft.ifft(power, axis=1)[:, : lags + 1]
    mean = correlation / np.maximum(pairs, 1)
    return np.asarray(mean[:, 1:] / np.maximum(mean[:, :1].real, 1e-300))


def _weights(segments: int, lags: int) -> Array:
    """Twice the pairs of segments at lags from 1 on over all segments, (lags,)."""
    return 2 * (1 - np.arange(1, lags + 1) / segments)


def correlations(x: Array, memory: Array, places: Array) -> tuple[Array, Array]:
    """Squared correlations of lines at places in twos, (places, places), and their means by chance."""
    own, own_memory = scaled(x[places]), memory[places]
    squared = np.abs(own @ own.conj().T / own.shape[1]) ** 2
    weights = _weights(own.shape[1], own_memory.shape[1])
    correlated = 1 + ((own_memory * weights) @ own_memory.conj().T).real
    return squared, np.maximum(correlated, 1.0) / own.shape[1]


@dataclass(frozen=True)
class Coherences:
    """Coherences of triads or quartets, each (groups,)."""

    squared: Array
    score: Array  # minus the logarithm of the chance of a wave to go as much with the product of the others
    samples: Array  # independent ones
    excess: Array  # of the squared one over that of waves without relation and of their autocorrelations

    def __getitem__(self, chosen: Array) -> "Coherences":
        return Coherences(*(values[chosen] for values in vars(self).values()))


def coherences(waves: list[Array], memory: list[Array], scored: bool = True) -> Coherences:
    """Coherences of groups from the lines (groups, segments) of each wave and their autocorrelations.
    The score is -(N - 1) log(1 - p), p the largest part of a wave's power in common; 0 if not asked for.
    """
    one, other = waves[0] * waves[1], waves[2]
    memory_of_other = memory[2]
    if len(waves) == 4:
        other, memory_of_other = waves[2] * waves[3], memory[2] * memory[3]
    # products with a long autocorrelation have fewer independent samples
    weights = _weights(one.shape[1], memory_of_other.shape[1])
    correlated = 1 + (memory[0] * memory[1] * memory_of_other.conj()).real @ weights
    samples = one.shape[1] / np.maximum(correlated, 1.0)
    cross = np.abs(np.einsum("gs,gs->g", one, other.conj())) ** 2
    pairs = _power(one), _power(other)
    norm = pairs[0].sum(axis=1) * pairs[1].sum(axis=1)
    score = np.zeros(len(cross))
    if scored:
        part = np.zeros(len(cross))
        powers = [_power(wave) for wave in waves]
        means = [power.sum(axis=1) for power in powers]
        for i, mean in enumerate(means):
            both = mean * (
                np.einsum("gs,gs->g", powers[i ^ 1], pairs[1 - i // 2])
                if len(waves) == 4 or i < 2
                else pairs[0].sum(axis=1)
            )
            if len(waves) == 4 or i < 2:
                # the other wave of its pair varies with it where both hold the same waves
                shared = np.abs(np.einsum("gs,gs->g", waves[i], waves[i ^ 1].conj())) ** 2
                both = both * (1 + shared / np.maximum(mean * means[i ^ 1], 1e-300))
            part = np.maximum(part, np.minimum(cross / np.maximum(both, 1e-300), 1 - 1e-9))
        # unrelated Gaussian waves of N independent samples have p > 1 - q in q^(N - 1) of cases
        score = -np.maximum(samples - 1, 1.0) * np.log1p(-part)
    squared = cross / np.maximum(norm, 1e-300)
    return Coherences(squared, score, samples, squared - correlated / one.shape[1])


def _power(lines: Array) -> Array:
    return np.asarray(lines.real**2 + lines.imag**2)


def coherences_of(x: Array, memory: Array, places: Array, scored: bool = True) -> Coherences:
    """Coherences of groups whose waves are lines x (places, segments) at places (groups, waves)."""
    parts = []
    for a in range(0, len(places), TESTS_AT_A_TIME):
        some = places[a : a + TESTS_AT_A_TIME].T
        parts.append(coherences([x[at] for at in some], [memory[at] for at in some], scored))
    columns = zip(*(vars(part).values() for part in parts), strict=True)
    return (
        Coherences(*(np.concatenate(column) for column in columns))
        if parts
        else Coherences(*np.zeros((4, 0)))
    )


def products_of_waves(
    in_runs: list[Array], at: Array, omega: Array, line: Array, dt: float, segment: int
) -> Array:
    """Fine lines (groups,) of what three waves drive, a1 a2 a3*, in all segments, (groups, segments).
    Waves are the rows at (groups, 3) of amplitudes in time, near the frequencies omega (groups, 3), rad/s.
    """
    width = 2 * np.pi / (segment * dt)
    turn = np.exp(2j * np.pi / (FINE * segment) * line[:, None] * np.arange(segment)) * hann(segment)
    out = []
    for run in in_runs:
        spectra, frequency = fft.ifft(run, axis=1), 2 * np.pi * np.fft.fftfreq(run.shape[1], dt)
        first, second, third = (
            fft.fft(spectra[row] * (np.abs(frequency - own[:, None]) < RIDGE * width), axis=1)
            for row, own in zip(at.T, omega.T)
        )
        product = first * second * third.conj()
        starts = range(0, run.shape[1] - segment + 1, segment // HOPS)
        out += [(product[:, a : a + segment] * turn).sum(axis=1) for a in starts]
    return np.stack(out, axis=1)


def driven(x: Array, places: Array, product: Array, share: float) -> list[Array]:
    """Lines of quartets with a share of the fourth's power driven by the product of the other three."""
    waves = [x[at] for at in places.T]
    waves[3] = np.sqrt(share) * scaled(product) + np.sqrt(1 - share) * scaled(waves[3])
    return waves


def probabilities(score: Array, null: Array) -> Array:
    """Probability that chance gives a score at least as high."""
    null = np.sort(null)
    edge = null[int((1 - TAIL) * (null.size - 1))]
    scale = float((null[null > edge] - edge).mean())
    count = null.size - np.searchsorted(null, score, "left")
    return np.where(score > edge, TAIL * np.exp(-(score - edge) / scale), (count + 1) / (null.size + 1))
