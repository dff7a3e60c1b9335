"""Measurement of results: distances to the target, and mesh quality."""
