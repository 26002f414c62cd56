"""Atmosphere of the sample archives: a true wind, and models with errors.

A random wind field is a sum of M plane waves exp(i (k x + l y + m zeta - omega t)) whose amplitudes
are fixed, or first-order autoregressive in time. Wave numbers follow the Gaussian spectrum of a
length: deliberately not the exponential covariance that the fit assumes. True wind = westerly jet +
baroclinic waves + mesoscale motion. A model contains the first two exactly, the resolved part of
the mesoscale, and an error that all aircraft share. Perfect instruments disagree with a model by 6
kt, a fleet with ordinary compass errors by 7 to 9 kt, as in the field test of the TAMDAR compass
paper. Valid from 200 to 1000 hPa over 5000 km.

Units: km, hours since the start of the archive, zeta = ln(p / 1000 hPa), m/s.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Fields = NDArray[np.float32]
_POINTS_AT_ONCE = 8192  # points; the arrays hold every wave at each
_HOURS_AT_ONCE = 64
# h around the archive that amplitudes cover.
_BEFORE, _AFTER = 12.0, 24.0


def stream(seed: int, name: str) -> np.random.Generator:
    """Random generator of one named part: switching a part on leaves the others unchanged."""
    return np.random.default_rng([seed, zlib.crc32(name.encode())])


@dataclass(frozen=True)
class Waves:
    """A sum of M waves."""

    kx: Array  # (M,) rad/km
    ky: Array
    kz: Array  # (M,) rad per unit of zeta
    omega: Array  # (M,) rad/h
    east: NDArray[np.complex128]  # (M,) polarisation, m/s
    north: NDArray[np.complex128]
    series: NDArray[np.complex128]  # (T, M) amplitudes by hour; T = 1 where they are fixed
    start: float  # hour of the first amplitude

    def amplitude(self, hours: Array) -> NDArray[np.complex128]:
        """Amplitudes (n, M) at times."""
        if self.series.shape[0] == 1:
            return np.broadcast_to(self.series, (np.size(hours), self.series.shape[1]))
        where = np.clip(hours - self.start, 0.0, self.series.shape[0] - 1.001)
        low = where.astype(int)
        weight = (where - low)[:, None]
        return np.asarray(self.series[low] * (1 - weight) + self.series[low + 1] * weight)

    def at_points(self, x: Array, y: Array, zeta: Array, hours: Array) -> Array:
        """Eastward and northward wind (2, n), m/s, at scattered points (n,)."""
        wind = np.empty((2, x.size))
        kx, ky, kz, omega = (k.astype(np.float32) for k in (self.kx, self.ky, self.kz, self.omega))
        pair = np.stack([self.east, self.north], axis=1).astype(np.complex64)
        for first in range(0, x.size, _POINTS_AT_ONCE):
            rows = slice(first, first + _POINTS_AT_ONCE)
            angle = (
                np.outer(x[rows].astype(np.float32), kx)
                + np.outer(y[rows].astype(np.float32), ky)
                + np.outer(zeta[rows].astype(np.float32), kz)
            )
            angle -= np.outer(hours[rows].astype(np.float32), omega)
            wave = np.empty(angle.shape, np.complex64)
            np.cos(angle, out=wave.real)
            np.sin(angle, out=wave.imag)
            wave *= self.amplitude(hours[rows]).astype(np.complex64)
            wind[:, rows] = (wave @ pair).real.T
        return wind

    def on_grid(self, x: Array, y: Array, zeta: Array, hours: Array) -> Fields:
        """Wind (T, 2, L, rows, columns), m/s, at grid points (rows, columns), levels and times."""
        angle = np.outer(self.kx, x.ravel()) + np.outer(self.ky, y.ravel())
        basis = np.concatenate([np.cos(angle), -np.sin(angle)]).astype(np.float32)
        vertical = np.exp(1j * np.outer(zeta, self.kz))
        factor = self.amplitude(hours) * np.exp(-1j * np.outer(hours, self.omega))
        pair = np.stack([self.east, self.north])
        wind = np.empty((hours.size, 2, zeta.size, x.size), np.float32)
        for first in range(0, hours.size, _HOURS_AT_ONCE):
            block = slice(first, first + _HOURS_AT_ONCE)
            weight = factor[block, None, None, :] * pair[None, :, None, :] * vertical[None, None]
            flat = np.concatenate([weight.real, weight.imag], axis=-1).astype(np.float32)
            wind[block] = flat @ basis
        return wind.reshape(hours.size, 2, zeta.size, *x.shape)


@dataclass(frozen=True)
class WaveKind:
    """Statistics of a random wind field."""

    count: int  # waves; about 60 and more make a Gaussian field
    rms: float  # of each component, m/s
    lengths: tuple[float, float]  # range of the correlation length, km (log-uniform over waves)
    depth: float  # vertical correlation length, ln p
    memory: float  # e-folding time of the amplitudes, h; inf for a fixed field
    drift: tuple[float, float] = (0.0, 0.0)  # velocity of the waves east and north, km/h
    rotational: float = 0.7  # share of the amplitude without divergence


def random_waves(rng: np.random.Generator, kind: WaveKind, *, start: float, end: float) -> Waves:
    """Draw a random wind field whose amplitudes cover the hours from ``start`` to ``end``."""
    length = np.exp(rng.uniform(np.log(kind.lengths[0]), np.log(kind.lengths[1]), kind.count))
    kx, ky = rng.normal(size=(2, kind.count)) / length
    kz = rng.normal(size=kind.count) / kind.depth
    swirl = np.stack([-ky, kx]) / np.hypot(kx, ky)
    free = rng.normal(size=(2, kind.count)) + 1j * rng.normal(size=(2, kind.count))
    free /= np.sqrt(np.sum(np.abs(free) ** 2, axis=0))
    pair = kind.rotational * swirl + np.sqrt(1.0 - kind.rotational**2) * free
    pair = pair * (2.0 * kind.rms / np.sqrt(np.sum(np.abs(pair) ** 2)))
    omega = kx * kind.drift[0] + ky * kind.drift[1]
    # Complex amplitudes of unit variance.
    steps = int(np.ceil(end - start)) + 2 if np.isfinite(kind.memory) else 1
    series = rng.normal(size=(steps, kind.count)) + 1j * rng.normal(size=(steps, kind.count))
    series /= np.sqrt(2.0)
    if steps > 1:
        keep = float(np.exp(-1.0 / kind.memory))
        series[1:] *= np.sqrt(1.0 - keep**2)
        for step in range(1, steps):
            series[step] += keep * series[step - 1]
    return Waves(kx, ky, kz, omega, pair[0], pair[1], series, start)


@dataclass(frozen=True)
class WorldParameters:
    """Sizes of the wind and of the models' errors (one component, m/s, unless stated)."""

    jet: float = 34.0  # speed of the core
    waves: float = 6.5  # rms of the baroclinic waves at 500 hPa
    mesoscale: float = 1.5  # rms of the mesoscale at 500 hPa
    error: float = 1.95  # correlated error of a model
    shared: float = 0.35  # share of its variance that is common to all models
    bias: float = 0.2  # persistent error
    daily: float = 0.25  # amplitude of the daily error
    bias_lengths: tuple[float, float] = (500.0, 1500.0)  # correlation of both, km
    lengths: tuple[float, float] = (110.0, 320.0)  # correlation of the error, km
    memory: float = 6.0  # e-folding time of the error, h
    depth: float = 0.3  # vertical correlation length of the error, ln p
    tails: float = 0.0  # width of a log-normal factor on the error; 0 is Gaussian

    @classmethod
    def hard(cls) -> WorldParameters:
        """Sizes of the hard world: longer reach, more bias, heavy tails."""
        return cls(
            error=1.9,
            bias=0.5,
            daily=0.45,
            bias_lengths=(250.0, 800.0),
            lengths=(80.0, 600.0),
            memory=9.0,
            depth=0.45,
            tails=0.45,
        )


