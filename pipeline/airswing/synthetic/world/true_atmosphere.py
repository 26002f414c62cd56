"""The sample's atmosphere: a true wind, and references that know it imperfectly.

Assumptions
-----------
True wind = a westerly jet with shear whose axis meanders + travelling baroclinic waves +
mesoscale motion. A reference = jet and waves exactly, the mesoscale as far as its wavelength is
resolved, plus an error of its own shared by every aircraft: correlated over some hundred
kilometres, some hours and a fraction of a scale height, partly common to all references (they
see the same observations), with a persistent and a daily part. The hard world adds error of
longer reach, stronger bias and heavy tails (an amplitude that varies from day to day and place
to place).

Validity
--------
200-1000 hPa, a region of up to some 5000 km, any length of time. Sizes are set so that the mean
vector disagreement of a perfect instrument is about 6 kt and that of a fleet with ordinary
compass errors 7-9 kt, the range of the seed paper's field test.

Units
-----
km, hours since the archive's start, ln(p / 1000 hPa), m/s.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airswing.synthetic.world.waves import WaveKind, Waves, random_waves

__all__ = ["Reference", "World", "WorldParameters", "stream"]

Array = NDArray[np.float64]


def stream(seed: int, name: str) -> np.random.Generator:
    """Return the random generator of one named part of an archive.

    Parameters
    ----------
    name : str
        Part; each has its own numbers, so that switching one part on leaves the others as they
        were.

    Returns
    -------
    numpy.random.Generator
        Generator seeded by both.
    """
    return np.random.default_rng([seed, zlib.crc32(name.encode())])


@dataclass(frozen=True)
class WorldParameters:
    """Sizes of the wind and of the references' errors (one component, m/s, unless said)."""

    jet: float = 34.0  # speed of the jet core
    # waves, mesoscale: root mean square of the baroclinic waves and of the mesoscale at 500 hPa
    waves: float = 6.5
    mesoscale: float = 1.5
    error: float = 1.95  # correlated error of a reference
    shared: float = 0.35  # share of that error's variance common to all references
    # bias, daily: persistent error and amplitude of its daily part
    bias: float = 0.2
    daily: float = 0.25
    # range of the persistent parts' correlation lengths, km
    bias_lengths: tuple[float, float] = (500.0, 1500.0)
    lengths: tuple[float, float] = (110.0, 320.0)  # range of the error's correlation lengths, km
    memory: float = 6.0  # e-folding time of the error, h
    depth: float = 0.3  # vertical correlation length of the error in ln p
    # 0 for Gaussian error; 0.5 makes its amplitude vary by a log-normal factor of that width
    tails: float = 0.0

    @classmethod
    def hard(cls) -> WorldParameters:
        """Return the hard world: longer reach, more bias, heavy tails."""
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


def _growth(zeta: Array) -> Array:
    """Return the growth of errors and mesoscale with height: 0.85 near 900 hPa, 1.3 at 300."""
    return np.asarray(np.clip(0.8 - 0.42 * zeta, 0.75, 1.4))


@dataclass(frozen=True)
class World:
    """The true wind."""

    parameters: WorldParameters  # sizes
    seed: int  # seed of everything drawn
    end: float  # length of the archive in h

    def __post_init__(self) -> None:
        """Draw the fields."""
        sizes = self.parameters
        start, end = -12.0, self.end + 24.0
        waves = random_waves(
            stream(self.seed, "waves"),
            WaveKind(
                count=36,
                rms=sizes.waves,
                lengths=(450.0, 900.0),
                depth=1.2,
                memory=60.0,
                drift=(38.0, -6.0),
                rotational=0.97,
            ),
            start=start,
            end=end,
        )
        meso = random_waves(
            stream(self.seed, "mesoscale"),
            WaveKind(
                count=90,
                rms=sizes.mesoscale,
                lengths=(14.0, 80.0),
                depth=0.2,
                memory=5.0,
                drift=(45.0, 5.0),
                rotational=0.6,
            ),
            start=start,
            end=end,
        )
        rng = stream(self.seed, "jet")
        object.__setattr__(self, "waves", waves)
        object.__setattr__(self, "mesoscale", meso)
        object.__setattr__(self, "_phases", rng.uniform(0, 2 * np.pi, 4))

    waves: Waves = None  # type: ignore[assignment]
    mesoscale: Waves = None  # type: ignore[assignment]

    def _jet(self, x: Array, y: Array, zeta: Array, hours: Array) -> Array:
        """Return the jet's eastward wind; arguments broadcast."""
        phases: Array = self._phases  # type: ignore[attr-defined]
        # km north of the grid's middle: it wanders in a week, and in waves of 4,400 km
        axis = (
            150.0
            + 260.0 * np.sin(2 * np.pi * hours / 168.0 + phases[0])
            + 180.0 * np.sin(x / 700.0 - 2 * np.pi * hours / 110.0 + phases[1])
        )
        strength = self.parameters.jet * (1 + 0.25 * np.sin(2 * np.pi * hours / 260.0 + phases[2]))
        profile = 0.1 + 0.9 * np.exp(-(((zeta + 1.386) / 0.8) ** 2))  # core at 250 hPa
        return np.asarray(strength * profile * np.exp(-(((y - axis) / 620.0) ** 2)) + 2.0)

    def large_scale_at(self, x: Array, y: Array, zeta: Array, hours: Array) -> Array:
        """Return jet and baroclinic waves at points, m/s, shape (2, n)."""
        wind = self.waves.at_points(x, y, zeta, hours) * _wave_profile(zeta)
        wind[0] += self._jet(x, y, zeta, hours)
        return wind

    def at_points(self, x: Array, y: Array, zeta: Array, hours: Array) -> Array:
        """Return the true wind at scattered points.

        Parameters
        ----------
        x, y, zeta, hours : ndarray (n,)
            km, ln(p / 1000 hPa), hours since the start.

        Returns
        -------
        ndarray (2, n)
            Eastward and northward wind, m/s.
        """
        wind = self.mesoscale.at_points(x, y, zeta, hours) * _growth(zeta)
        return wind + self.large_scale_at(x, y, zeta, hours)

    def large_scale_on_grid(
        self, x: Array, y: Array, zeta: Array, hours: Array
    ) -> NDArray[np.float32]:
        """Return jet and waves on a grid, m/s, shape (T, 2, L, rows, columns), float32."""
        wind = self.waves.on_grid(x, y, zeta, hours)
        wind *= _wave_profile(zeta).astype(np.float32)[:, None, None]
        for step, hour in enumerate(hours):
            wind[step, 0] += self._jet(x, y, zeta[:, None, None], hour)
        return wind


