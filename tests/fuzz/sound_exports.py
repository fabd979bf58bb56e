"""Sound files as other programs export them: for `readers`."""

from __future__ import annotations

import json

PROGRAMS = (  # as Pix4D, Metashape (twice), RealityCapture and MicMac export them
    "imageName X Y Z Omega Phi Kappa\na.JPG 751000.12 4020000.34 900.5 30.0 20.0 0.0\n",
    "# Cameras (1)\n# PhotoID, X, Y, Z, Omega, Phi, Kappa, r11, r12, r13, r21, r22, r23, r31, r32, r33\n"
    "a\t751000.12\t4020000.34\t900.5\t30\t20\t0\t1\t0\t0\t0\t1\t0\t0\t0\t1\n",
    '#CoordinateSystem: PROJCS["WGS 84 / UTM zone 16N"]\n#Label,X/East,Y/North,Z/Altitude,Yaw,Pitch,Roll\n'
    "a.JPG,751000.12,4020000.34,900.5,30,20,0\n",
    "#name,x,y,alt,heading,pitch,roll\na.jpg,751000.12,4020000.34,900.5,30,20,0\n",
    "#F=N X Y Z W P K\na.JPG 751000.12 4020000.34 900.5 30 20 0\n",
)
GERMAN = "Bild;x;y;z;omega;phi;kappa\na;292710,2;2731048,8;186,4;28,8;0,9;1,8\n".replace("Bild", "image")
METASHAPE = (
    "<?xml version='1.0' encoding='UTF-8'?>\n<document version='1.4.0'><chunk><sensors>"
    "<sensor id='0' label='X' type='frame'><resolution width='400' height='300'/><calibration type='frame' "
    "class='adjusted'><resolution width='400' height='300'/><f>277.5</f><cx>0.5</cx><cy>-0.25</cy><k1>-0.01</k1>"
    "</calibration></sensor></sensors><cameras><camera id='0' sensor_id='0' label='a'>"
    "<transform>1 0 0 2 0 1 0 -3 0 0 1 1 0 0 0 1</transform></camera><camera id='1' sensor_id='0' label='b'/></cameras>"
    "<transform><rotation>1 0 0 0 1 0 0 0 1</rotation><translation>4194424.0 739585.0 4733200.0</translation>"
    "<scale>3.5</scale></transform></chunk></document>\n"
)
_SUBTITLE = (
    '{0}\n00:00:00,000 --> 00:00:00,033\n<font size="28">FrameCnt: {0}, DiffTime: 33ms\n2024-03-02 08:15:30.125\n'
    "[iso: 100] [fnum: 2.8] [latitude: 47.{0}] [longitude: 8.25] [rel_alt: 120.000 abs_alt: 610.500] "
    "[gb_yaw: 12.5 gb_pitch: -45.0 gb_roll: 0.0]</font>\n\n"
)
SUBTITLES = _SUBTITLE.format(1) + _SUBTITLE.format(2)
CAPTIONS = [(float(k), _SUBTITLE.format(k + 1).split("\n", 2)[2].strip()) for k in range(3)]  # of a video
AIRDATA = (
    "time(millisecond),datetime(utc),latitude,longitude,height_above_takeoff(feet),altitude_above_seaLevel(feet),gpslevel,"
    "gimbal_heading(degrees),gimbal_pitch(degrees),gimbal_roll(degrees),isPhoto\n"
    "1500,2024-03-02 08:15:31,47.1,8.25,984.25,2952.75,5,30.5,-60,0,1\n"
    "1600,2024-03-02 08:15:31,47.1001,8.25,984.5,2953,5,31,-60,0,0\n"
)
POSITIONS = (  # OpenDroneMap's geo.txt and shots.geojson, DJI's marks, a table
    "EPSG:4326\na.JPG 8.25 47.1 610.5 12 -45 0 0.02 0.03\nb.JPG 8.2501 47.1 610.7\n",
    "1\t362830.112\t[2312]\t   12,N\t   -3,E\t  190,V\t47.10000000,Lat\t8.25000000,Lon\t610.500,Ellh\t"
    "0.0101, 0.0102, 0.0203\t50,Q\n",
    json.dumps(
        {
            "type": "FeatureCollection",
            "features": [
                {
                    "type": "Feature",
                    "properties": {
                        "filename": "a.JPG",
                        "camera": "one",
                        "width": 400,
                        "height": 300,
                        "capture_time": 1.7e9,
                        "translation": [4.2e6, 7.4e5, 4.7e6],
                        "rotation": [1.2, 0.3, -2.1],
                    },
                    "geometry": {"type": "Point", "coordinates": [8.25, 47.1, 610.5]},
                }
            ],
        }
    ),
    "image,lat_deg,lon_deg,height_m\na.JPG,47.1,8.25,610.5\n",
)