def _error_growth(zeta: Array) -> Array:
    """Factor on errors and mesoscale: 0.85 near 900 hPa, 1.3 at 300."""
    return np.asarray(np.clip(0.8 - 0.42 * zeta, 0.75, 1.4))


def _wave_growth(zeta: Array) -> Array:
    """Factor on the baroclinic waves: 0.6 at 900 hPa, 1 at 500, 1.35 at 300."""
    return np.asarray(np.clip(0.52 - 0.69 * zeta, 0.45, 1.5))


class World:
    """The true wind of an archive of ``end`` hours."""

    def __init__(self, parameters: WorldParameters, seed: int, end: float) -> None:
        self.parameters, self.seed = parameters, seed
        self._span = -_BEFORE, end + _AFTER
        large = WaveKind(36, parameters.waves, (450.0, 900.0), 1.2, 60.0, (38.0, -6.0), 0.97)
        small = WaveKind(90, parameters.mesoscale, (14.0, 80.0), 0.2, 5.0, (45.0, 5.0), 0.6)
        self.waves = self.drawn("waves", large)
        self.mesoscale = self.drawn("mesoscale", small)
        self._phases = stream(seed, "jet").uniform(0, 2 * np.pi, 4)

    def drawn(self, name: str, kind: WaveKind) -> Waves:
        """Random field of a named part."""
        return random_waves(stream(self.seed, name), kind, start=self._span[0], end=self._span[1])

    def _jet(self, x: Array, y: Array, zeta: Array, hours: Array) -> Array:
        """Eastward wind of the jet; arguments broadcast."""
        phases = self._phases
        # km north of the middle of the grid: it meanders in a week, and in waves of 4,400 km.
        axis = (
            150.0
            + 260.0 * np.sin(2 * np.pi * hours / 168.0 + phases[0])
            + 180.0 * np.sin(x / 700.0 - 2 * np.pi * hours / 110.0 + phases[1])
        )
        strength = self.parameters.jet * (1 + 0.25 * np.sin(2 * np.pi * hours / 260.0 + phases[2]))
        profile = 0.1 + 0.9 * np.exp(-(((zeta + 1.386) / 0.8) ** 2))  # core at 250 hPa
        return np.asarray(strength * profile * np.exp(-(((y - axis) / 620.0) ** 2)) + 2.0)

    def large_scale_at(self, x: Array, y: Array, zeta: Array, hours: Array) -> Array:
        """Jet and baroclinic waves at points, (2, n), m/s."""
        wind = self.waves.at_points(x, y, zeta, hours) * _wave_growth(zeta)
        wind[0] += self._jet(x, y, zeta, hours)
        return wind

    def at_points(self, x: Array, y: Array, zeta: Array, hours: Array) -> Array:
        """True eastward and northward wind (2, n), m/s, at scattered points (n,)."""
        wind = self.mesoscale.at_points(x, y, zeta, hours) * _error_growth(zeta)
        return wind + self.large_scale_at(x, y, zeta, hours)

    def large_scale_on_grid(self, x: Array, y: Array, zeta: Array, hours: Array) -> Fields:
        """Jet and baroclinic waves on a grid, (T, 2, L, rows, columns), m/s."""
        wind = self.waves.on_grid(x, y, zeta, hours)
        wind *= _wave_growth(zeta).astype(np.float32)[:, None, None]
        for step, hour in enumerate(hours):
            wind[step, 0] += self._jet(x, y, zeta[:, None, None], hour)
        return wind


