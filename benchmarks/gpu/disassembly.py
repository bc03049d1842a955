"""What nvdisasm prints, read: instructions, the loops they form, and what kind each one is.

An instruction here is one that a warp issues. One that is switched off by its guard (``@P0``) is issued all the same,
and counts.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

POWER = "MUFU.EX2"  # 2^x: every pixel and Gaussian takes one, nothing else of blending does
_INSTRUCTION = re.compile(r"^\s*/\*[0-9a-f]+\*/\s+(?:@(!?U?P\w+)\s+)?([A-Z][A-Z0-9_.]*)\s*([^;]*);")
_LABEL = re.compile(r"^\s*([.$][^\s:]+):\s*$")
_SECTION = ".text."
_TARGET = re.compile(r"`\(([^)]+)\)")
_ENDS = ("EXIT", "RET", "BRX", "JMX", "BPT", "KILL")

GROUPS: dict[str, tuple[str, ...]] = {
    "fp32": ("FFMA", "FADD", "FMUL", "FFMA32I", "FADD32I", "FMUL32I", "FFMA2", "FADD2", "FMUL2", "FSWZADD"),
    "fp16": ("HFMA2", "HADD2", "HMUL2", "HSET2", "HSETP2", "HMNMX2", "HADD2_32I", "HFMA2_32I", "HMUL2_32I"),
    "fp64": ("DADD", "DMUL", "DFMA", "DSETP"),
    "ALU": (
        "FSETP", "FSET", "FSEL", "FMNMX", "FMNMX3", "FCHK", "SEL", "ISETP", "IMNMX", "VIMNMX", "VIMNMX3", "VIADDMNMX",
        "VIADD", "IADD3", "IADD", "IADD32I", "LEA", "IABS", "LOP3", "LOP", "LOP32I", "SHF", "SHL",
        "SHR", "PRMT", "SGXT", "BMSK", "BREV", "FLO", "POPC", "IDP", "IDP4A", "PLOP3", "PSETP", "VABSDIFF",
        "VABSDIFF4", "LEPC",
    ),
    "IMAD": ("IMAD", "IMUL"),
    "special": ("MUFU",),
    "tensor": ("HMMA", "HGMMA", "IMMA", "IGMMA", "DMMA", "BMMA", "BGMMA", "QMMA", "QGMMA"),
    "shared": ("LDS", "STS", "LDSM", "STSM", "ATOMS", "STAS"),
    "global": (
        "LDG", "STG", "LD", "ST", "LDGSTS", "RED", "REDG", "ATOM", "ATOMG", "UTMALDG", "UTMASTG", "UTMAREDG", "UTMAPF",
        "UBLKCP",
    ),
    "spills": ("LDL", "STL"),
    "shuffles": ("SHFL", "VOTE", "MATCH", "REDUX"),
    "waits": (
        "BAR", "DEPBAR", "LDGDEPBAR", "ARRIVES", "SYNCS", "MEMBAR", "FENCE", "ERRBAR", "CGAERRBAR", "CCTL", "WARPGROUP",
        "WARPSYNC", "NANOSLEEP", "YIELD", "B2R", "UTMACMDFLUSH", "UCGABAR_ARV", "UCGABAR_WAIT",
    ),
    "branches": (
        "BRA", "BRX", "JMP", "JMX", "CALL", "RET", "EXIT", "BSSY", "BSYNC", "BREAK", "BMOV", "BPT", "KILL", "NOP",
        "ENDCOLLECTIVE", "ELECT",
    ),
    "conversions": ("F2F", "F2FP", "F2I", "F2IP", "I2F", "I2FP", "I2I", "I2IP", "FRND"),
    "moves": ("MOV", "MOV32I", "MOVM", "CS2R", "S2R", "P2R", "R2P"),
    "uniform": ("LDC", "LDCU", "ULDC", "R2UR", "S2UR", "VOTEU", "CS2UR", "REDUXU"),
}  # fmt: skip
OTHER = "other"
_GROUP_OF = {opcode: group for group, opcodes in GROUPS.items() for opcode in opcodes}


@dataclass(frozen=True)
class Instruction:
    """One line: the predicate that guards it or nothing, name with modifiers, operands."""

    guard: str
    opcode: str
    operands: str

    @property
    def group(self) -> str:
        """Which of ``GROUPS`` it is of. What starts with U and is in none of them runs once for a warp."""
        base = self.opcode.split(".")[0]
        if self.opcode.startswith(("IMAD.MOV", "IMAD.U32")) and self._copies():
            return "moves"
        return _GROUP_OF.get(base, "uniform" if base.startswith("U") else OTHER)

    @property
    def takes_power(self) -> bool:
        return self.opcode.startswith(POWER)

    def _copies(self) -> bool:
        """Registers are copied by IMAD.MOV, and by RZ RZ + R, too: other units than those of MOV do it."""
        factors = [part.strip() for part in self.operands.split(",")][1:3]
        return self.opcode.startswith("IMAD.MOV") or factors == ["RZ", "RZ"]


@dataclass(frozen=True)
class Loop:
    """A loop of a function, by the places of its instructions.

    Attributes:
        head: its first instruction, where each turn begins.
        ends: the branches back to it.
        body: all of its instructions, those of loops inside it too.
    """

    head: int
    ends: tuple[int, ...]
    body: frozenset[int]


@dataclass(frozen=True)
class Function:
    """A kernel, or a function it calls.

    Attributes:
        name: as the binary has it.
        instructions: in the order in which they lie.
        labels: which instruction each label stands before.
    """

    name: str
    instructions: tuple[Instruction, ...]
    labels: dict[str, int]

    @cached_property
    def successors(self) -> tuple[tuple[int, ...], ...]:
        """Where each instruction may go on to, as long as the threads of a warp are together where the compiler takes
        care that they may not be: what then serves them one by one (BRA.DIV to it, BRA.CONV around it) is no way.
        """
        return tuple(self._after(place) for place in range(len(self.instructions)))

    def _after(self, place: int) -> tuple[int, ...]:
        own = self.instructions[place]
        base, always = own.opcode.split(".")[0], own.guard in ("", "PT")
        following = (place + 1,) if place + 1 < len(self.instructions) else ()
        if base in _ENDS:
            return () if always else following
        target = _TARGET.search(own.operands)
        if base not in ("BRA", "JMP", "CALL") or own.opcode == "BRA.DIV" or not target:
            return following  # of BSYNC too: its label comes next
        if base == "CALL" and not target[1].startswith(".L"):
            return following  # of a function, which comes back; a call of a label of the kernel is a branch
        aim = self.labels.get(target[1], len(self.instructions))
        if aim == len(self.instructions):
            return () if always else following
        # BRA.U has its condition among the operands, before the target.
        only = own.opcode == "BRA.CONV" or (always and own.operands.startswith("`"))
        return (aim,) if only else tuple(dict.fromkeys((*following, aim)))

    @cached_property
    def _walk(self) -> tuple[frozenset[tuple[int, int]], tuple[int, ...]]:
        """By depth-first search from the first instruction: the steps that go back to one on the way there, and all
        instructions reached so that each comes before those it goes on to, going back apart.
        """
        back: set[tuple[int, int]] = set()
        order: list[int] = []
        state: dict[int, bool] = {}  # whether an instruction that was met is still on the way
        stack = [(0, iter(self.successors[0]))] if self.instructions else []
        state[0] = True
        while stack:
            place, others = stack[-1]
            for other in others:
                if other not in state:
                    state[other] = True
                    stack.append((other, iter(self.successors[other])))
                    break
                if state[other]:
                    back.add((place, other))
            else:
                state[place] = False
                order.append(place)
                stack.pop()
        return frozenset(back), tuple(reversed(order))

    @cached_property
    def loops(self) -> tuple[Loop, ...]:
        """All of them, those of few instructions first."""
        back, order = self._walk
        before: dict[int, list[int]] = {}
        for place in order:
            for other in self.successors[place]:
                before.setdefault(other, []).append(place)
        ends_of: dict[int, list[int]] = {}
        for end, head in sorted(back):
            ends_of.setdefault(head, []).append(end)
        found: list[Loop] = []
        for head, ends in ends_of.items():
            body, rest = {head}, list(ends)
            while rest:
                place = rest.pop()
                if place not in body:
                    body.add(place)
                    rest.extend(before.get(place, []))
            found.append(Loop(head, tuple(ends), frozenset(body)))
        return tuple(sorted(found, key=lambda loop: (len(loop.body), loop.head)))

    def way_round(self, loop: Loop, *, shortest: bool = False) -> tuple[Instruction, ...]:
        """The instructions of one turn along the longest way through the loop on which a power of 2 is taken (or the
        shortest such), in their order. Loops inside it are gone through once. Nothing where no way takes a power.
        """
        back, order = self._walk
        takes = [own.takes_power for own in self.instructions]
        # By place, and whether a power was taken on the way there: length of the way, and the step before.
        length = {(loop.head, takes[loop.head]): 1}
        came_from: dict[tuple[int, bool], tuple[int, bool]] = {}
        for place in order:
            for here in ((place, False), (place, True)):
                if here not in length:
                    continue
                for other in self.successors[place]:
                    if other not in loop.body or (place, other) in back:
                        continue
                    there, steps = (other, here[1] or takes[other]), length[here] + 1
                    known = length.get(there)
                    if known is None or (steps < known if shortest else steps > known):
                        length[there], came_from[there] = steps, here
        ends = [(end, True) for end in loop.ends if (end, True) in length]
        if not ends:
            return ()
        here = (min if shortest else max)(ends, key=length.__getitem__)
        way = [here]
        while here in came_from:
            here = came_from[here]
            way.append(here)
        return tuple(self.instructions[place] for place, _ in reversed(way))

    def blending_loop(self) -> Loop | None:
        """Of the loops that take powers of 2 and hold no other that does, the one with most of them."""

        def taken(loop: Loop) -> int:
            return powers(self.instructions[place] for place in loop.body)

        found = [loop for loop in self.loops if taken(loop)]
        inner = [loop for loop in found if not any(other.body < loop.body for other in found)]
        return max(inner, key=taken, default=None)

    def loops_inside(self, loop: Loop) -> int:
        return sum(other.body < loop.body for other in self.loops)


def parse(text: str) -> dict[str, Function]:
    """Functions by name, of what ``nvdisasm -c`` prints."""
    found: dict[str, tuple[list[Instruction], dict[str, int]]] = {}
    instructions: list[Instruction] | None = None
    labels: dict[str, int] = {}
    for line in text.splitlines():
        label = _LABEL.match(line)
        if label and label[1].startswith(_SECTION):
            instructions, labels = found.setdefault(label[1].removeprefix(_SECTION), ([], {}))
        elif instructions is None:
            continue
        elif label:
            labels[label[1]] = len(instructions)
        else:
            own = _INSTRUCTION.match(line)
            if own:
                instructions.append(Instruction(own[1] or "", own[2], own[3].strip()))
    return {name: Function(name, tuple(own), labels) for name, (own, labels) in found.items()}


def powers(instructions: Iterable[Instruction]) -> int:
    """How many of them are powers of 2."""
    return sum(own.takes_power for own in instructions)


def tally(instructions: Sequence[Instruction]) -> dict[str, int]:
    """How many there are of each group, in the order of ``GROUPS``; groups without any are left out."""
    counts = Counter(own.group for own in instructions)
    return {group: counts[group] for group in (*GROUPS, OTHER) if counts[group]}
