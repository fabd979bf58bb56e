"""What each extra is for, used once: with the extra it works, without it an error names the extra.

python -m support.extras              their names
python -m support.extras NAME FOLDER  uses one, where only the package and that extra are installed
python -m support.extras --without    tries all of them, where none is
"""

from __future__ import annotations

import importlib
import json
import pathlib
import sys
import tempfile
from collections.abc import Callable
from fractions import Fraction
from typing import NamedTuple

import numpy as np

import jaxgeo
from support.autopilot_logs import AT, dataflash, ulog
from support.klv_packets import local_set, usual
from support.video_files import written_video

CAMERA = {"type": "pinhole", "im_size": [640, 1152], "focal_len": 120.0, "sensor_size": [92.16, 165.888]}
ABOVE_ELLIPSOID = (5, 6, 7, 13, 14, 16, 17, 18, 19, 20, 21, 23, 24, 75, 78)
PLACE = {"filename": "a", "camera": "dmc", "xyz": [299_000.0, 6_271_500.0, 5200.0], "opk": [0.0, 0.0, 0.0]}


class Extra(NamedTuple):
    """The modules that an extra installs and jaxgeo imports, and its uses, which take an empty folder."""

    modules: tuple[str, ...]
    uses: tuple[Callable[[pathlib.Path], None], ...]


def picture(folder: pathlib.Path) -> None:
    """A shaded relief."""
    ax = jaxgeo.plot.hillshade(jaxgeo.io.example_dem())
    ax.figure.savefig(folder / "relief.png")
    assert (folder / "relief.png").read_bytes().startswith(b"\x89PNG")


def page(folder: pathlib.Path) -> None:
    """A report of the demonstration's scene."""
    from jaxgeo.cli import app

    importlib.import_module("jaxgeo.report")  # at once, before any computation

    output = folder / "page.html"
    scene = ["--scene", example("demo_scene.toml"), "--dem", example("jacksboro.tif"), "--dem-datum", "EPSG:5773"]
    app(["report", *scene, "--details", "0", "-o", str(output)], standalone_mode=False)
    assert "</html>" in output.read_text(encoding="utf-8")


def parquet(folder: pathlib.Path) -> None:
    """Fixes as GeoParquet."""
    jaxgeo.io.write_fixes(folder / "fixes.parquet", a_fix())
    assert (folder / "fixes.parquet").read_bytes().startswith(b"PAR1")


def geopackage(folder: pathlib.Path) -> None:
    """Fixes as a GeoPackage."""
    jaxgeo.io.write_fixes(folder / "fixes.gpkg", a_fix())
    assert (folder / "fixes.gpkg").read_bytes().startswith(b"SQLite format 3")


def squares(folder: pathlib.Path) -> None:
    """The squares that fixes lie in."""
    jaxgeo.io.write_fixes(folder / "fixes.csv", a_fix(), mgrs=True)
    assert "32TPT5204907105" in (folder / "fixes.csv").read_text(encoding="utf-8")


def interior_parameters(folder: pathlib.Path) -> None:
    """A block of Orthority's."""
    from jaxgeo.io.acquisitions.orthority import read_orthority

    interior, exterior = folder / "int_param.yaml", folder / "ext_param.geojson"
    interior.write_text(f"dmc: {json.dumps(CAMERA)}\n", encoding="utf-8")
    point = {"type": "Point", "coordinates": [24.4, -33.7, 5200.0]}
    feature = {"type": "Feature", "properties": PLACE, "geometry": point}
    content = {"type": "FeatureCollection", "world_crs": "EPSG:32734", "features": [feature]}
    exterior.write_text(json.dumps(content), encoding="utf-8")
    found = read_orthority(interior, exterior, height_datum="ellipsoid")
    assert found.names.tolist() == ["a"]


def telemetry(folder: pathlib.Path) -> None:
    """Packets in a transport stream."""
    from jaxgeo.io.acquisitions.telemetry import read_telemetry

    path = folder / "flight.ts"
    packets = [local_set(usual(*ABOVE_ELLIPSOID)) for _ in range(3)]
    try:
        import av
    except ImportError:  # enough to be detected as a transport stream
        path.write_bytes((b"\x47" + bytes(187)) * 20)
    else:
        with av.open(str(path), "w", format="mpegts") as container:
            stream = container.add_data_stream("klv")
            for k, content in enumerate(packets):
                packet = av.Packet(content)
                packet.stream, packet.time_base, packet.pts, packet.dts = stream, Fraction(1, 25), k, k
                container.mux(packet)
    assert len(read_telemetry(path, image_size=(640, 480)).names) == 3


def captions(folder: pathlib.Path) -> None:
    """A video with subtitles."""
    words = "[latitude: 36.3] [longitude: -84.2] [abs_alt: 900.0] [gb_yaw: 30.0 gb_pitch: -60.0 gb_roll: 0.0]"
    (folder / "a.mp4").write_bytes(written_video([(0.0, words)]))
    assert len(jaxgeo.io.read_acquisition(folder / "a.mp4", height_datum=0.0)) == 1


