"""Broken and extreme characters, made from a seed, and what must come of each."""
