"""Geometry on arrays: numpy in, numpy out, in two and three dimensions alike.

The functions for users are those of `nilbs.geometry.__all__`; all others in this folder are internal. Importing this
module loads neither numpy nor any mesh library.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
