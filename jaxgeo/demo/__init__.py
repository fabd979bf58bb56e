"""The demonstration: an oblique camera over real terrain, its fixes, what it cannot see, and how sure they are.

And a drone's image to try things on, made over the same terrain, of which the truth is known: `drone_image`.
"""

from jaxgeo.demo.drone import DroneImage, drone_image
from jaxgeo.demo.picture import draw
from jaxgeo.demo.scene import Demo, make_demo, scene_file

__all__ = ["Demo", "DroneImage", "draw", "drone_image", "make_demo", "scene_file"]
