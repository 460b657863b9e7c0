"""The program that runs TetGen in a process of its own: from surface.npz in the working folder to volume.npz there.

TetGen writes files and prints where it gives up, and a crash of it ends the process. It is started by its path, so that
it loads nothing but numpy and TetGen.
"""

import sys
from importlib.util import find_spec, module_from_spec

import numpy as np


def main() -> None:
    """Fill the surface; a refusal is written as its message, for any other error the process ends with one."""
    # The packages around TetGen are not run: all of libigl, and scipy, take longer to load than most surfaces to fill.
    for name in ("igl", "igl.copyleft"):
        if (package := find_spec(name)) is not None:
            sys.modules[name] = module_from_spec(package)
    from igl.copyleft import tetgen

    with np.load("surface.npz") as surface:
        V, F, flags = surface["V"], surface["F"], str(surface["flags"])
    try:
        V, T = tetgen.tetrahedralize(V, F, flags=flags)[:2]
    except (RuntimeError, MemoryError) as error:
        np.savez("volume.npz", error=str(error) or type(error).__name__)
    else:
        np.savez("volume.npz", V=V, T=T)


if __name__ == "__main__":
    main()
