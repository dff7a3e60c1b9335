from meshfit.units import count_text, duration_text, size_text
from tests.loops import over


@over(
    ("seconds", "text"),
    [
        (0, "0 s"),
        (0.4, "0 s"),
        (89.4, "89 s"),
        (90, "2 min"),
        (720, "12 min"),
        (3600 * 1.5, "1 h 30 min"),
        (7199, "2 h"),
        (3600 * 47.5, "47 h 30 min"),
        (86400 * 4.2, "4 days"),
    ],
)
def test_durations(seconds, text):
    assert duration_text(seconds) == text


@over(
    ("count", "text"),
    [
        (0, "0 B"),
        (649, "649 B"),
        (999, "999 B"),
        (1000, "1.0 kB"),
        (9_940, "9.9 kB"),
        (128_226, "128 kB"),
        (999_700, "1.0 MB"),
        (12_300_000, "12 MB"),
        (4.2e9, "4.2 GB"),
        (5e15, "5000 TB"),
    ],
)
def test_sizes(count, text):
    assert size_text(count) == text


@over(
    ("number", "noun", "text"),
    [
        (1, "trial", "1 trial"),
        (0, "trial", "0 trials"),
        (1200, "trial", "1,200 trials"),
        (1, "such vertex", "1 such vertex"),
        (2, "such vertex", "2 such vertices"),
        ("3", "level", "3 levels"),
    ],
)
def test_counts(number, noun, text):
    assert count_text(number, noun) == text
