"""Error against cost (docs/accuracy.md)."""

import json
import tempfile
from pathlib import Path

from figures_common import FIGURES, python

from femxdem_fenicsx import lab_plots

# Error against cost of the micro scale


def run_tradeoff() -> None:
    with tempfile.TemporaryDirectory() as folder:
        python("benchmarks/tradeoff.py", "--output", folder)
        (FIGURES / "tradeoff.json").write_text((Path(folder) / "tradeoff.json").read_text())


def draw_tradeoff() -> None:
    result = json.loads((FIGURES / "tradeoff.json").read_text())
    lab_plots.save_tradeoff(FIGURES / "tradeoff.png", result["sweep"], result["scatter"])
    (FIGURES / "tradeoff.md").write_text("\n".join(tradeoff_tables(result)) + "\n")


def tradeoff_tables(result: dict) -> list[str]:
    """The tables of docs/accuracy.md, as Markdown."""
    lines = [
        "| setting | value | DEM steps | rms error of the stress | error of the peak |"
        " of the drained curve | of its void ratio | CPU µs |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in result["sweep"]:
        lines.append(
            f"| {row['setting']} | {row['value']} | {row['dem_steps']:.0f} |"
            f" {row['rms_stress_error']:.2%} ± {row['spread_over_packings']:.2%} |"
            f" {row['peak_error']:+.1%} | {row['curve_error']:.1%} |"
            f" {row['void_ratio_error']:.4f} | {1e6 * row['seconds']:.0f} |"
        )
    lines += [
        "", "| setting | value | evaluations | 1000 DEM steps | error of the curve | of the peak |"
        " at the end | s |", "|---|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    for row in result["macro"]:
        lines.append(
            f"| {row['setting']} | {row['value']} | {row['evaluations']} |"
            f" {1e-3 * row['dem_steps']:.0f} | {row['curve_error']:.2%} |"
            f" {row['peak_error']:+.2%} | {row['last_error']:+.2%} | {row['seconds']:.1f} |"
        )
    return [*lines, "", *(f"- {sentence}" for sentence in result["sentences"])]


ALL = {"tradeoff": (run_tradeoff, draw_tradeoff)}
