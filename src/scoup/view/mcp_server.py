"""The Model Context Protocol server over standard input and output, by the protocol's own package `mcp`."""

from __future__ import annotations

import functools
import io
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from PIL import Image as Pictures

from scoup.base.errors import ScoupError
from scoup.base.version import VERSION
from scoup.pictures.colors import Picture
from scoup.view.scene_tools import SceneTools

INSTRUCTIONS = (
    "3D scenes whose objects can be found by text. Begin with list_scenes. Things have numbers that stay the same; "
    "positions are in the scene's own units unless metres are given."
)


def make_server(tools: SceneTools, more: Iterable[Callable[..., Any]] = ()) -> Any:
    """Return the server (``mcp.server.mcpserver.MCPServer``) with a tool per public method of ``SceneTools``, and more.

    Raises:
        ScoupError: the package `mcp` is not installed.
    """
    try:
        from mcp.server.mcpserver import Image, MCPServer
        from mcp.server.mcpserver.exceptions import ToolError
    except ImportError as error:
        raise ScoupError(
            "serving agents needs the package mcp, 2 or newer: pip install 'scoup[mcp]'"
        ) from error

    server = MCPServer("scoup", instructions=INSTRUCTIONS, version=VERSION, log_level="WARNING")

    def add(method: Callable[..., Any]) -> None:
        @functools.wraps(method)
        def tool(**arguments: Any) -> Any:
            try:
                reply = method(**arguments)
            except ScoupError as error:  # the model reads what is wrong and tries again
                raise ToolError(str(error)) from error
            return Image(data=_png(reply), format="png") if isinstance(reply, np.ndarray) else reply

        server.tool(structured_output=False)(tool)

    for method in (
        tools.list_scenes,
        tools.list_cameras,
        tools.list_things,
        tools.find,
        tools.describe_thing,
        tools.measure_distance,
        tools.render_view,
        *more,
    ):
        add(method)
    if tools.export_folder is not None:
        add(tools.export_selection)
    return server


def _png(picture: Picture) -> bytes:
    data = io.BytesIO()
    Pictures.fromarray(picture).save(data, "PNG")
    return data.getvalue()
