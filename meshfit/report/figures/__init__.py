"""Figures of meshes and results."""
