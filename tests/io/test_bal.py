"""Problems of bundle adjustment in the large: the published cost, the formula, and files that are cut or wrong.

Held against: a problem of Bundle Adjustment in the Large as it is published, its cost as Ceres Solver prints it, and
the formula of the camera written out with SciPy's rotations.
"""

from __future__ import annotations

import dataclasses
import pathlib

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxgeo.io import BalProblem, TableError, read_bal, write_bal


@pytest.fixture
def problem() -> BalProblem:
    """Two cameras, one of them not turned at all, three points and five observations."""
    rng = np.random.default_rng(5)
    return BalProblem(
        rotation=np.array([[0.0, 0.0, 0.0], [0.1, -0.2, 0.05]]),
        translation=rng.normal(size=(2, 3)),
        focal_px=np.array([400.0, 512.5]),
        k1=np.array([-1e-3, 0.0]),
        k2=np.array([2e-7, 1e-13]),
        points=rng.uniform([-1.0, -1.0, -12.0], [1.0, 1.0, -8.0], (3, 3)),
        image_index=np.array([0, 1, 0, 1, 1]),
        point_index=np.array([0, 0, 2, 2, 1]),
        uv=rng.normal(scale=100.0, size=(5, 2)),
    )


def test_the_cost_that_is_published(jaxgeo_test_data: pathlib.Path) -> None:
    problem = read_bal(jaxgeo_test_data / "bal" / "problem-16-22106-pre.txt.bz2")
    assert (len(problem.rotation), len(problem.points), len(problem.uv)) == (16, 22106, 83718)
    assert f"{problem.cost():.6e}" == "4.185660e+06"


def test_the_formula(problem: BalProblem) -> None:
    residuals = problem.residuals()
    for k, (i, j) in enumerate(zip(problem.image_index, problem.point_index, strict=True)):
        P = Rotation.from_rotvec(problem.rotation[i]).apply(problem.points[j]) + problem.translation[i]
        p = -P[:2] / P[2]
        r2 = p @ p
        expected = problem.focal_px[i] * (1.0 + problem.k1[i] * r2 + problem.k2[i] * r2**2) * p
        np.testing.assert_allclose(residuals[k], expected - problem.uv[k], atol=1e-10)  # px
    assert problem.cost() == pytest.approx(0.5 * np.sum(residuals**2))


@pytest.mark.parametrize("name", ["problem.txt", "problem.txt.bz2"])
def test_what_is_written_reads_back(tmp_path: pathlib.Path, problem: BalProblem, name: str) -> None:
    write_bal(tmp_path / name, problem)
    back = read_bal(tmp_path / name)
    for field in dataclasses.fields(problem):
        np.testing.assert_array_equal(getattr(back, field.name), getattr(problem, field.name))
    assert ((tmp_path / name).read_bytes()[:3] == b"BZh") == name.endswith("bz2")


def changed(lines: list[str], row: int, line: str) -> list[str]:
    return [*lines[: row - 1], line, *lines[row:]]


REFUSED = {
    "no header": (lambda lines: lines[1:], "row 1: '0 0 .* are not the numbers of cameras"),
    "no cameras": (lambda lines: changed(lines, 1, "0 3 5"), "row 1: '0 3 5' are not"),
    "empty": (lambda lines: [], "row 1: '' are not the numbers of cameras"),
    "cut": (lambda lines: lines[:-2], "45 numbers below .* are 47; the file ends too early"),
    "too long": (lambda lines: [*lines, "1.0"], "48 numbers below .* are 47; there is more in the file"),
    "word": (lambda lines: changed(lines, 3, "1 0 12.5 1.2.3"), r"row 3: '1\.2\.3' is not a number"),
    "nan": (lambda lines: changed(lines, 9, "nan"), "row 9: 'nan' is not a number"),
    "infinite": (lambda lines: changed(lines, 9, "inf"), "row 9: 'inf' is not a number"),
    "camera": (lambda lines: changed(lines, 3, "2 0 12.5 1.0"), "observation 1: camera 2 is none of 0 to 1"),
    "point": (lambda lines: changed(lines, 4, "0 -1 12.5 1.0"), "observation 2: point -1 is none of 0 to 2"),
    "half": (lambda lines: changed(lines, 4, "0 1.5 12.5 1.0"), "observation 2: point 1.5 is none of 0 to 2"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_wrong_files(tmp_path: pathlib.Path, problem: BalProblem, case: str) -> None:
    change, words = REFUSED[case]
    path = tmp_path / "problem.txt"
    write_bal(path, problem)
    path.write_text("\n".join(change(path.read_text().splitlines())))
    with pytest.raises(TableError, match=f"problem.txt.*{words}"):
        read_bal(path)


def test_files_that_cannot_be_read(tmp_path: pathlib.Path, problem: BalProblem) -> None:
    with pytest.raises(FileNotFoundError, match="there is no such problem"):
        read_bal(tmp_path / "nowhere.txt")
    path = tmp_path / "problem.txt.bz2"
    write_bal(path, problem)
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(TableError, match=r"problem\.txt\.bz2: the problem cannot be read"):
        read_bal(path)
    path.write_text("2 3 5\n")
    with pytest.raises(TableError, match=r"problem\.txt\.bz2: the problem cannot be read"):
        read_bal(path)
