"""Characters and their motions: read, combined, written; no torch."""
