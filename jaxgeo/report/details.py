"""Details of selected fixes: section under the line of sight, samples that check the accuracy, error budget."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo._compile import batch_filter_jit
from jaxgeo._locate import locate
from jaxgeo.coverage.exposure import image_size
from jaxgeo.earth import WGS84
from jaxgeo.earth.ray import Ray
from jaxgeo.plot.sightline import Section, section_under
from jaxgeo.report.data import ReportData
from jaxgeo.status import Status
from jaxgeo.terrain import ConstantHeight, Dem
from jaxgeo.uncertainty import AccuracyCheck, Budget, ErrorModel, Region, Sampled, Sampling, budget, check_accuracy
from jaxgeo.uncertainty.model_inputs import of_arrays

SAMPLES = 20_000  # same number and key as in `accuracy`, hence the same samples
ON_A_SIDE = 24  # points per image edge located on the ground
LEVEL_SAMPLES = 512
BEHIND = 1.06  # section length, times the slant range


class Detail(NamedTuple):
    """Details of one pixel; missing parts are None, `unsure` is the reason why there is no accuracy.

    `chosen` is the reason why it is shown, if not all are. `outline` (m, 2) is the footprint outline, longitude and
    latitude in deg, NaN where no ground is seen. `region` is the highest-density region of the samples at the
    probability of the report, `no_region` the reason why samples have none.
    """

    index: int
    chosen: str
    section: Section | None
    outline: np.ndarray
    checked: AccuracyCheck | None = None
    budget: Budget | None = None
    unsure: str = ""
    region: Region | None = None
    no_region: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and strings."""
        content: dict[str, Any] = {"index": self.index}
        content |= {"budget": None if self.budget is None else self.budget.to_dict()}
        if self.checked is None:
            return content | {"samples": None, "because": self.unsure, "region": None}
        one = self.checked
        shares = {"within": one.within._asdict(), "jumped": one.jumped, "failed": one.sampled.failed}
        region = {"because": self.no_region} if self.region is None else region_numbers(self.region)
        return content | {"samples": {"count": one.sampled.count, **shares}, "region": region}


def details_of(subject: ReportData, *, most: int = 3) -> list[Detail]:
    """Details of up to `most` pixels: of all, if no more, else median, largest and smallest CE90 first.

    Raises `ValueError` for a negative `most`.
    """
    if most < 0:
        raise ValueError(f"most must be a number of pixels, 0 or more; got {most!r}.")
    outlines: dict[bytes, np.ndarray] = {}
    return [_detail(subject, index, why, outlines) for index, why in chosen(subject, most)]


