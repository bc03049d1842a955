"""Checks of machine code for NVIDIA GPUs."""

from __future__ import annotations

import re

# An instruction: address, predicate, name, operands.
_LINE = re.compile(r"/\*([0-9a-f]{4,6})\*/\s+(?:@(!?U?P[T\d]) )?([A-Z][\w.]*)\s*([^;]*);")
_NONE = 63  # URZ, which reads as zero


def unwritten(text: str) -> list[str]:
    """Return the uniform registers that a kernel reads before it writes them.

    ptxas 12.8 (Triton 3.4 to 3.6) has a bug for sm_90: descriptors of matrix products may come from such a register,
    and the kernel ends with an illegal memory access.

    Args:
        text: one kernel for sm_80 or sm_90, as printed by ``cuobjdump --dump-sass``.
    """
    lines = _LINE.findall(text)
    places = {int(address, 16): place for place, (address, *_) in enumerate(lines)}
    effects = [_effect(name, operands) for _, _, name, operands in lines]
    following: list[list[int]] = []
    for place, (_, predicate, name, operands) in enumerate(lines):
        after = [place + 1] if place + 1 < len(lines) else []
        if name.split(".")[0] == "EXIT" and not predicate:
            after = []
        if name.split(".")[0] == "BRA":
            target = places[int(operands.split(",")[-1], 16)]
            after = [target, *(after if predicate or "," in operands else [])]
        following.append(after)
    live: list[set[int]] = [set() for _ in lines]
    changed = True
    while changed:
        changed = False
        for place in reversed(range(len(lines))):
            written, read = effects[place]
            behind = set().union(*(live[after] for after in following[place]))
            now = read | (behind - (set() if lines[place][1] else written))
            if now != live[place]:
                live[place], changed = now, True
    return [f"UR{register}" for register in sorted(live[0] - {_NONE})] if live else []


def _effect(name: str, operands: str) -> tuple[set[int], set[int]]:
    """Return the uniform registers that an instruction writes, and those that it reads."""
    kind, parts = name.split(".")[0], [part.strip() for part in re.split(r",(?![^\[]*\])", operands)]
    if kind == "HGMMA":  # four registers; the first two locate A, unless A is in registers
        first = 2 if re.match(r"R\d", parts[1]) else 0
        return set(), {
            int(base) + place
            for base in re.findall(r"gdesc\[UR(\d+)\]", operands)
            for place in range(first, 4)
        }
    written: set[int] = set()
    if (kind.startswith("U") or kind in ("R2UR", "S2UR", "REDUX")) and not kind.endswith("SETP"):
        while re.match(r"!?U?P[T\d]$", parts[0]):
            parts.pop(0)
        written = _registers(parts.pop(0), 2 if ".64" in name or "WIDE" in name else 1)
    read: set[int] = set()
    for part in parts:
        wide = "desc[" in part or ("WIDE" in name and part is parts[-1]) or (".64" in name and kind[0] == "U")
        read |= _registers(part, 2 if wide or re.search(r"UR\d+\.64", part) else 1)
    return written, read


def _registers(operand: str, count: int) -> set[int]:
    return {int(base) + place for base in re.findall(r"UR(\d+)", operand) for place in range(count)}
