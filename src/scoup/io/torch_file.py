"""Files of torch.save that hold tensors and plain containers: read with torch's restricted loader."""

from __future__ import annotations

import os
import pickle
import pickletools
import re
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from scoup.base import FileFormatError, existing_file
from scoup.io.reading import read_bytes

_PICKLE = b"\x80"
_OBJECTS = "contains Python objects other than tensors; it was not opened, because that could run code"
# Names in a pickle.
_TAKES_MEMORY = re.compile(r"\S+ (bytearray|UntypedStorage|TypedStorage)|torch(\.\w+)* \w*Tensor")
_FLOATS = (torch.float16, torch.bfloat16, torch.float32, torch.float64)


def load_torch(path: str | Path, what: str, without_objects: str, numpy_numbers: bool = False) -> Any:
    """Return the content of a file of torch.save; nothing in it is run. ``what`` is its kind for messages,
    ``without_objects`` the remedy where it holds Python objects; ``numpy_numbers`` allows single numpy numbers beside
    the tensors, as in Inria's checkpoints."""
    path = existing_file(path, what)
    if _is_bare_pickle(path):
        raise FileFormatError(
            path, "is a bare Python pickle, which is not opened: that could run code", without_objects
        )
    try:
        with zipfile.ZipFile(path) as archive:
            unpacked = sum(max(entry.file_size, entry.compress_size) for entry in archive.infolist())
            # torch stores without compression; one that unpacks to more than its size would fill the memory.
            if unpacked > os.path.getsize(path):
                raise ValueError("unpacks to more than its size")
            _check_names([archive.read(name) for name in archive.namelist() if name.endswith("data.pkl")])
        with torch.serialization.safe_globals(_number_types() if numpy_numbers else []):
            return torch.load(path, map_location="cpu", weights_only=True)
    except pickle.UnpicklingError as error:
        if "GLOBAL" not in str(error):  # torch's word for what is not a tensor
            raise FileFormatError(path, "is damaged", "copy it again") from error
        raise FileFormatError(path, _OBJECTS, without_objects) from error
    except Exception as error:  # damaged or foreign archives raise nearly everything inside torch
        reason = str(error).strip().splitlines()[0][:120] if str(error).strip() else type(error).__name__
        raise FileFormatError(path, f"cannot be loaded ({reason})", f"it should be {what}") from error


def _is_bare_pickle(path: Path) -> bool:
    """Return whether a file is a pickle and no archive."""
    try:
        archive = zipfile.is_zipfile(path)
    except zipfile.BadZipFile:  # it ends as an archive does, in a way that zipfile does not take
        archive = True
    return not archive and read_bytes(path)[:1] == _PICKLE


def _check_names(pickles: list[bytes]) -> None:
    """Refuse names that torch's restricted loader would call with any number, and so allocate any memory."""
    for content in pickles:
        for code, name, _ in pickletools.genops(content):
            if code.name == "GLOBAL" and _TAKES_MEMORY.fullmatch(str(name)):
                raise ValueError(f"makes a {str(name).split(' ')[-1]} of its own")


def float_tensor(path: Path, value: Any, shape: tuple[int, ...], name: str, what: str) -> np.ndarray:
    """Return [...] float32 of a tensor that a kind of file (``what``) holds under ``name``; of the shape expected -1
    takes any side."""
    sound = (
        isinstance(value, Tensor)
        and value.layout == torch.strided
        and value.dtype in _FLOATS
        and value.device.type == "cpu"
        and value.dim() == len(shape)
        # Views with zero strides can claim any size: a tensor has to fit into its file.
        and value.numel() * value.element_size() <= os.path.getsize(path)
        and all(wanted in (-1, side) for wanted, side in zip(shape, value.shape, strict=True))
    )
    if not sound:
        actual = f"{value.dtype} {list(value.shape)}" if isinstance(value, Tensor) else type(value).__name__
        expected = ", ".join("?" if side < 0 else str(side) for side in shape)
        problem = f"{name} is {actual}, expected floats [{expected}]"
        raise FileFormatError(path, problem, f"it should be {what}")
    return value.detach().float().numpy()


def float_tensors(
    path: Path, content: Mapping[str, Any], shapes: Mapping[str, tuple[int, ...]], what: str
) -> dict[str, np.ndarray]:
    """Return ``float_tensor`` of several tensors, which have a row of these shapes for each Gaussian."""
    arrays: dict[str, np.ndarray] = {}
    count = -1
    for name, shape in shapes.items():
        arrays[name] = float_tensor(path, content.get(name), (count, *shape), name, what)
        count = len(arrays[name])
    return arrays


def _number_types() -> list[Any]:
    """Return the parts of a pickled numpy float, under the names of old and new numpy."""
    scalar = type(np.float64(0)).__reduce__(np.float64(0))[0]  # type: ignore[arg-type]
    names = ("numpy.core.multiarray.scalar", "numpy._core.multiarray.scalar")
    kinds = [type(np.dtype(kind)) for kind in (np.float32, np.float64, np.int64)]
    return [*((scalar, name) for name in names), np.dtype, *kinds]
