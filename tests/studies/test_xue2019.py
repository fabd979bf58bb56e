"""The calibration of Xue et al. (2019) made again on a simulated block: the order of its cases, and what they find."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from jaxgeo.sensor import BrownPhysical
from jaxgeo.studies import xue2019
from jaxgeo.studies.claims import Verdict, resolve
from jaxgeo.studies.xue2019 import printed
from jaxgeo.studies.xue2019.cases import MODELS, adjacent_pairs
from jaxgeo.studies.xue2019.simulation import LENS, boresight_of, interior_of
from jaxgeo.studies.xue2019.trials import NAMES

SMALL = 400.0  # m: 3 strips of 11 images


@pytest.fixture(scope="module")
def report() -> xue2019.Report:
    """A small block and one model, which takes the fewest programs."""
    return xue2019.run(size=SMALL, models=("Bauer",))


@pytest.fixture(scope="module")
def whole() -> xue2019.Report:
    return xue2019.run(trials=100)


def check_order(found: xue2019.Cases) -> None:
    """Each step of the paper gains: control takes the focal length's metres, self-calibration what they leave."""
    height = {case.name: float(case.rms[2]) for case in found.cases}
    for name in ("direct", "direct pair", "free net position", "free net"):
        assert 1.5 < height[name] < 3.3, name  # m
    assert height["direct"] > 8.0 * height["control"]
    plane = {case.name: case.plane for case in found.cases}
    for one in found.recovered:
        if one.model in MODELS:
            assert height[one.model] < 0.6 * height["control"]
            assert plane[one.model] < printed.WITH_CONTROL[0]
            assert height[one.model] < printed.WITH_CONTROL[1]
    for rays in ("", " pair"):
        assert height[f"compensated{rays}"] < height[f"direct{rays}"]
        assert plane[f"compensated{rays}"] < plane[f"direct{rays}"]
    assert height["compensated"] < 0.3 * height["compensated pair"]


def check_recovered(found: xue2019.Cases) -> None:
    """Interior orientation and boresight against the truth, and the two ways to the boresight against each other."""
    true = printed.INTERIORS["Brown"]
    for one in found.recovered:
        if one.model in MODELS:
            assert one.interior.f == pytest.approx(true.f, abs=0.010)  # mm
        off = np.subtract(one.interior, true) / np.maximum(one.sigma_interior, 0.001)
        assert np.abs(off).max() < 4.0
        squares = one.off @ np.linalg.solve(one.covariance, one.off)
        assert squares < 14.2, one.model  # 3 sigma, of three degrees of freedom
        assert np.all(np.abs(one.boresight - printed.BORESIGHT) < 3.0 * one.sigma_boresight), one.model
        assert one.sigma0 == pytest.approx(1.0, abs=0.15)
    once, twice = found.recovered[-2:]
    np.testing.assert_allclose(twice.boresight, once.boresight, rtol=0, atol=0.05)  # minutes of arc
    np.testing.assert_allclose(twice.sigma_boresight, once.sigma_boresight, rtol=0.05)


@pytest.mark.costly
def test_the_block_is_what_the_paper_says() -> None:
    block = xue2019.simulated(SMALL)
    assert (len(block.control), len(block.checks)) == (printed.CONTROL, printed.CHECKS)
    assert interior_of(block.given.camera) == pytest.approx(printed.CALIBRATED, abs=1e-12)
    assert interior_of(block.true.camera) == pytest.approx(printed.INTERIORS["Brown"], abs=1e-12)
    np.testing.assert_allclose(boresight_of(block.true.mount), printed.BORESIGHT, rtol=0, atol=1e-9)
    rays = [int(np.sum(block.observations.point == name)) for name in block.ground.name]
    assert min(rays) >= 6
    in_image = np.unique(block.observations.image, return_counts=True)[1]
    assert len(in_image) == len(block.image)
    assert in_image.min() >= 12


