"""A fit in the coordinates given, as the engines make it: nothing is normalised or aligned."""

from functools import partial

import meshfit.fitting.fit

fit = partial(meshfit.fitting.fit.fit, normalise="none", align="none")
