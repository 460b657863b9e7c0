"""Tests of reading glTF, on files that they put together."""
