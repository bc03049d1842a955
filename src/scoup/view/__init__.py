"""A field served: to people in the browser, or as exported pages, and to language models as tools.

Both servers answer with the same ``LanguageField``; neither lets strangers in.
"""

from scoup.view.export import export_page
from scoup.view.guard import is_loopback
from scoup.view.mcp_http import serve_http
from scoup.view.mcp_server import make_server, serve
from scoup.view.page import page_files
from scoup.view.scene_tools import SceneTools
from scoup.view.viewed_field import ViewedField
from scoup.view.viewer import Viewer, check_needed, open_viewer

__all__ = [
    "SceneTools",
    "ViewedField",
    "Viewer",
    "check_needed",
    "export_page",
    "is_loopback",
    "make_server",
    "open_viewer",
    "page_files",
    "serve",
    "serve_http",
]
