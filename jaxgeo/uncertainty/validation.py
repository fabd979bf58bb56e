"""Result of a comparison of actual with stated errors, its tests, and what they mean in words."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import scipy  # submodules load lazily, when first used

from jaxgeo.status import Status, count_statuses
from jaxgeo.uncertainty._figures import figure

LEVELS = (0.5, 0.9, 0.95)
SIGNIFICANCE, CONFIDENCE = 0.05, 0.95
SHOWN = 5  # names in a sentence
ALL_THE_SAME = 1e-9  # relative: a range, an angle or a slope that does not vary


@dataclasses.dataclass(frozen=True)
class Size:
    """Normalised squared error (NEES): of `degrees` degrees of freedom if the model is true.

    `low` and `high` contain it with 95 %; `p` is that of the two-sided chi-square test. `factor`, from `least` to
    `most` with 95 % confidence, is the size of the errors in those of the model.
    """

    nees: float
    degrees: int
    low: float
    high: float
    p: float
    factor: float
    least: float
    most: float

    @classmethod
    def of(cls, nees: float, degrees: int) -> Size:
        """From the sum of squares."""
        tail = 0.5 * (1.0 - CONFIDENCE)
        chi2 = scipy.stats.chi2
        low, high = float(chi2.ppf(tail, degrees)), float(chi2.ppf(1.0 - tail, degrees))
        p = min(1.0, 2.0 * float(min(chi2.cdf(nees, degrees), chi2.sf(nees, degrees))))
        sizes = (float(np.sqrt(nees / x)) for x in (degrees, high, low))
        return cls(nees, degrees, low, high, p, *sizes)

    @property
    def words(self) -> str:
        """The size in a sentence."""
        verdict = "as large as the model says"
        if self.p < SIGNIFICANCE:
            verdict = "larger than the model says" if self.factor > 1.0 else "smaller than the model says"
        return (
            f"{verdict}: {figure(self.factor)} times ({figure(self.least)} to {figure(self.most)}), "
            f"NEES {figure(self.nees, 4)} of {figure(self.low, 4)} to {figure(self.high, 4)} expected, {_p(self.p)}"
        )


@dataclasses.dataclass(frozen=True)
class Uniformity:
    """Histogram of the normalised errors' probability integral transform, and its Kolmogorov-Smirnov test."""

    counts: np.ndarray
    statistic: float
    p: float


@dataclasses.dataclass(frozen=True)
class Bias:
    """Mean error along an axis in m, its `sigma` under the model with shared errors, and the tests of zero.

    `z` and `p` are of the model; `t` and `p_t` of the scatter of the errors as if points shared none, NaN if they do
    not scatter.
    """

    axis: str
    mean: float
    sigma: float
    z: float
    p: float
    t: float
    p_t: float


@dataclasses.dataclass(frozen=True)
class Dependence:
    """Spearman's rank correlation of the size of the normalised errors with a quantity; NaN if one does not vary."""

    name: str
    unit: str
    values: np.ndarray
    correlation: float
    p: float


@dataclasses.dataclass(frozen=True)
class Coverage:
    """Number of points `inside` a stated radius, of `count`.

    `effective` is the number of independent points to which these amount, `low` and `high` are the Clopper-Pearson
    interval of the share (95 %) for that number, and `p` the probability under the model of a share as far from
    `level`.
    """

    name: str
    level: float
    inside: int
    count: int
    effective: float
    low: float
    high: float
    p: float

    @property
    def share(self) -> float:
        """Share of points inside."""
        return self.inside / self.count