def model_wind(
    world: World, name: str, x: Array, y: Array, zeta: Array, hours: Array, large_scale: Fields
) -> Fields:
    """Wind of a model on a grid (T, 2, L, rows, columns), m/s; its name seeds its errors.

    ``large_scale`` is `World.large_scale_on_grid` for the same arguments.
    """
    sizes = world.parameters

    def error(label: str, rms: float, count: int) -> Fields:
        kind = WaveKind(count, rms, sizes.lengths, sizes.depth, sizes.memory, (25.0, 0.0))
        return world.drawn(label, kind).on_grid(x, y, zeta, hours)

    def steady(label: str, rms: float) -> Fields:
        kind = WaveKind(24, rms, sizes.bias_lengths, 0.6, np.inf)
        return world.drawn(label + name, kind).on_grid(x, y, zeta, hours[:1])

    noise = error("error shared", sizes.error * np.sqrt(sizes.shared), 80)
    noise += error("error " + name, sizes.error * np.sqrt(1.0 - sizes.shared), 110)
    if sizes.tails > 0:
        burst = world.drawn("burst " + name, WaveKind(24, 1.0, (500.0, 900.0), 3.0, 18.0))
        factor = burst.on_grid(x, y, zeta[:1], hours)[:, :1]
        # A factor of unit mean square: heavier tails with the same rms.
        noise *= np.exp(sizes.tails * factor - sizes.tails**2)
    noise += steady("bias ", sizes.bias)
    cycle = np.cos(2 * np.pi * (hours - 15.0) / 24.0).astype(np.float32)
    # The rms of a cosine is one over the root of two.
    noise += (
        np.sqrt(np.float32(2.0)) * cycle[:, None, None, None, None] * steady("daily ", sizes.daily)
    )
    # The model resolves half of the mesoscale's amplitude at 250 km wavelength.
    meso = world.mesoscale
    amplitude = 1.0 / (1.0 + (250.0 / (2 * np.pi / np.hypot(meso.kx, meso.ky))) ** 4)
    resolved = replace(meso, east=meso.east * amplitude, north=meso.north * amplitude)
    noise += resolved.on_grid(x, y, zeta, hours)
    noise *= _error_growth(zeta).astype(np.float32)[:, None, None]
    noise += large_scale
    return np.asarray(noise, np.float32)
