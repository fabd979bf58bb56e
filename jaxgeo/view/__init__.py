"""A local viewer in the browser: the place on the map of a pixel, the pixel that shows a place, and their accuracy.

`serve(observed, grounds)` starts a server on this machine's loopback address, which other machines cannot reach.
`ViewData` answers the same questions without a server. The command is `jaxgeo view`. Needs the extra `plot`.
"""

from jaxgeo.view.data import ViewData
from jaxgeo.view.images import ViewImage, images_of
from jaxgeo.view.server import NoGround, ViewServer, serve
from jaxgeo.view.site import check_tiles

__all__ = ["NoGround", "ViewData", "ViewImage", "ViewServer", "check_tiles", "images_of", "serve"]
