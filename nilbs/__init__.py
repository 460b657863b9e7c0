"""Neural inverse linear blend skinning: occupancy and distance of posed characters, for any rigged mesh.

The names here join reading files, fitting and scoring; every stage on arrays is in `nilbs.geometry`. Importing this
module loads neither numpy nor torch nor any mesh library.
"""

import lazy_loader

__version__ = "0.2.0"
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
