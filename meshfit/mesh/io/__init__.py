"""Mesh, polygon and curve files."""
