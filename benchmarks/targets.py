"""Targets of the package, and whether a run met them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from benchmarks.report import Facts, Section, table, three_digits


@dataclass(frozen=True)
class Target:
    """A bound on a measured number.

    Attributes
    ----------
    text : str
        What is bounded.
    key : str
        Of the fact.
    bound : float
        At least this, or at most, as `at_least` says.
    unit : str
        Of both numbers.
    at_least : bool
        Which side is good.
    """

    text: str
    key: str
    bound: float
    unit: str = "×"
    at_least: bool = True

    def met(self, value: float) -> bool:
        """Return whether a value meets the target."""
        return value >= self.bound if self.at_least else value <= self.bound


TARGETS = (
    Target("inverse displacement: poselib.gp3p, bare / spm_pin", "inverse/gp3p bare", 20.0),
    Target("the same, aimed at", "inverse/gp3p bare", 50.0),
    Target("inverse displacement: numpy.roots / spm_pin", "inverse/numpy.roots", 500.0),
    Target("the same, its coefficients given", "inverse/numpy.roots bare", 500.0),
    Target("inverse displacement: spm_pin / C loop", "inverse/C loop", 2.5, at_least=False),
    Target("the same, aimed at", "inverse/C loop", 1.0, at_least=False),
    Target("machine as built, all branches, per pose", "inverse/as built", 10.0, "µs", at_least=False),
    Target("the same, the physical branch", "inverse/as built, physical", 3.0, "µs", at_least=False),
    Target("J_f: NumPy 9 × 9 / spm_pin", "velocity/J_f", 30.0),
    Target("the same, its matrices given", "velocity/J_f bare", 30.0),
    Target("leg forces: NumPy 9 × 9 / spm_pin", "velocity/forces", 30.0),
    Target("the same, its matrices given", "velocity/forces bare", 30.0),
    Target("forward, physical mode: spm_pin / C loop's inverse", "forward/physical", 10.0, at_least=False),
    Target("forward, all modes: SciPy multi-start / spm_pin", "forward/modes", 100.0),
    Target("`inverse_physical` / `inverse_displacement`", "states/physical", 1.5, at_least=False),
    Target("the same, one pose", "states/one pose", 30.0, "µs", at_least=False),
    Target("`singularities`, per state", "states/singularities", 1.5, "µs", at_least=False),
    Target("`joint_values`, per configuration", "states/joint values", 0.5, "µs", at_least=False),
    Target("the same, one configuration", "states/one joint values", 40.0, "µs", at_least=False),
    Target("a stage alone: tilt and height to readings", "states/stage inverse", 0.05, "µs", at_least=False),
    Target("the same, readings to the physical state", "states/stage forward", 0.5, "µs", at_least=False),
    Target("the same, SciPy's `fsolve` / spm_pin", "states/stage fsolve", 100.0),
    Target("leg lengths to 18 joints, 10⁶ of them", "jobs/log", 2.0, "s", at_least=False),
    Target("10⁵ poses in a new process, all branches, per pose", "states/fresh all", 1.0, "µs", at_least=False),
    Target("the same, the physical branch", "states/fresh physical", 0.5, "µs", at_least=False),
    Target("sweep of four metrics, 10⁶ points per second and core", "jobs/sweep", 1.0, ""),
    Target("inverse kernel / roofline, 10³ poses", "roofline/inverse", 2.0, at_least=False),
    Target("10⁶ poses with `out=` / 10⁴, per pose", "states/out", 1.3, at_least=False),
    Target("forward dynamics of a state / Pinocchio's calls", "states/forward dynamics", 2.0, at_least=False),
    Target("inverse dynamics of a state / Pinocchio's calls", "states/inverse dynamics", 2.0, at_least=False),
    Target("wrench polytope: facets and ball, per state", "capability/facets", 1.0, "µs", at_least=False),
    Target("the same: pycapacity / spm_pin", "capability/pycapacity", 300.0),
    Target(
        "a design at 10⁴ states, with its certificate",
        "capability/design",
        60.0,
        "ms",
        at_least=False,
    ),
    Target("control tick, median", "jobs/tick", 150.0, "µs", at_least=False),
    Target("the same, 99.9 % of them", "jobs/slow tick", 1.0, "ms", at_least=False),
    Target(
        "any closed chain, forward, slowest of five robots: single call", "loops/single", 60.0, "µs", at_least=False
    ),
    Target("the same, sample of a path", "loops/path", 15.0, "µs", at_least=False),
    Target("the same, member of a batch", "loops/batch", 30.0, "µs", at_least=False),
    Target("SciPy's `least_squares` / a single call, least of five robots", "loops/SciPy over single", 20.0),
    Target("the same / a sample of a path", "loops/SciPy over path", 20.0),
    Target("the same / a member of a batch", "loops/SciPy over batch", 20.0),
    Target("its forward dynamics / `constraintDynamics`, largest of five", "loops/dynamics", 2.5, at_least=False),
    Target("branches missed", "completeness/missed", 0.0, "", at_least=False),
    Target("branches reported that are none", "completeness/spurious", 0.0, "", at_least=False),
    Target("one thread / two threads", "scaling/two threads", 1.7),
    Target("`import spm_pin`", "startup/import", 0.5, "s", at_least=False),
    Target("heavy packages loaded with it", "startup/heavy", 0.0, "", at_least=False),
    Target("slowest first answer / importing NumPy and SciPy, CPU", "first/slowest", 3.0, at_least=False),
    Target("one pose through the public function", "startup/one pose", 100.0, "µs", at_least=False),
)


def check(facts: Facts, targets: Sequence[Target] = TARGETS) -> Section:
    """Compare what was measured with all targets; what was not measured is listed as such."""
    rows = []
    for target in targets:
        sign = "≥" if target.at_least else "≤"
        bound = f"{sign} {target.bound:g} {target.unit}".strip()
        fact = facts.get(target.key)
        if fact is None:
            rows.append([target.text, bound, "not measured", "", ""])
            continue
        value = f"{three_digits(fact.median)} {target.unit}".strip()
        spread = "" if fact.low == fact.high else f"{three_digits(fact.low)} – {three_digits(fact.high)}"
        rows.append([target.text, bound, value, spread, "met" if target.met(fact.median) else "**missed**"])
    section = Section("Targets")
    section.add(table(["", "target", "measured", "quartiles", ""], rows))
    return section
