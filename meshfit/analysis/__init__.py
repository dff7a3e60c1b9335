"""Analysis of subdivision schemes: masks, spectra, smoothness, and figures of them."""
