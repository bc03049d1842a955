"""Counting instructions: disassembly read, ways through loops, groups, what fits, and kernels compiled for real."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.gpu import instructions
from benchmarks.gpu.compiled import DEVICES, Usage, compile_kernel, disassemble, resources, tool
from benchmarks.gpu.disassembly import GROUPS, Function, Instruction, parse, powers, tally
from benchmarks.gpu.gsplat_kernels import BACKWARD, PEERS, Peer, channels_of, cut_kernel
from benchmarks.gpu.launches import launches
from benchmarks.gpu.timing import Unavailable

from scoup.base.errors import InputError, OutputExistsError

# A loop over batches (.L_batch) around one over Gaussians (.L_gaussian), with a way around its middle, a way out, and
# what serves threads one by one: behind the end for BRA.DIV, in line for BRA.CONV. Another loop takes no power.
LISTING = """
	.headerflags	@"EF_CUDA_TEXTURE_MODE_UNIFIED EF_CUDA_64BIT_ADDRESS EF_CUDA_SM90"
//--------------------- .text.painted_kernel      --------------------------
	.section	.text.painted_kernel,"ax",@progbits
	.align	128
        .global         painted_kernel
painted_kernel:
.text.painted_kernel:
        /*0000*/                   LDC R1, c[0x0][0x28] ;
        /*0010*/                   IMAD.MOV.U32 R4, RZ, RZ, RZ ;
.L_zero:
        /*0020*/                   STS [R4], RZ ;
        /*0030*/              @!P0 BRA `(.L_zero) ;
.L_batch:
        /*0040*/                   BAR.SYNC.DEFER_BLOCKING 0x0 ;
.L_gaussian:
        /*0050*/                   LDS R5, [R4] ;
        /*0060*/                   BRA.DIV UR4, `(.L_one_by_one) ;
        /*0070*/                   SHFL.UP PT, R9, R5, 0x1, RZ ;
.L_together:
        /*0080*/                   BRA.CONV ~URZ, `(.L_past) ;
        /*0090*/                   MOV R20, 0xa0 ;
        /*00a0*/                   CALL.REL.NOINC `($__internal_0_$slow) ;
.L_past:
        /*00b0*/                   FMUL.FTZ R6, R5, -1.4426950216293334961 ;
        /*00c0*/                   MUFU.EX2 R6, R6 ;
        /*00d0*/                   FSETP.GEU.FTZ.AND P2, PT, R6, 0.0039215688593685626984, PT ;
        /*00e0*/              @!P2 BRA `(.L_next) ;
        /*00f0*/              @!P3 BRA `(.L_out) ;
        /*0100*/         @P4   FFMA.FTZ R8, R6, R7.reuse, R8 ;
        /*0110*/                   LDL R11, [R1+0x8] ;
.L_next:
        /*0120*/                   VIADD R4, R4, 0x1 ;
        /*0130*/              @!P1 BRA `(.L_gaussian) ;
        /*0140*/              @!UP1 UIADD3 UR4, UR4, 0x1, URZ ;
        /*0150*/                   BRA.U UP0, `(.L_batch) ;
.L_out:
        /*0160*/                   EXIT ;
.L_one_by_one:
        /*0170*/                   WARPSYNC.COLLECTIVE R10, `(.L_x_1) ;
.L_x_1:
        /*0180*/                   SHFL.UP PT, R9, R5, 0x1, RZ ;
        /*0190*/                   BRA `(.L_together) ;
        .weak           $__internal_0_$slow
$__internal_0_$slow:
        /*01a0*/                   RET.REL.NODEC R20 `(painted_kernel) ;
.L_self:
        /*01b0*/                   BRA `(.L_self);
        /*01c0*/                   NOP;

//--------------------- .text.idle_kernel      --------------------------
	.section	.text.idle_kernel,"ax",@progbits
.text.idle_kernel:
        /*0000*/                   MUFU.EX2 R6, R6 ;
