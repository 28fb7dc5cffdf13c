"""Run the benchmarks: the package beside its peers, in one run, on one thread.

    python benchmarks/run.py                     all of it, into benchmarks/results.md
    python benchmarks/run.py --quick             a look in a minute or two, on the screen
    python benchmarks/run.py --only inverse      one part, on the screen

Ctrl-C ends the run; what was measured until then is kept.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path

# Before any library is loaded: on one thread, ratios mean the same on every machine.
os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.machine import describe
from benchmarks.peers.peers_by_task import PACKAGES
from benchmarks.report import Facts, Section, write
from benchmarks.sections import (
    arrays,
    capability,
    completeness,
    controller,
    first_answers,
    forward,
    inverse,
    jobs,
    loops,
    roofline,
    scaling,
    startup,
    states,
    velocity,
)
from benchmarks.targets import check
from benchmarks.timing import Pace
from spm_pin.kinematics import compile_kernels

SECTIONS = {
    "inverse": inverse.measure,
    "velocity": velocity.measure,
    "forward": forward.measure,
    "states": states.measure,
    "jobs": jobs.measure,
    "arrays": arrays.measure,
    "capability": capability.measure,
    "loops": loops.measure,
    "controller": controller.measure,
    "completeness": completeness.measure,
    "scaling": scaling.measure,
    "roofline": roofline.measure,
    "answers": first_answers.measure,
    "startup": startup.measure,
}
RESULTS = Path(__file__).resolve().with_name("results.md")

INTRODUCTION = """\
# Benchmark results

Written by `make bench`, no number by hand; [how to read it](../docs/benchmarks.md). All peers are timed in turns in
every round of one run, on one thread unless said otherwise. Times are medians over the rounds with their quartiles;
ratios are taken within each round, then summarised likewise."""


class Progress:
    """One line that is written over on a terminal; elsewhere, a line per part."""

    def __init__(self) -> None:
        self._live = sys.stderr.isatty()
        self._begin = time.monotonic()

    def part(self, name: str) -> None:
        """Say which part begins."""
        self._say(f"[{time.monotonic() - self._begin:4.0f} s] {name}", end="\n")

    def __call__(self, text: str) -> None:
        """Say what goes on within it."""
        if self._live:
            self._say(f"         {text}", end="")

    def _say(self, text: str, end: str) -> None:
        clear = "\r\x1b[2K" if self._live else ""
        print(f"{clear}{text[:100]}", end=end, file=sys.stderr, flush=True)


def main() -> int:
    """Measure, print, and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="smaller batches and fewer rounds")
    parser.add_argument("--full", action="store_true", help="a batch of ten million poses as well (10 GB)")
    parser.add_argument("--only", action="append", choices=list(SECTIONS), metavar="PART", help=", ".join(SECTIONS))
    parser.add_argument("--out", type=Path, help=f"where to write; a complete run writes {RESULTS.name} by default")
    options = parser.parse_args()
    if options.quick and options.full:
        parser.error("--quick or --full, not both")
    complete = not (options.quick or options.only)
    out = options.out or (RESULTS if complete else None)
    pace = Pace(7, 0.02, quick=True) if options.quick else Pace(21, 0.1, full=options.full)

    progress, facts = Progress(), Facts()
    progress.part("compiling")
    compile_kernels()
    done: list[Section] = []
    load = [os.getloadavg()[0]]
    interrupted = ""
    for name in options.only or SECTIONS:
        progress.part(name)
        try:
            done.append(SECTIONS[name](pace, progress, facts))
        except KeyboardInterrupt:
            interrupted = f"**Interrupted during {name}; what follows it was not measured.**"
            break
    progress.part("done")
    load.append(os.getloadavg()[0])
    kind = "A quick run, with few rounds: for a look, not to be quoted." if options.quick else ""
    head = [INTRODUCTION, kind, interrupted, f"Measured on {time.strftime('%Y-%m-%d')}.", describe(PACKAGES, load)]
    text = "\n\n".join([*filter(None, head), check(facts).markdown, *(section.markdown for section in done)]) + "\n"
    print(text)
    if out is not None:
        write(out, text)
        print(f"written to {out}", file=sys.stderr)
    return 130 if interrupted else 0


if __name__ == "__main__":
    sys.exit(main())
