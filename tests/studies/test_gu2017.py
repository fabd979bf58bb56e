"""The registration of Gu and Qiao (2017) made again: its table, an image end to end, searches, blocks, frames."""

from __future__ import annotations

import pathlib

import numpy as np
import pytest
from typer.testing import CliRunner

from jaxgeo.cli import app
from jaxgeo.io import example_dem
from jaxgeo.studies import gu2017
from jaxgeo.studies.gu2017 import printed, scene, sheets
from jaxgeo.studies.gu2017.density import Dense
from jaxgeo.studies.gu2017.fixes import Fixes
from jaxgeo.studies.gu2017.frames import FRAMES
from jaxgeo.studies.gu2017.searching import CHOICES

NAMES = ("errors", "sensitivity", "slopes", "circles", "flow", "searches", "blocks", "ties", "frames")
TABLE = [(139.0, 19.6), (1334.0, 19.6), (2667.0, 19.7), (2668.0, 78.4), (2669.0, 117.8)]


@pytest.fixture(scope="module")
def report() -> gu2017.Report:
    return gu2017.run()


def test_circles_about_a_long_ellipse() -> None:
    found = gu2017.radii()
    assert found.exact == pytest.approx(462.5, abs=0.05)
    assert found.rounded == pytest.approx(434.3, abs=0.05)
    assert found.rounded_holds == pytest.approx(0.877, abs=5e-4)
    assert found.round_factor == pytest.approx(2.146, abs=5e-4)
    assert gu2017.within(found.round_factor) == pytest.approx(0.9, abs=1e-12)
    assert gu2017.within(printed.SEARCHED) == pytest.approx(0.9889, abs=5e-5)


def test_spread_of_errors_drawn_from_their_covariance() -> None:
    rng, count = np.random.default_rng(4), 4000
    root = np.array([[30.0, 0.0], [20.0, 7.0]])
    ecef = np.zeros((count, 3))
    ecef[:, :2] = rng.normal(size=(count, 2)) @ root.T
    cov = np.broadcast_to(root @ root.T, (count, 2, 2))
    fixes = Fixes(ecef, cov, np.broadcast_to(np.eye(3), (count, 3, 3)))
    found = gu2017.spread(fixes, np.zeros((count, 3)))
    assert found.squares == pytest.approx(1.0, abs=0.08)
    assert found.rms == pytest.approx(found.sigma, rel=0.06)
    assert found.ce90 == pytest.approx(found.foretold90, rel=0.06)
    unknown = gu2017.spread(fixes, None)
    assert (unknown.rms, unknown.ce90, unknown.squares) == (None, None, None)
    assert unknown.sigma == pytest.approx(found.sigma)


def test_an_elevation_model_errs_as_is_told() -> None:
    ground = example_dem()
    error = np.asarray(scene.erring(ground, 1).posts) - np.asarray(ground.posts)
    assert error.std() == pytest.approx(scene.SIGMA_TERRAIN, rel=1e-3)
    again = np.asarray(scene.erring(ground, 1).posts) - np.asarray(ground.posts)
    np.testing.assert_array_equal(error, again)
    away = round(8.0 * scene.ALIKE / 90.0)
    correlation = [np.mean(error[:, k:] * error[:, : error.shape[1] - k]) / error.var() for k in (1, away)]
    assert correlation[0] > 0.7
    assert abs(correlation[1]) < 0.1


def test_what_is_not_known_is_a_dash() -> None:
    """Of a real image there is no truth, and of blocks none may have been updated."""
    spread = gu2017.Spread(None, None, 12.0, 20.0, None, 2)
    sheet = sheets.blocks_sheet([Dense(100, 3, 16.0, 9.0, 1.5, spread)])
    assert sheet.texts() == [["100", "3", "16.0", "9.0", "1.50", "–", "12.00", "–", "20.00", "–", "2"]]


