"""Readers under any bytes: fuzzing with coverage, and the corpus of files that it starts from."""
