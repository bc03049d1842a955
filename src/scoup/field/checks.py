"""The rules for codes, things and names of a field, in memory and in its file, without torch.

Arrays are named as in the file (docs/formats.md).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scoup.base import InputError

if TYPE_CHECKING:
    from torch import Tensor

Arrays = Mapping[str, NDArray[Any]]
Table = Mapping[str, tuple[str, str]]
"""Name -> possible types, and sides: a letter stands for the same number in all arrays."""

MOST_THINGS = 65535
"""Files hold their numbers in 16 bits, and this one says that there is none."""
CODES: Table = {
    "code_indices": ("uint8 uint16", "N S K"),
    "code_weights": ("uint8 float16", "N S K"),
    "codebook": ("float16 float32", "S L D"),
}
THINGS: Table = {
    "things.owners": ("uint16", "N S"),
    "things.levels": ("uint8", "T"),
    "things.parents": ("uint16", "T"),
    "things.embeddings": ("float16", "T D"),
    "things.agreement": ("float32", "T"),
    "things.n_regions": ("int32", "T"),
    "things.mass": ("float32", "T"),
    "things.stability": ("float32", "T"),
}
THINGS_IN_MEMORY: Table = {**THINGS, "things.owners": ("int32", "N S"), "things.parents": ("int32", "T")}
NAMES: Table = {
    "names.presence": ("float32", "M"),
    "names.rows": ("int32", "E"),
    "names.things": ("int32", "E"),
    "names.votes": ("float32", "E"),
}
_INFINITY, _SIGN = 0x7C00, 0x8000  # bits of float16


def check_shapes(arrays: Arrays, table: Table, sides: dict[str, int]) -> None:
    """Refuse arrays whose types or shapes differ from a table. ``sides`` has the known numbers, and gets the others
    from the arrays; a KeyError for a missing array."""
    for name, (types, shape) in table.items():
        array, letters = arrays[name], shape.split()
        fits = str(array.dtype) in types.split() and array.ndim == len(letters)
        for letter, side in zip(letters, array.shape, strict=False):
            fits &= side == (int(letter) if letter.isdigit() else sides.setdefault(letter, side))
        if not fits:
            known = ", ".join(f"{letter} = {side}" for letter, side in sides.items())
            raise InputError(
                f"{name} is {array.dtype} {list(array.shape)}, expected {types.replace(' ', ' or ')} "
                f"[{', '.join(letters)}] with {known}"
            )


def check_finite(name: str, array: NDArray[Any]) -> None:
    """Refuse an array with NaN or infinite values."""
    if not np.isfinite(array).all():
        raise InputError(f"{name} contains values that are not finite")


def weight_bits(weights: NDArray[Any]) -> NDArray[Any]:
    """Return code weights as whole numbers in the same order, 0 for 0."""
    return weights if weights.dtype == np.uint8 else weights.view(np.uint16) & ~np.uint16(_SIGN)


def check_codes(arrays: Arrays, sides: dict[str, int]) -> None:
    """Refuse codes and a codebook that do not fit together, or ``sides``."""
    check_shapes(arrays, CODES, sides)
    indices, weights, codebook = (arrays[name] for name in CODES)
    atoms = sides["L"]
    if not all(sides[letter] for letter in "SKLD"):
        raise InputError(f"codes {list(indices.shape)} and codebook {list(codebook.shape)} are empty")
    wanted = "uint8" if atoms <= 256 else "uint16"
    if indices.dtype != wanted:
        raise InputError(f"code_indices are {indices.dtype}, expected {wanted} for {atoms} atoms")
    if int(indices.max(initial=0)) >= atoms:
        raise InputError(f"a code index is beyond the {atoms} atoms of the codebook")
    # Finite numbers that are not negative have bits below these of infinity, so most weights are read once.
    if weights.dtype == np.float16 and int(weights.view(np.uint16).max(initial=0)) >= _INFINITY:
        if int(weight_bits(weights).max(initial=0)) >= _INFINITY:
            raise InputError("code_weights contains values that are not finite")
        if int(weights.view(np.uint16).max(initial=0)) > _SIGN:
            raise InputError("a code weight is negative")
    check_finite("codebook", codebook)


def check_things(arrays: Arrays, sides: dict[str, int], table: Table = THINGS) -> None:
    """Refuse things that do not fit together, or ``sides``; ``table`` has their types in a file or in memory."""
    check_shapes(arrays, table, sides)
    count = sides["T"]
    if count > MOST_THINGS:
        raise InputError(f"{count:,} things; at most {MOST_THINGS:,} are possible")
    for name in ("things.owners", "things.parents"):
        # As bits without a sign, the number for none is the largest in memory, too.
        numbers = arrays[name]
        numbers = numbers.view(np.uint32) if numbers.dtype == np.int32 else numbers
        if ((numbers >= count) & (numbers != np.iinfo(numbers.dtype).max)).any():
            raise InputError(f"{name} names a thing beyond the {count}")
    if int(arrays["things.levels"].max(initial=0)) >= sides["S"]:
        raise InputError(f"a thing is of a level beyond the {sides['S']}")
    for name in ("things.embeddings", "things.agreement", "things.mass", "things.stability"):
        check_finite(name, arrays[name])


def check_names(arrays: Arrays, sides: dict[str, int]) -> None:
    """Refuse names of things that do not fit together, or ``sides``."""
    check_shapes(arrays, NAMES, sides)
    for name, count in {"names.rows": sides["M"], "names.things": sides["T"]}.items():
        if not ((arrays[name] >= 0) & (arrays[name] < count)).all():
            raise InputError(f"{name} is beyond the {count}")
    for name in ("names.presence", "names.votes"):
        check_finite(name, arrays[name])


def tensor_array(tensor: Tensor) -> np.ndarray:
    """Return a tensor as an array, on the CPU a view of it."""
    try:
        return tensor.detach().cpu().numpy()
    except TypeError:
        raise InputError(f"tensors of {tensor.dtype} cannot be used") from None