def test_only_what_was_made_can_be_made_again() -> None:
    terrain = example_dem()
    shot = scene.looking_at(scene.target_on(terrain), off_nadir=45.0, azimuth=0.0, above=5000.0)
    reference = scene.textured(terrain, scene.target_on(terrain), (32, 32), 100.0)
    image = np.zeros((scene.HEIGHT, scene.WIDTH))
    errors = scene.TieErrors(registration=1.0, terrain=5.0)
    im = gu2017.Imaged(
        scene.camera(), shot, image, np.ones(image.shape, bool), reference, terrain, gu2017.navigation(), errors
    )
    with pytest.raises(ValueError, match="only an image that was made can be made again"):
        scene.seen_again(im, 1)
    assert gu2017.truth(im) is None
    assert gu2017.searches(im) == []
    assert gu2017.frames(im) == []


def test_a_real_image_needs_all_that_it_lies_on(tmp_path: pathlib.Path) -> None:
    result = CliRunner().invoke(app, ["study", "gu2017", "--image", str(tmp_path / "image.tif")])
    assert result.exit_code == 2
    assert "needs --reference, --dem, --scene as well" in " ".join(result.output.split())


@pytest.mark.slow
def test_the_table_of_errors(report) -> None:
    rows = report.accuracy.table
    for row, figures in zip(rows, TABLE, strict=True):
        np.testing.assert_allclose(row.rms, figures, rtol=0.05)
    cells = {sheet.name: sheet for sheet in gu2017.sheets_of(report)}["errors"].texts()
    assert [row[-1] for row in cells] == ["yes, no", "yes, no", "yes, yes", "yes, no", "no, no"]
    full, level = report.accuracy.on_slopes[0.0]
    assert level == pytest.approx(full, rel=1e-3)


@pytest.mark.slow
def test_an_image_from_end_to_end(report) -> None:
    for run in report.flow.runs:
        assert run.registration.accepted
        assert run.after.ce90 < 0.2 * run.before.ce90
        assert 0.2 < run.after.squares < 2.0
        assert run.after.ce90 == pytest.approx(run.after.foretold90, rel=0.5)


@pytest.mark.slow
def test_the_search_that_the_navigation_allows(report) -> None:
    """It compares fewer cells, no block's match is the worse for it, and what the pose chooses is right."""
    for near, whole in zip(report.searches[::2], report.searches[1::2], strict=True):
        assert whole.cells > 5 * near.cells
        assert near.best_wrong <= whole.best_wrong
        for one in (near, whole):
            assert set(one.chosen) == set(CHOICES)
            number, wrong = one.chosen["pose"]
            assert wrong <= 0.1 * number


@pytest.mark.slow
def test_blocks_ties_and_frames(report) -> None:
    for one in (*report.by_size, *report.by_ties):
        assert 0.1 < one.spread.squares < 2.5
    foretold = [one.spread.foretold90 for one in report.by_ties]
    assert np.all(np.diff(foretold) < 0.0)
    alone, carried, seldom = (report.frames[k : k + FRAMES] for k in range(0, 3 * FRAMES, FRAMES))
    assert carried[0].sigma_position == pytest.approx(alone[0].sigma_position)
    for one, other in zip(carried[1:], alone[1:], strict=True):
        assert one.sigma_position < other.sigma_position
    for one in seldom:
        assert one.registered == (one.number % 3 == 1)


@pytest.mark.slow
def test_tables_and_pictures(report, tmp_path) -> None:
    gu2017.write_tables(report, tmp_path)
    assert {path.stem for path in tmp_path.glob("*.csv")} == set(NAMES)
    for sheet in gu2017.sheets_of(report):
        assert all(len(row) == len(sheet.columns) for row in sheet.rows)
    gu2017.write_pictures(report, tmp_path)
    names = {"images", "boards", "circles", "shifts", "blocks", "frames"}
    assert {path.stem for path in tmp_path.glob("*.png")} == names
