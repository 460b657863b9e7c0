"""The program that runs TetGen in a process of its own: from surface.npz in the working folder to volume.npz there.

TetGen writes files and prints where it gives up, and a crash of it ends the process. It is started by its path, so that
it loads nothing but numpy and libigl.
"""

import numpy as np


def main() -> None:
    """Fill the surface; a refusal is written as its message, for any other error the process ends with one."""
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