def dataset(folder: pathlib.Path) -> None:
    """A map of accuracy."""
    from jaxgeo.uncertainty import Accuracy, AccuracyMap
    from jaxgeo.uncertainty.method_selection import Diagnostics

    fix = a_fix()
    number = np.ones(1)
    method, diagnostics = np.zeros(1, np.int8), Diagnostics(*[1.0] * len(Diagnostics._fields))
    cov, bias = np.zeros((1, 3, 3)), np.zeros((1, 3))
    each = Accuracy(fix, *[number] * 4, method, cov, bias, number, diagnostics)
    found = AccuracyMap(each, fix.position, np.zeros((1, 2)))
    told = jaxgeo.io.accuracy_map_dataset(found)
    assert told["circular_error"].attrs["units"] == "m"


def scheduler(_: pathlib.Path) -> None:
    """Where the scheduler of a cluster is."""
    from jaxgeo.cluster import connect

    try:
        with connect("no scheduler.json"):
            raise AssertionError("there is no such file")
    except FileNotFoundError:
        pass


def search(folder: pathlib.Path) -> None:
    """Tiles of a STAC collection: asked for at an address where no server is."""
    from jaxgeo.io.archives import ArchiveError, DemCache, fetch_dem

    try:
        fetch_dem("stac:http://127.0.0.1:9/collections/a", bounds=(5.0, 5.0, 5.1, 5.1), cache=DemCache(folder))
        raise AssertionError("there is no server")
    except ArchiveError:
        pass


def dataflash_log(folder: pathlib.Path) -> None:
    """A photo in a log of ArduPilot."""
    (folder / "a.bin").write_bytes(dataflash([AT]))
    assert len(jaxgeo.io.read_acquisition(folder / "a.bin", takeoff_height=0.0)) == 1


def px4_log(folder: pathlib.Path) -> None:
    """A photo in a log of PX4."""
    (folder / "a.ulg").write_bytes(ulog([[1.0, 0.0, 0.0, 0.0]]))
    assert len(jaxgeo.io.read_acquisition(folder / "a.ulg", height_datum=0.0)) == 1


def names_of_classes(folder: pathlib.Path) -> None:
    """A detection whose class is named in the data.yaml beside it."""
    from jaxgeo.io.detections import read_detections

    (folder / "data.yaml").write_text("names: [car]\n")
    (folder / "a.txt").write_text("0 0.5 0.5 0.1 0.1\n")
    assert read_detections(folder)[0].attributes["label"] == "car"


def keypoints(_: pathlib.Path) -> None:
    """Keypoints of SIFT and ORB."""
    import scipy

    from jaxgeo.ties import OrbFeatures, SiftFeatures

    squares = np.random.default_rng(0).normal(size=(160, 160)).repeat(4, axis=0).repeat(4, axis=1)
    grey = scipy.ndimage.gaussian_filter(squares, 2.0).astype(np.float32)
    for features in (SiftFeatures(), OrbFeatures()):
        assert len(features.find(grey, np.ones(grey.shape, bool)).uv) > 50


EXTRAS = {
    "cluster": Extra(
        ("bokeh", "dask", "distributed", "jinja2", "mgrs", "pyarrow", "pyogrio", "yaml"),
        (scheduler,),
    ),
    "features": Extra(("cv2",), (keypoints,)),
    "plot": Extra(("matplotlib",), (picture,)),
    "report": Extra(("bokeh", "jinja2", "matplotlib"), (page,)),
    "gis": Extra(("mgrs", "pyarrow", "pyogrio"), (geopackage, parquet, squares)),
    "logs": Extra(("pymavlink", "pyulog"), (dataflash_log, px4_log)),
    "orthority": Extra(("yaml",), (interior_parameters,)),
    "stac": Extra(("pystac", "pystac_client", "requests"), (search,)),
    "video": Extra(("av",), (telemetry, captions)),
    "xarray": Extra(("xarray",), (dataset,)),
    "yolo": Extra(("yaml",), (names_of_classes,)),
}


def a_fix() -> jaxgeo.Fix:
    """One fix in the Alps."""
    from support.made_fixes import ALPS, made

    return made(ALPS[:1])


def example(name: str) -> str:
    """A file of the package's data."""
    return str(pathlib.Path(jaxgeo.__file__).parent / "data" / name)


def tell_without() -> None:
    """Check that functions that need an extra raise an error that names it, with none installed."""
    for name, extra in EXTRAS.items():
        for use in extra.uses:
            with tempfile.TemporaryDirectory() as folder:
                try:
                    use(pathlib.Path(folder))
                except ImportError as error:
                    if f"pip install 'jaxgeo[{name}]'" not in str(error):
                        sys.exit(f"{use.__name__}: it does not name jaxgeo[{name}]: {error}")
                    print(f"  {use.__name__}: {error}")
                else:
                    sys.exit(f"{use.__name__}: {use.__doc__} It works without jaxgeo[{name}].")


if __name__ == "__main__":
    jaxgeo.enable_x64()
    match sys.argv[1:]:
        case []:
            print(*EXTRAS)
        case ["--without"]:
            tell_without()
        case [name, folder]:
            for use in EXTRAS[name].uses:
                use(pathlib.Path(folder))
                print(f"  {use.__name__}: {use.__doc__}")
