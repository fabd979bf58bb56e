"""Command examples shown in the help; the tests run them all."""

from __future__ import annotations

SCENE = "--scene scene.toml --dem dem.tif"
EXAMPLES = {
    "inspect": (
        "jaxgeo inspect DJI_0042.JPG",
        "jaxgeo inspect flight.klv --output shots.csv",
        "jaxgeo inspect mission.sbet --json",
    ),
    "locate": (
        "jaxgeo locate DJI_0042.JPG --camera-datum ellipsoid --dem dem.tif --pixel 2000,1500",
        "jaxgeo locate DJI_0042.JPG --camera-datum ellipsoid --dem copernicus",
        "jaxgeo locate flight.klv --ground reported -o fixes.kml",
        f"jaxgeo locate {SCENE} --shots shots.csv -o fixes.csv",
        "jaxgeo locate images --camera-datum ellipsoid --dem dem.tif --detections labels --class-names data.yaml "
        "-o found.geojson",
    ),
    "report": (
        f"jaxgeo report {SCENE} --pixel 1200,2400 -o report.html",
        "jaxgeo report DJI_0042.JPG --camera-datum ellipsoid --dem dem.tif -o report.html",
        "jaxgeo report flight.klv --ground reported --details 1 -o report.html",
    ),
    "view": (
        "jaxgeo view DJI_0042.JPG --camera-datum ellipsoid --dem dem.tif",
        "jaxgeo view images --camera-datum ellipsoid --dem copernicus",
        "jaxgeo view reconstruction.json --images images --camera-datum ellipsoid --dem dem.tif",
        "jaxgeo view flight.klv --ground reported --no-browser --port 8765",
    ),
    "accuracy-map": (
        f"jaxgeo accuracy-map {SCENE} --resolution 200 -o accuracy.tif",
        "jaxgeo accuracy-map DJI_0042.JPG --camera-datum ellipsoid --dem dem.tif --resolution 2 -o accuracy.tif",
    ),
    "validate": (
        "jaxgeo validate images --points gcp_list.txt --points-datum ellipsoid --camera-datum ellipsoid --dem dem.tif",
        "jaxgeo validate images --points points.csv --points-datum ellipsoid --camera-datum ellipsoid --dem dem.tif "
        "--calibrate errors.toml -o validation.png",
    ),
    "footprint": (
        f"jaxgeo footprint {SCENE}",
        f"jaxgeo footprint {SCENE} --shots shots.csv -o footprints.gpkg --crs EPSG:32616",
    ),
    "point": (
        f"jaxgeo point {SCENE} --target 36.31,-84.25",
        "jaxgeo point --scene scene.toml --line-of-sight 250,18.5",
        "jaxgeo point --scene scene.toml --position 36.318,-84.105,5500 --attitude 160 --target 36.31,-84.25,900",
    ),
    "overlap": (
        f"jaxgeo overlap {SCENE} --navigation flight.csv --times 101,103,107",
        f"jaxgeo overlap {SCENE} --shots shots.csv -o overlaps.csv",
        f"jaxgeo overlap {SCENE} --shots strips.csv --strips",
    ),
    "plan": (
        f"jaxgeo plan {SCENE} --navigation flight.csv --overlap 0.15 -o exposures.csv",
        f"jaxgeo plan {SCENE} --navigation flight.csv --timing fixed:2.5 -o exposures.csv",
        f"jaxgeo plan {SCENE} --navigation flight.csv --overlap 0.6 --side-overlap 0.3 -o exposures.csv",
    ),
    "rectify": (
        f"jaxgeo rectify image.tif {SCENE} -o ortho.tif",
        f"jaxgeo rectify image.tif {SCENE} --crs EPSG:32616 --resolution 5 --cog -o ortho.tif",
        "jaxgeo rectify DJI_0042.JPG --camera-datum ellipsoid --dem dem.tif --resolution 0.5 -o ortho.tif",
    ),
    "register": (
        f"jaxgeo register image.tif --reference ortho.tif {SCENE} --position-sigma 20 --attitude-sigma 0.3 "
        "-o registered",
    ),
    "adjust": (
        "jaxgeo adjust images --camera-datum ellipsoid --dem dem.tif -o adjusted",
        "jaxgeo adjust images --camera-datum ellipsoid --dem dem.tif --no-self-calibrate -o adjusted",
        "jaxgeo adjust images --camera-datum ellipsoid --dem dem.tif --measure orientation -o adjusted",
        "jaxgeo adjust images --camera-datum ellipsoid --dem dem.tif --features sift -o adjusted",
        "jaxgeo adjust images --camera-datum ellipsoid --dem dem.tif --reference map.tif -o adjusted",
        "jaxgeo adjust images --camera-datum ellipsoid --dem dem.tif --shots-by name --flights-by 20min -o adjusted",
        "jaxgeo adjust images --camera-datum ellipsoid --dem dem.tif --gcp gcp_list.txt --gcp-datum EPSG:5773 "
        "-o adjusted",
        "jaxgeo adjust images --camera-datum ellipsoid --dem dem.tif --readout 0.03 --time-offset-sigma 0.05 "
        "-o adjusted",
        "jaxgeo adjust images --camera-datum ellipsoid --dem dem.tif --report --mosaic mosaic.tif -o adjusted",
    ),
    "dem": (
        "jaxgeo dem 36.31,-84.25 --radius 2000 -o ground.tif",
        "jaxgeo dem --for DJI_0042.JPG --camera-datum ellipsoid",
        "jaxgeo dem",
    ),
    "scene": (
        "jaxgeo scene DJI_0042.JPG --camera-datum ellipsoid -o scene.toml",
        "jaxgeo scene flight.klv --exposure 1 -o scene.toml",
    ),
    "demo": ("jaxgeo demo", "jaxgeo demo --write-scene scene.toml --write-dem dem.tif"),
    "doctor": ("jaxgeo doctor",),
    "li2020": ("jaxgeo study li2020 -o tables",),
    "li2023": ("jaxgeo study li2023 --samples 5000",),
    "xue2019": ("jaxgeo study xue2019 --trials 20 -o tables",),
    "gu2017": ("jaxgeo study gu2017 -o tables",),
    "all": ("jaxgeo study all -o studies",),
}


def examples_of(command: str) -> str:
    """Epilog of a command's help."""
    return "\n".join(["[bold]Examples[/bold]", *(f"$ {line}" for line in EXAMPLES[command])])