def _wave_profile(zeta: Array) -> Array:
    """Return the waves' growth with height: 0.6 at 900 hPa, 1 at 500, 1.35 at 300."""
    return np.asarray(np.clip(0.52 - 0.69 * zeta, 0.45, 1.5))


@dataclass(frozen=True)
class Reference:
    """What one model makes of the true wind."""

    world: World  # the truth
    name: str  # name of the model; seeds its own error
    level: float = 1.0  # factor on the error: 1 for an ordinary model

    def __post_init__(self) -> None:
        """Draw the errors: shared, own, persistent and daily."""
        sizes, seed = self.world.parameters, self.world.seed
        start, end = -12.0, self.world.end + 24.0

        def error(label: str, rms: float, count: int) -> Waves:
            return random_waves(
                stream(seed, label),
                WaveKind(
                    count=count,
                    rms=rms * self.level,
                    lengths=sizes.lengths,
                    depth=sizes.depth,
                    memory=sizes.memory,
                    drift=(25.0, 0.0),
                ),
                start=start,
                end=end,
            )

        def steady(label: str, rms: float) -> Waves:
            return random_waves(
                stream(seed, label + self.name),
                WaveKind(count=24, rms=rms, lengths=sizes.bias_lengths, depth=0.6, memory=np.inf),
                start=start,
                end=end,
            )

        own = np.sqrt(1.0 - sizes.shared)
        object.__setattr__(
            self,
            "errors",
            (
                error("error shared", sizes.error * np.sqrt(sizes.shared), 80),
                error("error " + self.name, sizes.error * own, 110),
            ),
        )
        object.__setattr__(self, "bias", steady("bias ", sizes.bias))
        object.__setattr__(self, "daily", steady("daily ", sizes.daily))
        object.__setattr__(self, "burst", self._burst())

    errors: tuple[Waves, ...] = ()
    bias: Waves = None  # type: ignore[assignment]
    daily: Waves = None  # type: ignore[assignment]
    burst: Waves = None  # type: ignore[assignment]

    def _burst(self) -> Waves:
        """Draw the field whose exponential scales the error where tails are heavy."""
        return random_waves(
            stream(self.world.seed, "burst " + self.name),
            WaveKind(count=24, rms=1.0, lengths=(500.0, 900.0), depth=3.0, memory=18.0),
            start=-12.0,
            end=self.world.end + 24.0,
        )

    def _resolved(self) -> Waves:
        """Return the mesoscale as far as the model resolves it: half at 250 km wavelength."""
        meso = self.world.mesoscale
        wavelength = 2 * np.pi / np.hypot(meso.kx, meso.ky)
        kept = 1.0 / (1.0 + (250.0 / wavelength) ** 4)
        fields = {**meso.__dict__, "east": meso.east * kept, "north": meso.north * kept}
        return Waves(**fields)

    def on_grid(
        self,
        x: Array,
        y: Array,
        zeta: Array,
        hours: Array,
        *,
        large_scale: NDArray[np.float32] | None = None,
    ) -> NDArray[np.float32]:
        """Return the model's wind on a grid.

        Parameters
        ----------
        x, y : ndarray (rows, columns)
            Grid points in km.
        zeta : ndarray (L,)
            Levels, ln(p / 1000 hPa).
        hours : ndarray (T,)
            Valid times, hours since the start.
        large_scale : ndarray (T, 2, L, rows, columns), optional
            `World.large_scale_on_grid` for the same arguments, where it is known already.

        Returns
        -------
        ndarray float32 (T, 2, L, rows, columns)
            True eastward and northward wind in m/s.
        """
        sizes = self.world.parameters
        noise = self.errors[0].on_grid(x, y, zeta, hours)
        noise += self.errors[1].on_grid(x, y, zeta, hours)
        if sizes.tails > 0:
            field = self.burst.on_grid(x, y, zeta[:1], hours)[:, :1]
            # of unit mean square: heavier tails, the same rms
            noise *= np.exp(sizes.tails * field - sizes.tails**2)
        noise += self.bias.on_grid(x, y, zeta, hours[:1])
        cycle = np.cos(2 * np.pi * (hours - 15.0) / 24.0).astype(np.float32)
        daily = self.daily.on_grid(x, y, zeta, hours[:1])
        # a cosine's rms is one over the root of two
        noise += np.sqrt(np.float32(2.0)) * cycle[:, None, None, None, None] * daily
        noise += self._resolved().on_grid(x, y, zeta, hours)
        noise *= _growth(zeta).astype(np.float32)[:, None, None]
        if large_scale is None:
            large_scale = self.world.large_scale_on_grid(x, y, zeta, hours).astype(np.float32)
        noise += large_scale
        return np.asarray(noise, np.float32)
