"""The page's title and style sheet, put into the HTML that viser serves."""

from __future__ import annotations

import gzip
from functools import lru_cache
from typing import Any

__all__ = ["PANEL_WIDTH", "PHONE_ASPECT", "PHONE_PANEL", "TITLE", "branded", "branded_html"]

TITLE = "spm_pin"
"""The title of the page."""

PANEL_WIDTH = 388.0
"""Width of the panel beside the picture [pixels]."""
PHONE_ASPECT = 0.9
"""A picture narrower than this share of its height is a phone's."""
PHONE_PANEL = 0.46
"""The share of a phone's page that the panel covers at its lower edge."""

_STYLE = f"""
@media (max-width: 36em) {{
  div[style*="position: fixed"][style*="width: 20em"] {{
    left: 0; width: 100% !important; max-height: {100 * PHONE_PANEL:.0f}% !important;
    border-radius: 0.8em 0.8em 0 0 !important }}
  div[style*="position: fixed"][style*="width: 20em"] div[style*="width: 20em"] {{ width: 100% !important }}
}}
"""


def branded_html(page: str) -> str:
    """Return viser's page with the title and the style of this project."""
    head = f"<title>{TITLE}</title><style>{_STYLE}</style>"
    return page.replace("<title>Viser</title>", "", 1).replace("</head>", f"{head}</head>", 1)


@lru_cache(maxsize=4)
def _branded_body(body: bytes, encoding: str) -> bytes:
    text = gzip.decompress(body) if encoding == "gzip" else body
    changed = branded_html(text.decode()).encode()
    return gzip.compress(changed) if encoding == "gzip" else changed


def branded(response: Any) -> Any:
    """Return an HTTP response, its title and style replaced where it is a page."""
    if response is not None and response.headers.get("Content-Type", "").startswith("text/html"):
        response.body = _branded_body(bytes(response.body), response.headers.get("Content-Encoding", ""))
        del response.headers["Content-Length"]
        response.headers["Content-Length"] = str(len(response.body))
    return response
