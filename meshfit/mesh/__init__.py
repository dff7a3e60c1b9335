"""Layer 1: triangle meshes, their topology, files, sampling, and the named targets."""
