"""Names of frames and alignments, apart from the modules that compute them because settings need only these."""

from typing import Literal

Normalisation = Literal["tutorial", "box", "sphere", "cube", "none"]
"""A frame for all lengths, made from the target (see `meshfit.frame_of`)."""
Alignment = Literal["none", "center", "box", "pca", "icp"]
"""A way to align a source with its target (see `meshfit.fitting.registration.alignment.align`)."""
