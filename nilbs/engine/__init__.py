"""Queries without torch; empty until there is a compiled engine."""
