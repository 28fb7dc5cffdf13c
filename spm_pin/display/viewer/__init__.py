"""The interactive viewer: a page to drag the platform and see all branches. Extra `viewer`.

`model` is a session's state without a page, `playback` reads and plays paths; `robot_scene` shows a state in the
scene, `panel` in widgets; `page` serves both, with a session for every client.
"""

from spm_pin.display.viewer.page import Viewer
from spm_pin.display.viewer.playback import Playback, Recording, read_recording

__all__ = ["Playback", "Recording", "Viewer", "read_recording"]
