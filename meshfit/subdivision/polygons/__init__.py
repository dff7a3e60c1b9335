"""Subdivision schemes on polygon meshes."""
