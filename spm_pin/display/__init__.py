"""Pictures of the manipulator in PNG, SVG or PDF, figures of results, mesh files of the shell, and the viewer.

Functions that draw raise `MissingExtraError` without the extra `plots`, the viewer without `viewer`. Their figures are
not registered with pyplot.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from spm_pin.display.figures import (
        agreement_figure,
        calibration_figure,
        certificate_figure,
        front_figure,
        motion_figure,
        path_figure,
        reach_figure,
    )
    from spm_pin.display.plots import draw, draw_capability, save_gallery, save_picture
    from spm_pin.display.shell_plots import draw_shell, save_mesh, shell_figure
    from spm_pin.display.viewer import Playback, Recording, Viewer, read_recording
    from spm_pin.display.writing import save_figure

__all__ = ["agreement_figure", "calibration_figure", "certificate_figure", "front_figure", "motion_figure"]
__all__ += ["path_figure", "reach_figure"]
__all__ += ["draw", "draw_capability", "save_gallery", "save_picture"]
__all__ += ["draw_shell", "save_mesh", "shell_figure"]
__all__ += ["Playback", "Recording", "Viewer", "read_recording", "save_figure"]

# Imported on first use: the rooms behind a figure take a moment to import.
_HOMES = {
    "figures": "agreement_figure calibration_figure certificate_figure front_figure motion_figure path_figure "
    "reach_figure",
    "plots": "draw draw_capability save_gallery save_picture",
    "shell_plots": "draw_shell save_mesh shell_figure",
    "viewer": "Playback Recording Viewer read_recording",
    "writing": "save_figure",
}


def __getattr__(name: str) -> Any:
    for home, names in _HOMES.items():
        if name in names.split():
            return getattr(import_module(f"spm_pin.display.{home}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
