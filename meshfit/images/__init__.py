"""Images as targets: cameras, masks, depth and normals, an exact rasteriser, and the files that hold them."""
