"""Write the page and the chart of the study of Table 1 from its run directories; `make study` runs the experiments.

python -m tests.benchmarks.paper_study runs docs/background/paper-study.md data/pictures/paper-study.png
"""

import sys
from pathlib import Path

from tests.benchmarks.paper_study_chart import write_chart
from tests.benchmarks.paper_study_data import read_points
from tests.benchmarks.paper_study_page import STUDY, text


def main(runs: str, page: str, chart: str) -> None:
    """Write both."""
    points = read_points(Path(runs) / STUDY)
    if not points:
        sys.exit(f"{runs}: no point of {STUDY} is complete; run `make study`")
    write_chart(points, Path(chart))
    Path(page).write_text(text(Path(runs)), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