def test_what_is_left_of_the_lens() -> None:
    """A few um, of which the balanced part moves no focal length."""
    lens, f = LENS, printed.INTERIORS["Brown"].f
    half = 0.5 * printed.PIXEL_PITCH / f * np.array([printed.COLUMNS, printed.ROWS])
    middles = (np.arange(200) + 0.5) / 100.0 - 1.0
    x, y = (x.ravel() for x in np.meshgrid(*(side * middles for side in half)))
    r2 = x**2 + y**2
    radial = float(lens.k1) * r2 + float(lens.k2) * r2**2
    assert abs(np.mean(radial * r2)) < 0.01 * np.mean(np.abs(radial) * r2)
    assert 5.0 < 1e3 * f * np.abs(radial * np.sqrt(r2)).max() < 10.0  # um


@pytest.mark.costly
def test_a_seed_gives_the_same_noise_over_the_same_points() -> None:
    flight = xue2019.flown(SMALL)
    first, again, other = (xue2019.measured(flight, seed) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first.observations.uv, again.observations.uv)
    np.testing.assert_array_equal(first.ground.place, again.ground.place)
    np.testing.assert_array_equal(first.observations.point, other.observations.point)
    np.testing.assert_array_equal(first.observations.image, other.observations.image)
    noise = (first.observations.uv - other.observations.uv) / np.sqrt(2.0)
    assert noise.std() == pytest.approx(0.3, rel=0.05)


@pytest.mark.costly
def test_a_pair_is_two_neighbours_of_one_strip() -> None:
    block = xue2019.simulated(SMALL)
    left = adjacent_pairs(block)
    strip = dict(zip(block.image.tolist(), block.strip.tolist(), strict=True))
    order = {name: i for i, name in enumerate(block.image.tolist())}
    for name in block.ground.name.tolist():
        rays = left.of((left.point == name) & (left.sigma[:, 0] < 1.0))
        first, second = sorted(rays.image.tolist(), key=order.__getitem__)
        assert order[second] == order[first] + 1
        assert strip[first] == strip[second]


@pytest.mark.slow
def test_order_of_the_cases(report) -> None:
    check_order(report.cases)


@pytest.mark.slow
def test_calibration_is_recovered(report) -> None:
    check_recovered(report.cases)
    assert report.cases.adjustment.converged


@pytest.mark.slow
def test_tables_show_what_was_found(report, tmp_path) -> None:
    sheets = {sheet.name: sheet for sheet in xue2019.sheets_of(report)}
    assert set(sheets) == {
        *("block", "cases", "pairs", "free_net", "field", "interior", "boresight", "improvement", "mapping", "claims")
    }
    first = sheets["cases"].texts()[0]
    assert first[:5] == ["direct, all rays", "21", "0.444", "0.920", "2.734"]
    assert float(first[7]) == pytest.approx(report.cases.of("direct").rms[2], abs=5e-4)
    assert [row[1] for row in sheets["cases"].texts()].count("12") == 2  # control without parameters, and one model
    printed_row = sheets["improvement"].texts()[0]
    assert (printed_row[4], printed_row[7]) == ("46.38%", "62.49%")
    within = {row[0]: row[-1] for row in sheets["mapping"].texts()}
    assert (within["direct, all rays"], within["control, Bauer"]) == ("no", "yes")
    xue2019.write_tables(report, tmp_path)
    assert {path.stem for path in tmp_path.glob("*.csv")} == set(sheets)
    assert "## Interior orientation (Table 4)" in (tmp_path / "tables.md").read_text()


EQUATIONS = {f"Eq. {number}" for number in range(1, 6)}
TABLES = {"Table 1", "Table 2", "Table 3, control", "Table 3, Bauer", "Table 4, Bauer"}
FIGURES = {f"Fig. {number}" for number in range(1, 13)}


@pytest.mark.slow
def test_claims_are_complete(report) -> None:
    claims = xue2019.claims_of(report)
    assert {one.item for one in claims} >= EQUATIONS | TABLES | FIGURES | {"Abstract", "Section 2.3", "Section 2.5"}
    for one in claims:
        assert one.paper == "Xue 2019"
        if one.function:
            resolve(one.function)
    equations = [one.verdict for one in claims if one.item in EQUATIONS]
    assert equations == [*[Verdict.reproduced] * 3, Verdict.explained, *[Verdict.reproduced] * 2]
    arithmetic = next(one for one in claims if one.statement.startswith("improvement in plan"))
    assert arithmetic.verdict is Verdict.reproduced
    assert arithmetic.obtained == pytest.approx((46.38, 62.49), abs=0.005)


