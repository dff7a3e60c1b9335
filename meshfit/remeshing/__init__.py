"""Changes of connectivity, and the soundness of moving surfaces, in torch."""
