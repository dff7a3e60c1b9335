"""Remeshing and self-intersection tests, in torch."""
