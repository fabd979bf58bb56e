"""Counter-based standard normal vectors: a sample depends on a key and its index only."""

from __future__ import annotations

import abc
import functools
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt32

from jaxgeo._checks import concrete, require_x64
from jaxgeo._elementary import logarithm
from jaxgeo._record import Record
from jaxgeo._typing import IndexField, Numbers
from jaxgeo.uncertainty import sobol

Vector: TypeAlias = Float[Array, " size"]
Pairs: TypeAlias = tuple[Float[Array | np.ndarray, "... pairs"], Float[Array | np.ndarray, "... pairs"]]
Stage: TypeAlias = Callable[[Any], Any]
Anywhere: TypeAlias = Array | np.ndarray


KIND = "threefry2x32"  # of keys
MORE = "Draw them in several parts."  # appended to messages about too large indices
OWN = 0x6A617867  # folded into a key, so that other uses of the key draw different numbers
ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))
WEYL = 0x9E3779B9  # step of the seeds of the scrambles (Steele, Lea and Flood 2014, "Fast splittable generators")
SEEDS = 2**31  # second counter word of the first seed; independent numbers are counted from 0
LEADING = 4  # numbers of a sample from Sobol points, two at a time: a fix depends on three to first order


class Seeds(NamedTuple):
    """The two words that a key becomes, and two for each axis of Sobol points (none for independent numbers)."""

    own: Any
    of_points: tuple[Any, ...] = ()


def first_key() -> Any:
    """`jax.random.key(0)` of the kind that `Random` and `Sobol` need, for which JAX would compile two programs."""
    return jax.random.wrap_key_data(jax.device_put(np.zeros(2, np.uint32)), impl=KIND)


class AbstractDraws(Record):
    """Generator of the standard normal vectors of a sampling."""

    @property
    def most(self) -> int:
        """The number of samples of a key."""
        return 2**32

    def standard_normal(self, key: Any, index: IndexField, size: int) -> Vector:
        """Sample number `index`, counted from 0: `size` independent standard normal numbers.

        The same for the same key and index, alone or under `vmap`, in chunks of any size. The first numbers do not
        change when `size` grows. All are finite, within 8.5 of zero. Raises `ValueError` for an index out of range and
        for a key other than JAX's default kind, whose numbers change under `vmap`.
        """
        numbers = index
        for stage in self.stages(key, size):
            numbers = stage(numbers)
        return numbers

    @abc.abstractmethod
    def stages(self, key: Any, size: int) -> tuple[Stage, ...]:
        """Functions that, applied in order to an index, give `standard_normal`, with the errors that it raises.

        A batch passes each stage as a whole; otherwise the compiler repeats the first stage for each use of the last.
        """

    def sample_stages(self, key: Any, size: int, leading: int) -> tuple[Stage, ...]:
        """The stages of the standard normal vectors from which `sample` draws, whose first numbers matter most.

        `key` is a key, or the `seeds` of one.
        """
        return self.stages(key, size)

    def seeds(self, key: Any, size: int, leading: int) -> Any:
        """What `sample_stages` make of a key, so that a program of theirs need not."""
        return key


class Random(AbstractDraws):
    """Independent draws, up to 2^32 samples: two at a time, by the Box-Muller transform (1958)."""

    def stages(self, key: Any, size: int) -> tuple[Stage, ...]:
        def uniform(index: IndexField) -> Pairs:
            _check(index, size, self.most)
            return _random_pairs(self.seeds(key, size).own, jnp.asarray(index), size)

        return uniform, _polar, functools.partial(_normal, size=size)

    def seeds(self, key: Any, size: int, leading: int = 0) -> Seeds:
        return key if isinstance(key, Seeds) else Seeds(_seeds(key, 0).own)