.L_wait:
        /*0010*/                   NANOSLEEP 0x1 ;
        /*0020*/               @P0 BRA `(.L_wait) ;
        /*0030*/                   EXIT ;
"""
ON_THE_WAY = [
    "LDS", "BRA.DIV", "SHFL.UP", "BRA.CONV", "FMUL.FTZ", "MUFU.EX2", "FSETP.GEU.FTZ.AND", "BRA", "BRA", "FFMA.FTZ",
    "LDL", "VIADD", "BRA",
]  # fmt: skip
AROUND = [*ON_THE_WAY[:8], *ON_THE_WAY[-2:]]


@pytest.fixture
def painted() -> Function:
    return parse(LISTING)["painted_kernel"]


def test_a_listing_is_read(painted: Function) -> None:
    assert list(parse(LISTING)) == ["painted_kernel", "idle_kernel"]
    assert len(painted.instructions) == 29
    assert painted.instructions[1] == Instruction("", "IMAD.MOV.U32", "R4, RZ, RZ, RZ")
    assert painted.instructions[3] == Instruction("!P0", "BRA", "`(.L_zero)")
    assert painted.instructions[16] == Instruction("P4", "FFMA.FTZ", "R8, R6, R7.reuse, R8")
    assert painted.instructions[20] == Instruction("!UP1", "UIADD3", "UR4, UR4, 0x1, URZ")
    assert painted.labels[".L_gaussian"] == 5
    assert painted.labels["$__internal_0_$slow"] == 26


def test_where_instructions_go_on_to(painted: Function) -> None:
    named = {name: painted.labels[name] for name in painted.labels}
    assert painted.successors[3] == (4, named[".L_zero"])
    assert painted.successors[6] == (7,), "threads are together"
    assert painted.successors[8] == (named[".L_past"],), "threads are together"
    assert painted.successors[10] == (11,), "calls come back"
    assert painted.successors[21] == (22, named[".L_batch"]), "the condition is an operand"
    assert painted.successors[22] == ()
    assert painted.successors[25] == (named[".L_together"],)


def test_loops_inside_one_another_are_found(painted: Function) -> None:
    sizes = {loop.head: (loop.ends, len(loop.body)) for loop in painted.loops}
    # What no way leads to is in no loop: neither the instructions for threads one by one nor the last branch to itself.
    assert sizes == {2: ((3,), 2), 5: ((19,), 13), 4: ((21,), 16)}
    loop = painted.blending_loop()
    assert loop is not None
    assert loop.head == 5
    assert painted.loops_inside(loop) == 0
    batches = next(loop for loop in painted.loops if loop.head == 4)
    assert painted.loops_inside(batches) == 1


def test_the_longest_and_the_shortest_way(painted: Function) -> None:
    loop = painted.blending_loop()
    assert loop is not None
    longest, shortest = painted.way_round(loop), painted.way_round(loop, shortest=True)
    assert [own.opcode for own in longest] == ON_THE_WAY
    assert [own.opcode for own in shortest] == AROUND
    assert powers(longest) == powers(shortest) == 1
    assert painted.way_round(painted.loops[0]) == (), "no power is taken in the first loop"
    assert tally(longest) == {
        "fp32": 2, "ALU": 2, "special": 1, "shared": 1, "spills": 1, "shuffles": 1, "branches": 5,
    }  # fmt: skip
    batches = next(loop for loop in painted.loops if loop.head == 4)
    assert len(painted.way_round(batches)) == len(ON_THE_WAY) + 3, "the loop inside is gone through once"


def test_the_shortest_way_takes_a_power() -> None:
    text = LISTING.replace("LDS R5, [R4] ;", "LDS R5, [R4] ;\n /*0051*/ @P6 BRA `(.L_next) ;")
    function = parse(text)["painted_kernel"]
    loop = function.blending_loop()
    assert loop is not None
    shortest = [own.opcode for own in function.way_round(loop, shortest=True)]
    assert shortest == ["LDS", "BRA", *AROUND[1:]]


def test_of_unrolled_loops_the_one_with_most_powers_counts() -> None:
    text = """
.text.unrolled:
.L_outer:
    /*00*/ NOP ;
.L_main:
    /*10*/ MUFU.EX2 R1, R1 ;
    /*20*/ MUFU.EX2 R2, R2 ;
    /*30*/ @P0 BRA `(.L_main) ;
.L_rest:
    /*40*/ MUFU.EX2 R1, R1 ;
    /*50*/ @P0 BRA `(.L_rest) ;
    /*60*/ @P1 BRA `(.L_outer) ;
    /*70*/ EXIT ;
"""
    function = parse(text)["unrolled"]
    loop = function.blending_loop()
    assert loop is not None
    assert (loop.head, powers(function.way_round(loop))) == (1, 2)
    row = instructions.count("one", function, Usage(32, 0, 0), 8, 90, None)
    assert (row["lanes"], row["instructions"], row["blocks"], row["warps"]) == (2, 3, 8, 64)


