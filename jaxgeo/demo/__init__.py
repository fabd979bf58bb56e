"""Example data: an oblique camera over real terrain (`make_demo`), and a simulated drone image (`drone_image`).

The demo has fixes, hidden ground and accuracy. The true sensor and pose of the drone image are known.
"""

from jaxgeo.demo.drone import DroneImage, drone_image
from jaxgeo.demo.picture import Picture
from jaxgeo.demo.scene import Demo, Making, Seen, make_demo, scene_file

__all__ = ["Demo", "DroneImage", "Making", "Picture", "Seen", "drone_image", "make_demo", "scene_file"]
