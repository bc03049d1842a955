"""The tables of ``benchmarks.coding``, from its record."""

from __future__ import annotations

from statistics import mean

from benchmarks.coding_forms import GRAM, PAPER_EPOCHS, PARTS, QUALITY, Record, is_whole
from scoup.coding.exact import EFFORTS
from scoup_lab.bench import markdown
from scoup_lab.bench.environment import in_one_line
from scoup_lab.bench.report import milliseconds


def print_tables(record: Record) -> None:
    """Everything a reader compares."""
    settings, sizes = record["settings"], record["sizes"]
    print(in_one_line(record["machine"]))
    print(
        f"{settings['threads']} threads, load {record['machine']['load']} before, exact solver with "
        f"{settings['exact_with']}; D={settings['dim']}, L={settings['atoms']}, K={settings['k']}; seeds "
        f"{settings['first_seed']} to {settings['first_seed'] + settings['repeats'] - 1}, interleaved\n{record['data']}"
    )
    print_exact(sizes)
    print(f"\n{compared_table(sizes)}")
    print_qualities(sizes)
    print(f"\n{record['seconds']:.0f} s for all of this; extrapolated:")
    for line in record["extrapolated"]:
        print(f"* {line}")


def print_exact(sizes: list[Record]) -> None:
    """Cost and loss of every schedule, then the parts of the presets."""
    headers = ["regions", "exact solver", "least, ms", "median, ms", "loss, mean", "loss, range"]
    headers += ["5th percentile cosine", "rarest tenth, cosine", "dead atoms"]
    body = [
        [
            f"{size['regions']:,}",
            name,
            milliseconds(fit["seconds"]["least"]),
            milliseconds(fit["seconds"]["median"]),
            f"{mean(fit['loss']):.4f}",
            f"{min(fit['loss']):.4f} to {max(fit['loss']):.4f}",
            f"{mean(fit['low_cosine']):.3f}",
            f"{mean(fit['rarest_cosine']):.3f}",
            f"{mean(fit['dead_atoms']):.1%}",
        ]
        for size in sizes
        for name, fit in size["exact"].items()
    ]
    print(f"\n{markdown(headers, body, left=2)}\n")
    headers = ["regions", "exact solver", *(f"{part}, ms (least)" for part in PARTS)]
    body = [
        [
            f"{size['regions']:,}",
            name,
            *(
                f"{milliseconds(spent['median'])} ({milliseconds(spent['least'])})"
                for spent in size["exact"][name]["parts_s"].values()
            ),
        ]
        for size in sizes
        for name in EFFORTS
    ]
    print(markdown(headers, body, left=2))
    for size in sizes:
        gap = size.get("gap")
        if gap is not None:
            print(
                f"{size['regions']:,} regions, {gap['regions']} of them against every support: {gap['optimal']:.0%} "
                f"are the best codes, cosine lost {gap['mean']:.1e} in the mean, {gap['greatest']:.1e} at most"
            )


def compared_table(sizes: list[Record]) -> str:
    """What the others take, and how many times as long as the exact solver that is."""
    headers = ["regions", "form", "least, ms", "median, ms", "of", "whole fit, s", "times fast", "times best"]
    body = []
    for size in sizes:
        run = size.get("adam")
        measured = {GRAM} if run and run["epochs"] == PAPER_EPOCHS else set()
        lines = []
        for name, spent in size["epoch_s"].items():
            how = "measured" if name in measured else "extrapolated"
            lines.append((name, spent, "an epoch", size["whole_adam_s"][name], how))
        fitted = size.get("autoencoder")
        if fitted:
            how = "measured" if is_whole(fitted) else "extrapolated"
            name = f"autoencoder, {fitted['threads']} thread" + ("" if fitted["threads"] == 1 else "s")
            lines.append((name, fitted["step_s"], "a step", fitted["all_epochs_s"], how))
        for name, spent, unit, whole, how in lines:
            cells = [f"{size['regions']:,}", name, milliseconds(spent["least"])]
            cells += [milliseconds(spent["median"]), unit, f"{whole:.1f} ({how})"]
            cells += [
                f"{whole / size['exact'][preset]['seconds']['median']:.0f}" for preset in ("fast", "best")
            ]
            body.append(cells)
    return markdown(headers, body, left=2)


def print_qualities(sizes: list[Record]) -> None:
    """What exact codes, Adam's and the autoencoder make of the same rows."""
    headers = [
        "regions",
        "form",
        "epochs",
        "mean cosine",
        "5th percentile",
        "rarest tenth",
        "dead atoms",
        "fit, s",
    ]
    body = []
    for size in sizes:
        best = size["exact"]["best"]
        averages = {name: mean(best[name]) for name in QUALITY}
        lines: list[tuple[str, str, Record, float]] = [
            ("exact, best", "-", averages, best["seconds"]["median"])
        ]
        for name, fit in (("Adam", size.get("adam")), ("autoencoder", size.get("autoencoder"))):
            if fit:
                lines.append((name, str(fit["epochs"]), fit, fit["seconds"]))
        for name, epochs, fit, seconds in lines:
            dead = f"{fit['dead_atoms']:.1%}" if "dead_atoms" in fit else "-"
            cells = [f"{size['regions']:,}", name, epochs, f"{1 - fit['loss']:.4f}"]
            cells += [
                f"{fit['low_cosine']:.3f}",
                f"{fit['rarest_cosine']:.3f}",
                dead,
                f"{seconds:.2f}",
            ]
            body.append(cells)
    print(f"\n{markdown(headers, body, left=2)}")
    for size in sizes:
        adam = size.get("adam")
        if not adam:
            continue
        below = adam["exact_below"]
        reached = (
            "no schedule of the exact solver is below that with every seed"
            if below is None
            else f"the exact solver is below that after {1e3 * below['seconds']:.0f} ms ({below['schedule']}, every "
            f"seed), {adam['seconds'] / below['seconds']:.0f} times sooner"
        )
        print(
            f"{size['regions']:,} regions, Adam, {adam['epochs']} epochs: loss {adam['first_loss']:.4f} to "
            f"{adam['loss']:.4f} in {adam['seconds']:.1f} s, {adam['recoded_loss']:.4f} with exact codes; {reached}"
        )
    left_out = [f"{size['regions']:,}" for size in sizes if "adam" not in size]
    if left_out:
        print(f"no fit by Adam was run to its end on {', '.join(left_out)} regions")
