"""Characters and their motions: read, combined, written; no torch."""

FRAMES = 100  # of random motion, and of a longer motion that a training takes
AMPLITUDE = 0.4  # radians, root mean square, of random motion
