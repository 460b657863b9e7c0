"""Geometry on arrays: numpy in, numpy out, in two and three dimensions alike.

Every function here can be imported from `nilbs.geometry`; what other files of this folder hold besides is for the
package itself. Importing this module loads no other library.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
