"""Run the examples, keep their pictures: `python docs/site/example_figures.py`. Needs the extras plots and robots."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from figures import IMAGES, reduce_colours

EXAMPLES = Path(__file__).parents[2] / "examples"


def main() -> None:
    """Run each example in a folder of its own, and copy its picture in few colours."""
    for script in sorted(EXAMPLES.glob("*.py")):
        with tempfile.TemporaryDirectory() as folder:
            subprocess.run([sys.executable, script, folder], check=True)
            reduce_colours(Path(folder) / f"{script.stem}.png", IMAGES / "examples" / f"{script.stem}.png")
    reduce_colours(IMAGES / "examples/02_draw_the_mechanism.png", IMAGES / "mechanism.png")


if __name__ == "__main__":
    main()