def test_a_call_of_a_label_is_a_branch() -> None:
    text = """
.text.called:
.L_head:
    /*00*/ MUFU.EX2 R1, R1 ;
    /*10*/ CALL.REL.NOINC `($__internal_0_$slow) ;
    /*20*/ @P0 CALL.REL.NOINC `(.L_out) ;
    /*30*/ BRA `(.L_head) ;
    /*40*/ NOP ;
.L_out:
    /*50*/ EXIT ;
$__internal_0_$slow:
    /*60*/ RET.REL.NODEC R2 `(called) ;
"""
    function = parse(text)["called"]
    assert function.successors == ((1,), (2,), (3, 5), (0,), (5,), (), ())
    row = instructions.count("called", function, Usage(32, 0, 0), 8, 90, None)
    assert (row["instructions"], row["calls"]) == (4, 1)
    assert "functions, whose instructions are not counted: 1" in instructions.note_of(row)


def test_what_takes_no_powers_in_a_loop_says_so() -> None:
    row = instructions.count("idle", parse(LISTING)["idle_kernel"], Usage(32, 0, 0), 4, 90, 16)
    assert row["reason"] == "no loop that takes powers of 2 was found"
    assert "idle: no loop" in instructions.report({"capability": 90, "by": ["hand"], "rows": [row]})


def test_groups() -> None:
    def group(opcode: str, operands: str = "R1, R2, R3, R4") -> str:
        return Instruction("", opcode, operands).group

    assert group("IMAD.MOV.U32", "R1, RZ, RZ, R4") == "moves"
    assert group("IMAD.U32", "R1, RZ, RZ, UR4") == "moves"
    assert group("IMAD.U32") == "IMAD"
    assert group("IMAD.WIDE.U32") == "IMAD"
    assert group("HGMMA.64x64x16.F32") == group("HMMA.16816.F32") == "tensor"
    assert group("UIADD3") == group("ULDC.64") == group("R2UR") == "uniform"
    assert group("LDGSTS.E.128") == group("REDG.E.ADD.F32.FTZ.RN.STRONG.GPU") == "global"
    assert group("F2FP.F16.F32.PACK_AB") == "conversions"
    assert group("QUUX.F32") == "other"
    opcodes = [opcode for group in GROUPS.values() for opcode in group]
    assert len(opcodes) == len(set(opcodes)), "each opcode is of one group"


@pytest.mark.parametrize(
    ("registers", "shared", "warps", "capability", "blocks"),
    [
        (32, 0, 8, 90, 8),  # by warps
        (45, 7168, 8, 90, 5),  # by registers, given in units: 48 of a thread
        (143, 17408, 2, 90, 6),  # 14 warps by all registers, 12 by those of each part
        (64, 60 << 10, 4, 90, 3),
        (64, 60 << 10, 4, 80, 2),
        (32, 227 << 10, 4, 90, 1),
        (32, (227 << 10) + 1, 4, 90, 0),
        (255, 0, 16, 90, 0),
        (16, 0, 1, 90, 32),  # by blocks
    ],
)
def test_what_fits_on_a_multiprocessor(
    registers: int, shared: int, warps: int, capability: int, blocks: int
) -> None:
    assert Usage(registers, 0, shared).blocks(warps, DEVICES[capability]) == blocks


def test_a_kernel_is_cut_out_of_a_source() -> None:
    text = """
template <uint32_t CDIM> void launch(int a) { }
template <uint32_t CDIM, typename scalar_t>
__global__ void paint_kernel(
    const float *__restrict__ values, // not } here
    int n
) {
    if (n) { values += CDIM; }
}
void after() { }
"""
    name, kernel = cut_kernel(text)
    assert name == "paint_kernel"
    assert kernel.startswith("template <uint32_t CDIM, typename scalar_t>")
    assert kernel.endswith("values += CDIM; }\n}")
    with pytest.raises(Unavailable, match="no kernel of CDIM channels"):
        cut_kernel("void after() { }")
    with pytest.raises(Unavailable, match="does not end"):
        cut_kernel(text.split("if (n)")[0])
    assert channels_of("_ZN6gsplat35rasterize_to_pixels_3dgs_fwd_kernelILj512EfEEvjjj") == 512
    assert channels_of("codes_kernel") is None
    assert Peer("staged", BACKWARD, (32,), staged=True).shared(32) == 256 * (28 + 128)


