"""Random wind fields as sums of plane waves with random amplitudes in time.

Assumptions
-----------
A field is a sum of M waves exp(i (k x + l y + m zeta - omega t)) with complex amplitudes that
either stay fixed or wander as first-order autoregressive series on an hourly lattice (linear
between the hours). Wave numbers are drawn from the Gaussian spectrum of a chosen length, so the
covariance in space is near Gaussian, not exponential: another family than an
Ornstein-Uhlenbeck model of the same errors assumes, on purpose.

Validity
--------
A stationary Gaussian field for M of about 60 and more; any number of points.

Units
-----
x, y in km; zeta = ln(p / 1000 hPa); t in hours; wind in m/s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["WaveKind", "Waves", "random_waves"]

Array = NDArray[np.float64]
# Places at a time: each meets every wave.
_CHUNK = 8192


@dataclass(frozen=True)
class Waves:
    """A sum of waves: M wave vectors, polarisations and amplitude series."""

    # kx, ky: (M,): horizontal wave numbers in rad/km
    kx: Array
    ky: Array
    kz: Array  # (M,): vertical wave number in rad per unit of zeta
    omega: Array  # (M,): frequency in rad/h
    # east, north: (M,): complex polarisation of the two wind components in m/s
    east: NDArray[np.complex128]
    north: NDArray[np.complex128]
    # (T, M): amplitudes on an hourly lattice starting at ``start``; T = 1 for fixed ones
    series: NDArray[np.complex128]
    start: float  # hour of the first amplitude

    def amplitude(self, hours: Array) -> NDArray[np.complex128]:
        """Return the amplitudes at times, shape (n, M)."""
        if self.series.shape[0] == 1:
            return np.broadcast_to(self.series, (np.size(hours), self.series.shape[1]))
        where = np.clip(hours - self.start, 0.0, self.series.shape[0] - 1.001)
        low = where.astype(int)
        weight = (where - low)[:, None]
        return np.asarray(self.series[low] * (1 - weight) + self.series[low + 1] * weight)

    def at_points(self, x: Array, y: Array, zeta: Array, hours: Array) -> Array:
        """Return the wind at scattered points.

        Parameters
        ----------
        x, y, zeta, hours : ndarray (n,)
            Places in km and zeta, times in hours.

        Returns
        -------
        ndarray (2, n)
            Eastward and northward wind in m/s.
        """
        out = np.empty((2, x.size))
        kx, ky, kz, omega = (k.astype(np.float32) for k in (self.kx, self.ky, self.kz, self.omega))
        pair = np.stack([self.east, self.north], axis=1).astype(np.complex64)
        for first in range(0, x.size, _CHUNK):
            part = slice(first, first + _CHUNK)
            angle = (
                np.outer(x[part].astype(np.float32), kx)
                + np.outer(y[part].astype(np.float32), ky)
                + np.outer(zeta[part].astype(np.float32), kz)
            )
            angle -= np.outer(hours[part].astype(np.float32), omega)
            wave = np.empty(angle.shape, np.complex64)
            np.cos(angle, out=wave.real)
            np.sin(angle, out=wave.imag)
            wave *= self.amplitude(hours[part]).astype(np.complex64)
            out[:, part] = (wave @ pair).real.T
        return out

    def on_grid(self, x: Array, y: Array, zeta: Array, hours: Array) -> NDArray[np.float32]:
        """Return the wind on a grid at a list of times.

        Parameters
        ----------
        x, y : ndarray (rows, columns)
            Grid points in km.
        zeta : ndarray (L,)
            Levels.
        hours : ndarray (T,)
            Times in hours.

        Returns
        -------
        ndarray float32 (T, 2, L, rows, columns)
            Wind in m/s.
        """
        points = x.size
        angle = np.outer(self.kx, x.ravel()) + np.outer(self.ky, y.ravel())
        basis = np.concatenate([np.cos(angle), -np.sin(angle)]).astype(np.float32)
        vertical = np.exp(1j * np.outer(zeta, self.kz))
        factor = self.amplitude(hours) * np.exp(-1j * np.outer(hours, self.omega))
        pair = np.stack([self.east, self.north])
        out = np.empty((hours.size, 2, zeta.size, points), np.float32)
        for first in range(0, hours.size, 64):  # all hours at once would fill the memory
            part = slice(first, first + 64)
            weight = factor[part, None, None, :] * pair[None, :, None, :] * vertical[None, None]
            flat = np.concatenate([weight.real, weight.imag], axis=-1).astype(np.float32)
            out[part] = flat @ basis
        return out.reshape(hours.size, 2, zeta.size, *x.shape)


def _series(
    rng: np.random.Generator, count: int, start: float, end: float, memory: float
) -> NDArray[np.complex128]:
    """Return complex AR(1) amplitudes of unit variance with an e-folding time of ``memory`` h."""
    if not np.isfinite(memory):
        draw = rng.normal(size=(1, count)) + 1j * rng.normal(size=(1, count))
        return np.asarray(draw / np.sqrt(2.0))
    steps = int(np.ceil(end - start)) + 2
    shock = (rng.normal(size=(steps, count)) + 1j * rng.normal(size=(steps, count))) / np.sqrt(2.0)
    keep = float(np.exp(-1.0 / memory))
    shock[1:] *= np.sqrt(1.0 - keep**2)
    for step in range(1, steps):
        shock[step] += keep * shock[step - 1]
    return np.asarray(shock)


@dataclass(frozen=True)
class WaveKind:
    """What waves a random wind field is made of."""

    count: int  # waves
    rms: float  # root mean square of each wind component in m/s
    # range of the correlation length in km: each wave takes a length L log-uniformly and wave
    # numbers with standard deviation 1 / L
    lengths: tuple[float, float]
    depth: float  # vertical correlation length in ln p
    memory: float  # e-folding time of the amplitudes in h; inf for a fixed field
    # velocity in km/h that carries the waves east and north
    drift: tuple[float, float] = (0.0, 0.0)
    rotational: float = 0.7  # share of the amplitude without divergence


def random_waves(rng: np.random.Generator, kind: WaveKind, *, start: float, end: float) -> Waves:
    """Draw a random wind field.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of every number drawn.
    start, end : float
        Hours the amplitudes must cover.
    """
    length = np.exp(rng.uniform(np.log(kind.lengths[0]), np.log(kind.lengths[1]), kind.count))
    kx, ky = rng.normal(size=(2, kind.count)) / length
    kz = rng.normal(size=kind.count) / kind.depth
    size = np.hypot(kx, ky)
    swirl = np.stack([-ky, kx]) / size
    free = rng.normal(size=(2, kind.count)) + 1j * rng.normal(size=(2, kind.count))
    free /= np.sqrt(np.sum(np.abs(free) ** 2, axis=0))
    pair = kind.rotational * swirl + np.sqrt(1.0 - kind.rotational**2) * free
    pair = pair * (2.0 * kind.rms / np.sqrt(np.sum(np.abs(pair) ** 2)))
    return Waves(
        kx=kx,
        ky=ky,
        kz=kz,
        omega=kx * kind.drift[0] + ky * kind.drift[1],
        east=pair[0],
        north=pair[1],
        series=_series(rng, kind.count, start, end, kind.memory),
        start=start,
    )
