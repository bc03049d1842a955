"""The base of all rooms: errors that say what to do, outputs that appear whole or not at all, progress, parts of work,
checks of arguments and files, tables that packages extend, and the one way to each backend.

Nothing here knows of 3D, and importing it loads neither torch nor numpy.
"""

from scoup.base.ahead import worked_ahead
from scoup.base.arguments import PATH, check_arguments
from scoup.base.atomic import (
    atomic_file,
    atomic_path,
    check_output,
    flush_names,
    flush_to_disk,
    remove,
    reserved_output,
    reserved_part,
    write_text,
)
from scoup.base.backends import load_backend, serves
from scoup.base.counts import counted, listed, none_of, share_of, spread, verb
from scoup.base.digests import array_checksum, file_sha256, geometry_fingerprint, is_sealed, sealed
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
    looked_up,
    quoted,
    refused_read,
    remedy_of,
)
from scoup.base.existing import existing_file, refuse_pointer
from scoup.base.file_names import slug, unique_slugs
from scoup.base.json_node import JsonNode
from scoup.base.lazy import lazy_names
from scoup.base.locks import WAIT, locked
from scoup.base.native import native_core, refusals, release_memory, require_core
from scoup.base.npz import write_npz
from scoup.base.pages import PREVIEW, card, data_address, html
from scoup.base.parts import Part
from scoup.base.printable import printable
from scoup.base.progress import Progress, no_progress, reported
from scoup.base.records import rounded_vector
from scoup.base.registry import Entry, Registry
from scoup.base.safetensors_damage import safetensors_damage_named
from scoup.base.scratch import MOST_ROWS_IN_MEMORY, scratch_array, temporary_folder
from scoup.base.short_repr import brief
from scoup.base.staging import check_outputs, staged
from scoup.base.version import VERSION

__all__ = [
    "MOST_ROWS_IN_MEMORY",
    "PATH",
    "PREVIEW",
    "VERSION",
    "WAIT",
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
    "UnknownNameError",
    "WriteError",
    "array_checksum",
    "atomic_file",
    "atomic_path",
    "brief",
    "card",
    "check_arguments",
    "check_format_version",
    "check_output",
    "check_outputs",
    "counted",
    "data_address",
    "existing_file",
    "file_sha256",
    "flush_names",
    "flush_to_disk",
    "geometry_fingerprint",
    "html",
    "is_sealed",
    "lazy_names",
    "listed",
    "load_backend",
    "locked",
    "looked_up",
    "native_core",
    "no_progress",
    "none_of",
    "printable",
    "quoted",
    "refusals",
    "refuse_pointer",
    "refused_read",
    "release_memory",
    "remedy_of",
    "remove",
    "reported",
    "require_core",
    "reserved_output",
    "reserved_part",
    "rounded_vector",
    "safetensors_damage_named",
    "scratch_array",
    "sealed",
    "serves",
    "share_of",
    "slug",
    "spread",
    "staged",
    "temporary_folder",
    "unique_slugs",
    "verb",
    "worked_ahead",
    "write_npz",
    "write_text",
]
