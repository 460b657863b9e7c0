"""`python -m nilbs`: the same as the command `nilbs`."""

import sys

from nilbs.app.main import main

if __name__ == "__main__":
    sys.exit(main())
