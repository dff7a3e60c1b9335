"""The ablation replaces names of the Gauss–Newton engine; each of them has to exist there."""

from tests.benchmarks.ablation import VARIANTS


def test_every_variant_replaces_names_that_exist():
    for context, _ in VARIANTS.values():
        with context():
            pass
