"""The base of all rooms: errors that say what to do, outputs that appear whole or not at all, progress, parts of work,
checks of arguments and files, tables that packages extend, and the one way to each backend.

Nothing here knows of 3D, and importing it loads neither torch nor numpy.
"""

from scoup.base.arrays import file_sha256, geometry_fingerprint, write_npz
from scoup.base.backends import load_backend, serves
from scoup.base.errors import (
    FileFormatError,
    InputError,
    MissingFileError,
    OutputExistsError,
    ScoupError,
    ScoupWarning,
    UnknownNameError,
    WriteError,
    check_format_version,
    invalid_contents,
    looked_up,
)
from scoup.base.foreign_files import foreign_kind
from scoup.base.inputs import check_arguments, existing_file, refuse_pointer
from scoup.base.json_node import JsonNode
from scoup.base.lazy import lazy_names
from scoup.base.native import native_core, required_core
from scoup.base.outputs import (
    atomic_file,
    atomic_path,
    check_output,
    flush_to_disk,
    locked,
    reserved_output,
    staged,
    write_text,
)
from scoup.base.pages import PREVIEW, card, html
from scoup.base.registry import Entry, Registry
from scoup.base.scratch import MOST_ROWS_IN_MEMORY, scratch_array, temporary_folder
from scoup.base.sealed_file import SealedFile
from scoup.base.texts import (
    as_json,
    brief,
    counted,
    listed,
    printable,
    rounded_vector,
    share_of,
    slug,
    spread,
    unique_slugs,
)
from scoup.base.version import VERSION
from scoup.base.work import Part, Progress, no_progress, reported, worked_ahead
from scoup.base.world_frame import WorldFrame, check_metres

__all__ = [
    "MOST_ROWS_IN_MEMORY",
    "PREVIEW",
    "VERSION",
    "Entry",
    "FileFormatError",
    "InputError",
    "JsonNode",
    "MissingFileError",
    "OutputExistsError",
    "Part",
    "Progress",
    "Registry",
    "ScoupError",
    "ScoupWarning",
    "SealedFile",
    "UnknownNameError",
    "WorldFrame",
    "WriteError",
    "as_json",
    "atomic_file",
    "atomic_path",
    "brief",
    "card",
    "check_arguments",
    "check_format_version",
    "check_metres",
    "check_output",
    "counted",
    "existing_file",
    "file_sha256",
    "flush_to_disk",
    "foreign_kind",
    "geometry_fingerprint",
    "html",
    "invalid_contents",
    "lazy_names",
    "listed",
    "load_backend",
    "locked",
    "looked_up",
    "native_core",
    "no_progress",
    "printable",
    "refuse_pointer",
    "reported",
    "required_core",
    "reserved_output",
    "rounded_vector",
    "scratch_array",
    "serves",
    "share_of",
    "slug",
    "spread",
    "staged",
    "temporary_folder",
    "unique_slugs",
    "worked_ahead",
    "write_npz",
    "write_text",
]
