"""Clients of the package: what is timed and scored, against what."""
