"""The interactive viewer: a page to drag the platform and see all branches. Extra `viewer`.

`model` is a session's state without a page, `playback` reads paths; `robot_scene` shows a state in the scene, `panel`
in widgets; `session` joins them for one client, `server` holds the clients.
"""

from spm_pin.display.viewer.playback import Playback, Recording, read_recording
from spm_pin.display.viewer.server import Viewer

__all__ = ["Playback", "Recording", "Viewer", "read_recording"]
