"""Triangle and polygon meshes, curves, their topology and files, sampling, and the named targets."""
