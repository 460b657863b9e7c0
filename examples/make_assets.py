"""Draw the gingerbread man and write it as files: python examples/make_assets.py [folder].

Expect three files in examples/assets (or the folder given), after about a second:
gingerbread.obj (flat, z = 0), cookie.obj (the same figure as a solid) and gingerbread.tgf, the skeleton of both.
"""

import sys
from pathlib import Path

from nilbs.characters.gingerbread import write_gingerbread

if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "assets"
    for path in (*write_gingerbread(folder, 2), *write_gingerbread(folder, 3)):
        print(path)
