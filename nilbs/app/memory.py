"""How much memory the process has held."""

import sys


def peak_memory_mib() -> float | None:
    """The most memory that this process has held, in MiB; None if the system does not report it."""
    try:
        from resource import RUSAGE_SELF, getrusage
    except ImportError:  # Windows
        return None
    return getrusage(RUSAGE_SELF).ru_maxrss / (2**20 if sys.platform == "darwin" else 2**10)
