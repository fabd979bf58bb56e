"""The demonstration: an oblique camera over real terrain, its fixes, what it cannot see, and how sure they are."""

from jaxgeo.demo.made import Demo, make_demo, scene_file
from jaxgeo.demo.picture import draw

__all__ = ["Demo", "draw", "make_demo", "scene_file"]