def test_gsplat_that_cannot_be_counted_is_a_row_with_a_reason(tmp_path: Path) -> None:
    def only(gsplat: Path | None, nvcc: Path | None) -> str:
        (row,) = instructions.count_peer(PEERS[0], gsplat, nvcc, 90, lambda name: None)
        return row["reason"]

    assert only(None, None) == instructions.NOT_ASKED
    assert "is missing: give the folder" in only(tmp_path, tmp_path / "nvcc")
    source = tmp_path / "gsplat" / "cuda" / "csrc" / PEERS[0].source
    source.parent.mkdir(parents=True)
    source.write_text("template <uint32_t CDIM, typename T>\n__global__ void k(T *a) { }\n")
    assert "does not run" in only(tmp_path, tmp_path / "nvcc")
    failing = tmp_path / "failing"
    failing.write_text("#!/bin/sh\necho 'error: too old' >&2\nexit 1\n")
    failing.chmod(0o755)
    assert only(tmp_path, failing) == "nvcc fails: error: too old"


def blending_launches() -> list[tuple[str, Any]]:
    return [(name, launch) for name, launch in launches().items() if "CHUNK" in launch[2]]


def test_a_kernel_compiled_for_real(needs_triton: None, tmp_path: Path) -> None:
    try:
        tool("nvdisasm")
    except Unavailable as missing:
        pytest.skip(str(missing))
    kernel, types, constants, warps = blending_launches()[0][1]
    content, shared = compile_kernel(kernel, types, constants, warps, 90)
    binary = tmp_path / "kernel.cubin"
    binary.write_bytes(content)
    function = parse(disassemble(binary))[kernel.__name__]
    usage = Usage(*resources(binary)[kernel.__name__], shared)
    lanes = instructions.lanes_of(constants, warps)
    row = instructions.count("kernel", function, usage, warps, 90, lanes)
    assert row["powers"] == row["lanes"] == constants["TILE"] ** 2 * constants["CHUNK"] / (32 * warps)
    assert row["groups"]["fp32"] > 2 * row["lanes"], "the exponent alone takes more"
    assert row["groups"]["tensor"] > 0
    assert row["unknown"] == []
    assert sum(row["groups"].values()) == row["instructions"]
    assert row["warps"] >= warps
    others = {name: type_ for name, type_ in types.items() if name != "stop"}
    with pytest.raises(ValueError, match=r"launches\.py and the kernel disagree about WIDTH, stop"):
        compile_kernel(kernel, others, {**constants, "WIDTH": 1}, warps, 90)


@pytest.mark.parametrize("capability", [80, 90])
def test_loops_stay_short(needs_triton: None, tmp_path: Path, capability: int) -> None:
    """What these kernels are fast by: a Gaussian is weighed at a pixel by one thread alone, and few tensors change
    hands between threads. A compiler that takes something amiss takes two or three times as many instructions.
    """
    found = instructions.count_ours(capability, lambda name: None)
    rows = {row["name"]: row for row in found}
    assert {"3 channels", "codes 3 x 64", "cosines 2 x 128", "region sums"} <= rows.keys()
    for name, row in rows.items():
        assert "reason" not in row, row
        a_lane = {group: count / row["lanes"] for group, count in row["groups"].items()}
        most = 50 if name in ("3 channels", "region sums") else 115 if " in " not in name else 190
        assert row["instructions"] / row["lanes"] <= most, row
        assert a_lane["shuffles"] <= 1.5, row
        assert a_lane["waits"] <= 7, row
        assert a_lane.get("spills", 0) <= 6, row


def test_the_command(needs_triton: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("TRITON_INTERPRET", raising=False)
    (_, good), *_, (_, broken) = blending_launches()
    other = next(launch for launch in launches().values() if "CHUNK" not in launch[2])
    few = {"good": good, "other": other, "broken": (broken[0], {}, *broken[2:])}
    monkeypatch.setattr(instructions, "launches", lambda: few)
    out = tmp_path / "counted.json"
    told = instructions.main(["--capability", "80", "--json", str(out)])
    rows = {row["name"]: row for row in json.loads(out.read_text())["rows"]}
    assert list(rows) == ["good", "broken", *(peer.name for peer in PEERS)]
    assert "launches.py and the kernel disagree" in rows["broken"]["reason"]
    assert told.startswith("Compiled for sm_80 by triton ")
    assert "gsplat, forward: not asked for" in told
    with pytest.raises(OutputExistsError):
        instructions.main(["--json", str(out)])
    monkeypatch.setattr(instructions.shutil, "which", lambda name: None)
    with pytest.raises(InputError, match="give the folder that holds gsplat/cuda/csrc"):
        instructions.main(["--gsplat", str(tmp_path)])
    (tmp_path / "gsplat" / "cuda" / "csrc").mkdir(parents=True)
    with pytest.raises(InputError, match="give --nvcc"):
        instructions.main(["--gsplat", str(tmp_path)])
    monkeypatch.setenv("TRITON_INTERPRET", "1")
    with pytest.raises(InputError, match="unset it"):
        instructions.main([])