def chosen(subject: ReportData, most: int) -> list[tuple[int, str]]:
    """(index, reason) of the pixels shown in detail."""
    if len(subject) <= most:
        return [(index, "") for index in range(len(subject))]
    found = np.flatnonzero(subject.is_fix)
    if not most:
        return []
    if not found.size:
        return [(0, "first pixel")]
    if subject.accuracy is None:
        return [(int(index), "first fixes") for index in found[:most]]
    radii = np.asarray(subject.accuracy.circular)[found]
    order = found[np.argsort(np.nan_to_num(radii, nan=math.inf), kind="stable")]
    picks = [(len(order) // 2, "median CE90"), (len(order) - 1, "largest CE90"), (0, "smallest CE90")]
    places = [*picks, *((k, "further fix") for k in np.linspace(0, len(order) - 1, most + 2).astype(int)[1:-1])]
    unique = {int(order[place]): why for place, why in reversed(places)}
    chosen = [(index, unique[index]) for index in dict.fromkeys(int(order[place]) for place, _ in places)]
    return chosen[:most]


def _detail(subject: ReportData, index: int, why: str, outlines: dict[bytes, np.ndarray]) -> Detail:
    sensor, shot, uv, terrain, errors = subject.look(index)
    ray = Ray(*sensor.ray_ecef(shot, jnp.asarray(uv))[:2])
    key = b"".join(np.asarray(leaf).tobytes() for leaf in jax.tree.leaves((sensor, shot)))
    if key not in outlines:
        outlines[key] = _outline(sensor, shot, terrain, subject.atmosphere)
    detail = Detail(index, why, _section(subject, index, ray, terrain), outlines[key])
    if not subject.is_fix[index]:
        return detail._replace(unsure=Status(int(np.asarray(subject.fixes.status)[index])).message)
    if errors is None or subject.accuracy is None:
        return detail._replace(unsure="No error sources are given.")
    model = errors if isinstance(errors, ErrorModel) else ErrorModel(tuple(errors))
    options: dict[str, Any] = {"sampling": Sampling(count=SAMPLES), "atmosphere": subject.atmosphere}
    checked = check_accuracy(sensor, shot, uv, terrain, model, probability=subject.probability, **options)
    region, no_region = region_of(checked.sampled, subject.probability)
    detail = detail._replace(checked=checked, region=region, no_region=no_region)
    linear = checked.accuracy.propagation
    if linear is None or not np.isfinite(np.asarray(linear.cov_enu)).all():
        return detail._replace(unsure="The ground slope is undefined here, so errors cannot be propagated.")
    return detail._replace(budget=budget(checked.accuracy))


def region_of(sampled: Sampled, probability: float) -> tuple[Region | None, str]:
    """(highest-density region of samples, or None; the reason why there is none)."""
    try:
        return sampled.region(probability), ""
    except ValueError as error:  # too few samples with ground, or a region about a pole
        reason = str(error)
        return None, reason[:1].upper() + reason[1:]


def region_numbers(region: Region) -> dict[str, Any]:
    """Plain numbers and strings of a region and its pieces."""
    pieces = [
        {
            "share": mode.share._asdict(),
            "area_m2": mode.area,
            "distance_m": mode.distance,
            "azimuth_deg": math.degrees(mode.azimuth),
            "rise_m": mode.rise,
            "words": mode.words,
        }
        for mode in region.modes
    ]
    shares = {"inside": region.inside._asdict(), "without_ground": region.without_ground._asdict()}
    return {
        "probability": region.probability,
        "area_m2": region.area,
        **shares,
        "words": region.words,
        "pieces": pieces,
    }


def _section(subject: ReportData, index: int, ray: Ray, terrain: Any) -> Section | None:
    """The section under a line of sight; None if it cannot be drawn."""
    if not all(np.isfinite(np.asarray(x)).all() for x in (ray.origin, ray.direction)):
        return None
    if isinstance(terrain, Dem):
        try:
            return section_under(ray, terrain, atmosphere=subject.atmosphere)
        except ValueError:  # vertical line, or never over the terrain
            return None
    if not isinstance(terrain, ConstantHeight):
        return None  # neither level nor gridded
    return _level_section(subject, index, ray.through(subject.atmosphere))


def _level_section(subject: ReportData, index: int, ray: Ray) -> Section | None:
    """The section over level ground, to a little beyond the fix."""
    fix = subject.fix(index)
    if not math.isfinite(float(fix.slant_range)):
        return None
    along = np.linspace(0.0, BEHIND * float(fix.slant_range), LEVEL_SAMPLES)
    feet, sight = (np.asarray(x) for x in _feet(ray, jnp.asarray(along)))
    distance = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(feet, axis=0), axis=1))])
    if distance[-1] < 1e-3 * along[-1]:
        return None
    height = float(fix.position.height)
    first = float(np.interp(float(fix.slant_range), along, distance))
    slope = (sight[1] - sight[0]) / max(distance[1], 1e-9)
    ground, void = np.full(len(along), height), np.zeros(len(along), bool)
    status = Status(int(fix.status))
    return Section(distance, sight, ground, sight[0] + slope * distance, void, np.array([[first, height]]), status)


@eqx.filter_jit
def _feet(ray: Ray, along: jax.Array) -> tuple[jax.Array, jax.Array]:
    """(foot point on the ellipsoid in ECEF, height) in m at ranges along a ray."""

    def one(distance: jax.Array) -> tuple[jax.Array, jax.Array]:
        p_ecef = ray.at(distance)
        normal, height = WGS84.normal_and_height(p_ecef)
        return p_ecef - height * normal, height

    return jax.vmap(one)(along)


def _outline(sensor: Any, shot: Any, terrain: Any, atmosphere: Any) -> np.ndarray:
    """Closed footprint outline (m, 2), longitude and latitude in deg; NaN where no ground is seen."""
    width, height = image_size(sensor)
    corners = np.array([[-0.5, -0.5], [width - 0.5, -0.5], [width - 0.5, height - 0.5], [-0.5, height - 0.5]])
    steps = np.linspace(0.0, 1.0, ON_A_SIDE, endpoint=False)[:, None]
    uv = np.concatenate([a + steps * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])
    seen = _seen(sensor, shot, jnp.asarray(uv), of_arrays(terrain), atmosphere)
    lat, lon = (np.rad2deg(x) for x in seen)
    ring = np.stack([lon, lat], axis=-1)
    return np.concatenate([ring, ring[:1]])


@batch_filter_jit
def _seen(sensor: Any, shot: Any, uv: jax.Array, terrain: Any, atmosphere: Any) -> tuple[jax.Array, jax.Array]:
    def one(pixel: jax.Array) -> tuple[jax.Array, jax.Array]:
        fix = locate(sensor, shot, pixel, terrain, atmosphere=atmosphere)
        known = fix.found & (fix.status != Status.hits_void)
        lat, lon = jnp.asarray(fix.position.lat), jnp.asarray(fix.position.lon)
        return jnp.where(known, lat, jnp.nan), jnp.where(known, lon, jnp.nan)

    return jax.vmap(one)(uv)
