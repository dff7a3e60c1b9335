"""Subdivision schemes on curves."""
