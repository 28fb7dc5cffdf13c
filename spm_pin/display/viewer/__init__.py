"""The interactive viewer: a page to drag the platform and see all branches. Extra `viewer`.

A session's state does not depend on a page: `state`, `readings`, `recording`, `recording_files`, `state_export`.
`robot_meshes` gives the meshes of a configuration; `robot_scene`, `workspace_layer`, `camera`, `panel`,
`slider_ranges` and `state_markup` show a state. `session` joins them for one client, with its `event_queue` and
`playback`; `server` holds the clients. `viser_server`,
`connection_guard` and `page_style` are what is added to viser; `snapshot` writes a page that needs no server.
"""

from spm_pin.display.viewer.server import Viewer
from spm_pin.display.viewer.snapshot import save_snapshot

__all__ = ["Viewer", "save_snapshot"]
