"""Subdivision schemes on triangle meshes."""