@pytest.mark.slow
def test_pairs_and_noise_come_nearer_to_the_print(report) -> None:
    """Direct georeferencing of pairs, and control with more noise; no free network does."""

    def off(rms: np.ndarray, name: str) -> float:
        return float(np.sqrt(np.mean((rms / np.array(printed.RMS[name]) - 1.0) ** 2)))

    assert off(report.pairs["direct"].mean(axis=0), "direct") < 0.5 * off(report.cases.of("direct").rms, "direct")
    for case in report.field:
        assert off(case.rms, case.name) < 0.7 * off(report.cases.of(case.name).rms, case.name)
    assert min(off(net.rms, "free net") for net in report.free_nets) > 0.3


def test_limits_need_a_source() -> None:
    assert xue2019.Limits(0.3, 0.4, "a standard").hold(0.3, 0.4)
    assert not xue2019.Limits(0.3, 0.4, "a standard").hold(0.31, 0.1)
    assert not xue2019.Limits(0.3, 0.4, "a standard").hold(0.1, 0.41)
    with pytest.raises(ValueError, match="limits need their source"):
        xue2019.Limits(0.3, 0.4, " ")
    for plane, height in ((0.0, 0.4), (0.3, np.inf), (np.nan, 0.4)):
        with pytest.raises(ValueError, match="must be positive and finite"):
            xue2019.Limits(plane, height, "a standard")


@pytest.mark.slow
def test_pictures_are_made(report, tmp_path) -> None:
    trials = xue2019.Trials(
        np.random.default_rng(0).normal(size=(20, 6)), np.tile(np.eye(6), (20, 1, 1)), np.ones(20), 9
    )
    xue2019.write_pictures(dataclasses.replace(report, trials=trials), tmp_path)
    names = {"layout.png", "residuals.png", "parameters.png", "correlations.png", "trials.png"}
    assert {path.name for path in tmp_path.iterdir()} == names


def test_true_covariances_hold_and_others_do_not() -> None:
    errors, covariance = np.random.default_rng(1).normal(size=(100, 6)), np.tile(np.eye(6), (100, 1, 1))
    assert xue2019.Trials(errors, covariance, np.ones(100), 9).holds()
    assert not xue2019.Trials(1.2 * errors, covariance, np.ones(100), 9).holds()


@pytest.mark.slow
def test_the_whole_study(whole) -> None:
    """Six strips of nineteen images, and the three models."""
    assert len(whole.block.image) == 6 * 19
    check_order(whole.cases)
    check_recovered(whole.cases)
    found = {one.model: one.interior.f for one in whole.cases.recovered if one.model in MODELS}
    assert max(found.values()) - min(found.values()) < 0.010  # mm; 0.006 in print
    names = [p.name for p in whole.cases.adjustment.parameters]
    assert not set(names) & set(BrownPhysical.interior)


@pytest.mark.slow
def test_standard_deviations_are_true(whole) -> None:
    """Chi-square of the errors of 100 blocks in the metric of their covariances, at the 1 % level."""
    found = whole.trials
    assert found.errors.shape == (100, len(NAMES))
    low, high = found.bounds(0.01)
    assert low < np.sum(found.squares) < high
    np.testing.assert_allclose(found.normalised.std(axis=0, ddof=1), 1.0, rtol=0, atol=0.21)
    np.testing.assert_allclose(found.normalised.mean(axis=0), 0.0, rtol=0, atol=0.33)
    assert found.sigma0.mean() == pytest.approx(1.0, abs=0.01)
    assert "trials" in {sheet.name for sheet in xue2019.sheets_of(whole)}


@pytest.mark.parametrize("size", [-5.0, 0.0, 100.0, float("nan"), float("inf")])
def test_an_area_has_room_for_strips(size: float) -> None:
    with pytest.raises(ValueError, match=r"the area's size must be 243 m or more, and finite; got"):
        xue2019.run(size=size)


def test_fewer_trials_than_none() -> None:
    with pytest.raises(ValueError, match="trials must be 0 or more; got -3"):
        xue2019.run(trials=-3)
