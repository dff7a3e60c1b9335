"""Layer 3: the torch engines that fit a source to a target."""