@dataclasses.dataclass(frozen=True)
class Validation:
    """Actual errors at check points against those of an error model; `str` says what they mean.

    - `points`, `images`, `status`, `error_enu` (n, 3) in m: of all pixels; the error is NaN without a fix.
    - `index`: the pixels with a fix, which are tested; of these `covariance_enu` (m, 3, 3) in m2, `nees_each` (m,)
      the normalised squared error of each, and `normalised` (m, 3): errors times the inverse square root of their
      joint covariance, independent and standard normal if the model is true.
    - `size`, `horizontal`, `vertical`, `uniformity`, `bias`, `dependence`, `coverage`: the tests; see `validate`.
    - `note`: what linear propagation leaves out of errors that are not normal.
    """

    points: np.ndarray
    images: np.ndarray
    status: np.ndarray
    error_enu: np.ndarray
    index: np.ndarray
    covariance_enu: np.ndarray
    normalised: np.ndarray
    nees_each: np.ndarray
    size: Size
    horizontal: Size
    vertical: Size
    uniformity: Uniformity
    bias: tuple[Bias, ...]
    dependence: tuple[Dependence, ...]
    coverage: tuple[Coverage, ...]
    note: str | None = None

    @property
    def tests(self) -> dict[str, float]:
        """p-values by name of the tests that `is_consistent` combines; without quantities that do not vary."""
        found = {"size": self.size.p, "size across": self.horizontal.p, "size up": self.vertical.p}
        found |= {"shape": self.uniformity.p}
        found |= {f"bias {one.axis}": one.p for one in self.bias}
        return found | {f"dependence on {one.name}": one.p for one in self.dependence if np.isfinite(one.p)}

    @property
    def rejected(self) -> tuple[str, ...]:
        """Tests that refuse the model at 5 % for all of them together (Holm 1979)."""
        ordered = sorted(self.tests.items(), key=lambda one: one[1])
        found = []
        for number, (name, p) in enumerate(ordered):
            if p > SIGNIFICANCE / (len(ordered) - number):
                break
            found.append(name)
        return tuple(found)

    @property
    def is_consistent(self) -> bool:
        """Whether no test refuses the model."""
        return not self.rejected

    @property
    def effective(self) -> float:
        """Number of independent points to which the points amount, by CE90."""
        return next(one.effective for one in self.coverage if one.name == "CE90")

    @property
    def outliers(self) -> np.ndarray:
        """Rows of pixels whose own error the model makes improbable (chi-square, 5 % for all together)."""
        p = scipy.stats.chi2.sf(self.nees_each, 3)
        worst = np.flatnonzero(p < SIGNIFICANCE / len(p))
        return self.index[worst[np.argsort(p[worst])]]

    @property
    def words(self) -> str:
        """What the tests mean, in a few lines."""
        return "\n".join([self._verdict(), *self._lines()])

    def __str__(self) -> str:
        return self.words

    def to_dict(self) -> dict[str, Any]:
        """Figures and points as plain Python values; lengths in m."""
        tests = {name: dataclasses.asdict(getattr(self, name)) for name in ("size", "horizontal", "vertical")}
        uniform = dataclasses.asdict(self.uniformity) | {"counts": self.uniformity.counts.tolist()}
        depends = [
            {"name": one.name, "correlation": _known(one.correlation), "p": _known(one.p)} for one in self.dependence
        ]
        return {
            "is_consistent": self.is_consistent,
            "rejected": list(self.rejected),
            "words": self.words,
            "effective_points": self.effective,
            **tests,
            "uniformity": uniform,
            "bias": [dataclasses.asdict(one) | {"t": _known(one.t), "p_t": _known(one.p_t)} for one in self.bias],
            "dependence": depends,
            "coverage": [dataclasses.asdict(one) | {"share": one.share} for one in self.coverage],
            "points": self._rows(),
        }

    def _rows(self) -> list[dict[str, Any]]:
        place = {int(row): number for number, row in enumerate(self.index)}
        rows = []
        for row, (point, image) in enumerate(zip(self.points.tolist(), self.images.tolist(), strict=True)):
            number = place.get(row)
            east, north, up = (_known(float(x)) for x in self.error_enu[row])
            found: dict[str, Any] = {"point": point, "image": image, "status": Status(int(self.status[row])).name}
            found |= {"error_east_m": east, "error_north_m": north, "error_up_m": up}
            sigma = [None] * 3 if number is None else np.sqrt(np.diag(self.covariance_enu[number])).tolist()
            found |= dict(zip(("sigma_east_m", "sigma_north_m", "sigma_up_m"), sigma, strict=True))
            rows.append(found | {"nees": None if number is None else float(self.nees_each[number])})
        return rows

    def _verdict(self) -> str:
        fixes = f"{len(self.index)} of {len(self.points)} pixels have a fix"
        if self.is_consistent:
            return f"The errors agree with the model. {fixes}."
        if self._is_shared_otherwise:
            return f"Errors across and up are as large as the model says, but not shared as it says. {fixes}."
        sizes = {
            "size": ("", self.size),
            "size across": (" across", self.horizontal),
            "size up": (" up", self.vertical),
        }
        wrong = next((sizes[name] for name in sizes if name in self.rejected), None)
        if wrong is None:
            return f"The errors do not agree with the model ({', '.join(self.rejected)}). {fixes}."
        factor = wrong[1].factor
        way = "optimistic" if factor > 1.0 else "pessimistic"
        return f"The model is too {way}: errors{wrong[0]} are {figure(factor, 2)} times as large as it says. {fixes}."

    @property
    def _is_shared_otherwise(self) -> bool:
        """Whether only combinations of the errors are larger than stated, not those across or up."""
        wrong = set(self.rejected)
        return "size" in wrong and not {"size across", "size up"} & wrong and self.size.factor > 1.0

    def _lines(self) -> list[str]:
        lines = [f"Errors are {self.size.words}."]
        if self._is_shared_otherwise:
            lines.append(
                "Differences between points, or heights over the ground, err by more than is left of the model's "
                "errors when what they share is taken out. Terrain errors that differ from place to place are a "
                "TerrainField, not a TerrainHeight."
            )
        lines += [f"  {name}: {one.words}" for name, one in (("across", self.horizontal), ("up", self.vertical))]
        count = len(self.index)
        if self.effective < count:
            amount = figure(self.effective, 2)
            lines.append(f"Shared errors: for coverage the {count} pixels amount to {amount} independent ones.")
        for one in self.coverage:
            lines.append(
                f"  {one.name:5s} contains {one.inside} of {one.count}: {100.0 * one.share:.0f} % "
                f"({100.0 * one.low:.0f} to {100.0 * one.high:.0f} %, {_p(one.p)})"
            )
        lines.append("Mean errors: " + "; ".join(self._bias(one) for one in self.bias) + ".")
        shape = "normal" if self.uniformity.p >= SIGNIFICANCE else "not standard normal"
        lines.append(f"Normalised errors are {shape} ({_p(self.uniformity.p)}).")
        lines.append("Their size " + "; ".join(map(_depends, self.dependence)) + ".")
        lines += self._of_points()
        return lines if self.note is None else [*lines, self.note]

    def _bias(self, one: Bias) -> str:
        return f"{one.axis} {figure(one.mean, 3, '+')} m, {figure(abs(one.z), 2)} sigma ({_p(one.p)})"

    def _of_points(self) -> list[str]:
        lines = []
        rows = self.outliers
        if len(rows):
            names = ", ".join(f"{self.points[row]} in {self.images[row]}" for row in rows[:SHOWN])
            more = f" and {len(rows) - SHOWN} more" if len(rows) > SHOWN else ""
            lines.append(f"Errors far beyond their own sigmas: {names}{more}.")
        without = np.setdiff1d(np.arange(len(self.points)), self.index)
        for status in count_statuses(self.status[without]):
            rows = without[self.status[without] == status]
            names = ", ".join(f"{self.points[row]}" for row in rows[:SHOWN])
            more = f" and {len(rows) - SHOWN} more" if len(rows) > SHOWN else ""
            lines.append(f"Not tested, {status.name}: {names}{more}. {status.message}")
        return lines


def is_constant(values: np.ndarray) -> bool:
    """Whether numbers differ by no more than rounding."""
    return bool(np.ptp(values) <= ALL_THE_SAME * np.abs(values).max(initial=1.0))


def _depends(one: Dependence) -> str:
    if not np.isfinite(one.p):
        same = "which is the same for all" if is_constant(one.values) else "since it is the same for all"
        return f"is not tested against {one.name}, {same}"
    does = "depends" if one.p < SIGNIFICANCE else "does not depend"
    return f"{does} on {one.name} (rank correlation {one.correlation:+.2f}, {_p(one.p)})"


def _p(p: float) -> str:
    return f"p = {p:.2g}" if p >= 1e-4 else "p < 0.0001"


def _known(value: float) -> float | None:
    return value if np.isfinite(value) else None
