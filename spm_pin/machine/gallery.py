"""Real machines that are stages, by the numbers that their makers have published, with the sources of these numbers."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from spm_pin.machine.stage import Stage
from spm_pin.support.files import read_yaml


@dataclass(frozen=True)
class RealMachine:
    """A machine that is a stage, or two stages on one triangle of balls."""

    architecture: str
    """Its name in the literature, such as "3-RRS"."""
    stages: tuple[Stage, ...]
    """The stage; or two, which `spm_pin.Manipulator.of_stages` takes.

    The moving plate of a 3-SPR is the plate of pivots; the stage is the machine seen from there.
    """
    height: float
    """Height of the balls' centre above the plane of the pivots in the source's level position [m]."""
    source: str
    """Source of the numbers: a repository of github.com with the file and the commit that was read, or a paper."""
    assumed: str
    """Assumptions made where the source gives no number, as sentences."""

    @property
    def stage(self) -> Stage:
        """The stage, the lower one of two."""
        return self.stages[0]


def gallery() -> dict[str, RealMachine]:
    """Return ten real machines, by name: balancers, a heliostat, a driving simulator, robots, a haptic device.

    Returns
    -------
    dict
        Values are `RealMachine`, with dimensions in metres. `docs/howto/gallery.md` shows them, with what they reach
        and how far the formulas are off that their programs use.

    Examples
    --------
    >>> import spm_pin as spm
    >>> balancer = spm.machine.gallery()["Ball-Balancer-V2"]
    >>> spm.inverse_physical(balancer.stage, balancer.height).readings.round(4)
    array([0.3601, 0.3601, 0.3601])
    """
    machines = read_yaml(Path(__file__).with_name("gallery.yaml"))
    return {
        name: RealMachine(**data | {"stages": tuple(map(Stage.from_data, data["stages"]))})
        for name, data in machines.items()
    }
