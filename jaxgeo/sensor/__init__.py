"""Sensor model: cameras, lens distortion, gimbals, mounts, poses and shots. It does not depend on terrain.

Conventions (`docs/figures/conventions.png` shows them from all sides):

        north                               heading  from true north, clockwise        Rz
          |  x forward                      pitch    nose up                           Ry
          | /  (nose)                       roll     right wing down                   Rx
          |/ heading                        R_ned_from_body = Rz(heading) Ry(pitch) Rx(roll)
          +-------- east
           \\                                seen from behind, x into the page:
             y right (wing)
        ned: x north, y east, z down        left wing ----(x)---- y right
        body: x forward, y right, z down                   | \\
                                                     z down   line of sight, `outer` off nadir to the right

    image      u: columns ->                camera   right, down, forward (out through the lens)
             (0,0) . . . .                  uv = (column, row), pixel centres at integers:
       v:      .   +----- right             the image covers [-0.5, width - 0.5] x [-0.5, height - 0.5]
       rows    .   |        .               Mount.nadir()    right +y, down -x, forward +z of the head
        |      . down       .               Mount.forward()  right +y, down +z, forward +x of the head
        v      . . . . . . (width-1, height-1)

    pixel --camera--> camera --R_head_from_camera--> head --gimbal readings--> base --R_body_from_base--> body
          --heading, pitch, roll--> ned --position--> ecef;  a gimbal with reference "level" goes from head to ned.
"""

from jaxgeo._renamed import renamed
from jaxgeo.sensor import conventions
from jaxgeo.sensor.camera import AbstractCamera, FrameCamera
from jaxgeo.sensor.distortion import (
    AbstractCorrection,
    AbstractDistortion,
    Bauer,
    BrownConrady,
    BrownPhysical,
    Ebner,
    Fisheye,
    NoDistortion,
)
from jaxgeo.sensor.gimbal import Gimbal
from jaxgeo.sensor.platform import Deflection, Mount, Pose, Shot, boresight_from_degrees
from jaxgeo.sensor.pointing import point_shot, point_trajectory
from jaxgeo.sensor.scanning import PushbroomCamera, RollingShutterCamera, WhiskbroomCamera
from jaxgeo.sensor.sensor import Sensor
from jaxgeo.sensor.trajectory import Trajectory

__all__ = [
    "AbstractCamera",
    "AbstractCorrection",
    "AbstractDistortion",
    "Bauer",
    "BrownConrady",
    "BrownPhysical",
    "Deflection",
    "Ebner",
    "Fisheye",
    "FrameCamera",
    "Gimbal",
    "Mount",
    "NoDistortion",
    "Pose",
    "PushbroomCamera",
    "RollingShutterCamera",
    "Sensor",
    "Shot",
    "Trajectory",
    "WhiskbroomCamera",
    "boresight_from_degrees",
    "conventions",
    "point_shot",
    "point_trajectory",
]

DEPRECATED = {
    "SweepCamera": "WhiskbroomCamera",
}
__getattr__ = renamed(__name__, DEPRECATED)