class Sobol(AbstractDraws):
    """Sobol points (low discrepancy) in several independent scrambles, whose spread gives an error estimate.

    Sample `index` is point `index // scrambles` of scramble `index % scrambles`; 2^32 points in each. Each scramble is
    a uniform and unbiased sample, best at a power of two of points. The spread between the scrambles' results estimates
    the error of their mean (see `intervals.scrambled_interval`); samples within one scramble are not independent.
    Raises `ValueError` for more than 1024 dimensions.

    `sample` draws the four numbers that displace the fix most from Sobol points, by the Box-Muller transform, and all
    others independently: a fix depends on three to first order. If errors are not normal, all are from Sobol points.
    """

    scrambles: int = eqx.field(static=True, default=16)

    def __check_init__(self) -> None:
        if not isinstance(self.scrambles, int) or self.scrambles < 1:
            raise ValueError(f"scrambles must be a whole number of at least 1; got {self.scrambles!r}.")

    @property
    def most(self) -> int:
        return self.scrambles * 2**32

    def stages(self, key: Any, size: int) -> tuple[Stage, ...]:
        def uniform(index: IndexField) -> Vector:
            _check(index, size, self.most)
            return self._points(_seeds(key, size).of_points, jnp.asarray(index), size)

        return uniform, normal_quantile

    def sample_stages(self, key: Any, size: int, leading: int) -> tuple[Stage, ...]:
        def uniform(index: IndexField) -> tuple[Any, Any]:
            _check(index, size, self.most)
            return self._mixed_pairs(self.seeds(key, size, leading), jnp.asarray(index), size, leading)

        def polar(uniform: tuple[Any, Any]) -> tuple[Any, Any]:
            return _polar(uniform[0]), _polar(uniform[1])

        def normal(polar: tuple[Any, Any]) -> Vector:
            first = min(size, leading)
            return jnp.concatenate([_normal(polar[0], first), _normal(polar[1], size - first)])

        return uniform, polar, normal

    def seeds(self, key: Any, size: int, leading: int) -> Seeds:
        return key if isinstance(key, Seeds) else _seeds(key, 2 * _pairs(size, leading))

    def trial(self, count: int, size: int, leading: int) -> np.ndarray:
        """The first samples (count, size) of `sample_stages` of the key 0, by NumPy."""
        zero = np.zeros(1, np.uint32)
        own = threefry((zero, zero), zero, zero + np.uint32(OWN))
        seeds = Seeds(own, _of_points(own, 2 * _pairs(size, leading)))
        pairs = self._mixed_pairs(seeds, np.arange(count), size, leading)
        centred, turn = (np.concatenate(parts, axis=1) for parts in zip(*pairs, strict=True))
        radius, angle = np.sqrt(-2.0 * np.log(0.5 + centred)), 2.0 * np.pi * turn
        return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=2).reshape(count, -1)[:, :size]

    def _mixed_pairs(self, seeds: Seeds, index: Any, size: int, leading: int) -> tuple[Any, Any]:
        """Pairs of uniform numbers from Sobol points for the first normal numbers, and independent ones for the others.

        Not joined before they are normal, which would keep the compiler from computing several at once.
        """
        pairs = _pairs(size, leading)
        points = self._points(seeds.of_points, index, 2 * pairs)
        return (points[..., 0::2], points[..., 1::2]), _random_pairs(seeds.own, index, size - 2 * pairs)

    def _points(self, seeds: tuple[Any, ...], index: Any, size: int) -> Any:
        """Coordinates in (-1/2, 1/2) of samples. The bits below 2^-32 repeat others, so that points lie anywhere."""
        seed, other = seeds
        index, scrambles = index.astype(np.uint64), np.uint64(self.scrambles)  # without a sign they divide faster
        table = sobol.point_table(size)
        table = table if isinstance(index, np.ndarray) else jnp.asarray(table)
        point = sobol.sobol_point((index // scrambles).astype(np.uint32), table)
        shift = sobol.mix(seed + (index % scrambles).astype(np.uint32)[..., None] * np.uint32(WEYL))
        digits = sobol.scramble(point, shift, (shift ^ other) * np.uint32(WEYL))
        return _centre(sobol.mirror(digits), digits)


def _pairs(size: int, leading: int) -> int:
    """How many pairs of a sample come from Sobol points."""
    return -(-min(size, leading) // 2)


def _seeds(key: Any, axes: int) -> Seeds:
    """The seeds of a key with `axes` of Sobol points, in NumPy if the key is known.

    Their own words are those of `jax.random.fold_in(key, OWN)`.
    """
    kind = str(jax.random.key_impl(key))
    if kind != KIND:
        raise ValueError(f"key must be of the kind {KIND}, as jax.random.key(0) is by default; got {kind}.")
    words = concrete(jax.random.key_data(key))
    if words is not None:
        return _known_seeds(*map(int, words), axes)
    own = jax.random.key_data(jax.random.fold_in(key, OWN))
    return Seeds(own, _of_points(own, axes))


@functools.lru_cache(maxsize=64)
def _known_seeds(first: int, second: int, axes: int) -> Seeds:
    """`_seeds` of the words of a key."""
    own: Any = threefry(np.array([[first], [second]], np.uint32), *np.array([[0], [OWN]], np.uint32))
    seeds = Seeds(own, _of_points(own, axes))
    for word in jax.tree.leaves(seeds):
        word.flags.writeable = False
    return seeds


def _of_points(own: Any, axes: int) -> tuple[Any, Any]:
    """The two words of each axis of Sobol points."""
    numbers = np.uint32(SEEDS) + np.arange(axes, dtype=np.uint32)
    return threefry(own, np.zeros(axes, np.uint32), numbers)


def _random_pairs(own: Any, index: Any, size: int) -> Pairs:
    """Pairs of independent uniform numbers in (-1/2, 1/2), enough for `size` normal ones."""
    even = np.arange(0, max(size, 0), 2, dtype=np.uint32)
    numbers = np.concatenate([even, even + np.uint32(1)])
    sample = index.astype(np.uint32)[..., None] + 0 * numbers
    centred = _centre(*threefry(own, sample, numbers + 0 * sample))
    return centred[..., : even.size], centred[..., even.size :]


def _polar(uniform: Any) -> Pairs:
    centred, turn = uniform
    return jnp.sqrt(-2.0 * logarithm(0.5 + centred)), turn


def _normal(polar: Pairs, size: int) -> Vector:
    radius, turn = (jnp.repeat(each, 2)[:size] for each in polar)
    return radius * _cosine_and_sine_in_turn(turn)


def threefry(
    key: Any, first: UInt32[Anywhere, "*shape"], second: UInt32[Anywhere, "*shape"]
) -> tuple[UInt32[Anywhere, "*shape"], UInt32[Anywhere, "*shape"]]:
    """Two random words for each pair of counter words: the generator behind JAX's keys, unrolled.

    Threefry-2x32-20, Salmon et al. 2011, "Parallel random numbers: as easy as 1, 2, 3". JAX's own version loops over
    the rounds and writes each to memory: three times as slow on a CPU.
    """
    keys = key[0], key[1], key[0] ^ key[1] ^ np.uint32(0x1BD11BDA)
    first, second = first + keys[0], second + keys[1]
    for group in range(5):
        for rotation in ROTATIONS[group % 2]:
            first = first + second
            second = (second << rotation | second >> (32 - rotation)) ^ first
        first = first + keys[(group + 1) % 3]
        second = second + keys[(group + 2) % 3] + np.uint32(group + 1)
    return first, second


def _centre(high: UInt32[Anywhere, "..."], low: UInt32[Anywhere, "..."]) -> Float[Anywhere, "..."]:
    """Numbers in (-1/2, 1/2) from 51 random bits: odd multiples of 2^-52, so never 0 nor an end point, and exact.

    The bits form the fraction of a float in [1, 2), which is much cheaper than a conversion of 64-bit integers. The odd
    bit is set in the fraction: XLA would fold it into the 1.5 if it were added later, and lose it.
    """
    fraction = high.astype(np.uint64) << 20 | (low >> 12 | 1).astype(np.uint64)
    return (fraction | np.uint64(0x3FF << 52)).view(np.float64) - 1.5


# Polynomial of sin(pi / 2 w) / w in w^2 on [-1, 1] through nine Chebyshev nodes; error below 4e-19.
_SINE = (1.5707963267948966, -0.6459640975062462, 0.07969262624616565, -0.004681754135304255, 0.0001604411847130916,
         -3.5988430204672576e-06, 5.6921364280986254e-08, -6.684416831856085e-10, 5.87297574479995e-12)  # fmt: skip


def _cosine_and_sine_in_turn(turn: Vector) -> Vector:
    """Cosines at even indices and sines at odd ones, of angles in turns from -1/2 to 1/2.

    All are computed in one loop as sines of quarter turns from -1 to 1, which are exact.
    """
    size = jnp.abs(turn)
    of_cosine = 1.0 - 4.0 * size
    of_sine = jnp.copysign(jnp.minimum(4.0 * size, 2.0 - 4.0 * size), turn)
    quarters = jnp.where(jnp.arange(turn.size) % 2 == 0, of_cosine, of_sine)
    squared = quarters * quarters
    sine = jnp.full_like(quarters, _SINE[-1])
    for coefficient in _SINE[-2::-1]:
        sine = sine * squared + coefficient
    return sine * quarters


# Coefficients of numerator and denominator, highest power first, for the middle and the near and far tails.
_MIDDLE = (
    (2509.0809287301226727, 33430.575583588128105, 67265.770927008700853, 45921.953931549871457,
     13731.693765509461125, 1971.5909503065514427, 133.14166789178437745, 3.3871328727963666080),
    (5226.4952788528545610, 28729.085735721942674, 39307.895800092710610, 21213.794301586595867,
     5394.1960214247511077, 687.18700749205790830, 42.313330701600911252, 1.0),
)  # fmt: skip
_NEAR = (
    (7.74545014278341407640e-4, 0.0227238449892691845833, 0.241780725177450611770, 1.27045825245236838258,
     3.64784832476320460504, 5.76949722146069140550, 4.63033784615654529590, 1.42343711074968357734),
    (1.05075007164441684324e-9, 5.47593808499534494600e-4, 0.0151986665636164571966, 0.148103976427480074590,
     0.689767334985100004550, 1.67638483018380384940, 2.05319162663775882187, 1.0),
)  # fmt: skip
_FAR = (
    (2.01033439929228813265e-7, 2.71155556874348757815e-5, 0.00124266094738807843860, 0.0265321895265761230930,
     0.296560571828504891230, 1.78482653991729133580, 5.46378491116411436990, 6.65790464350110377720),
    (2.04426310338993978564e-15, 1.42151175831644588870e-7, 1.84631831751005468180e-5, 7.86869131145613259100e-4,
     0.0148753612908506148525, 0.136929880922735805310, 0.599832206555887937690, 1.0),
)  # fmt: skip


def normal_quantile(centred: Numbers) -> Numbers:
    """Quantile of the standard normal distribution at the probability 1/2 + `centred`, with `centred` in (-1/2, 1/2).

    Wichura 1988, "Algorithm AS 241: the percentage points of the normal distribution", to 1e-15; odd to the last bit.
    The coefficients are selected first and one quotient is evaluated: twice as fast as `jax.scipy.special.ndtri`.
    """
    middle = jnp.abs(centred) <= 0.425
    tail = jnp.where(middle, 0.5, 0.5 - jnp.abs(centred))
    depth = jnp.sqrt(-logarithm(tail))
    far = depth > 5.0
    x = jnp.where(middle, 0.180625 - centred * centred, depth - jnp.where(far, 5.0, 1.6))
    above, below = jnp.zeros_like(x), jnp.zeros_like(x)
    for power in range(8):
        above = above * x + jnp.where(middle, _MIDDLE[0][power], jnp.where(far, _FAR[0][power], _NEAR[0][power]))
        below = below * x + jnp.where(middle, _MIDDLE[1][power], jnp.where(far, _FAR[1][power], _NEAR[1][power]))
    return above / below * jnp.where(middle, centred, jnp.sign(centred))


def _check(index: Any, size: int, count: int) -> None:
    """Raise `ValueError` if a sample cannot be drawn."""
    require_x64()
    if not isinstance(size, int) or size < 0:
        raise ValueError(f"size must be a whole number of at least 0; got {size!r}.")
    if jnp.ndim(index) != 0 or not jnp.issubdtype(jnp.result_type(index), jnp.integer):
        raise ValueError(
            f"index must be one whole number; got shape {jnp.shape(index)} of {jnp.result_type(index)}. Draw several "
            f"samples with jax.vmap over the index."
        )
    known = concrete(index)
    if known is not None and not 0 <= int(known) < count:
        raise ValueError(f"index must be from 0 to {count - 1}, the last sample of these draws; got {known}.")
