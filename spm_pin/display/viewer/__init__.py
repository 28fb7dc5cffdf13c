"""The interactive viewer: a page where one drags the platform and watches all branches. Extra `viewer`.

`state` and its neighbours `reach`, `readings`, `recording` and `export` know nothing of a page and are what a session
consists of; `robot` turns a configuration into placed meshes; `stage`, `panel` and `markup` show a session on a page;
`session` joins the two for one client, `server` holds the clients, `snapshot` writes a page that needs no server.
"""

from spm_pin.display.viewer.server import Viewer
from spm_pin.display.viewer.snapshot import save_snapshot

__all__ = ["Viewer", "save_snapshot"]
