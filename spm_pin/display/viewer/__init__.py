"""The interactive viewer: a page to drag the platform and see all branches. Extra `viewer`.

A session's state does not depend on a page: `state`, `readings`, `recording`, `recording_files`.
`robot_meshes` gives the meshes of a configuration; `robot_scene`, `workspace_layer`, `camera`, `panel`,
`slider_ranges` and `state_markup` show a state, `state_export` saves it. `session` joins them for one client, with its
`event_queue`; `server` holds the clients. `viser_server` and `connection_guard` are what is added to viser.
"""

from spm_pin.display.viewer.server import Viewer
from spm_pin.display.viewer.state_export import save_snapshot

__all__ = ["Viewer", "save_snapshot"]
