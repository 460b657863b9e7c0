"""Geometry on arrays: numpy in, numpy out, in two and three dimensions alike."""
