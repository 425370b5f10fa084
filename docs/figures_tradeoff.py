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
        " at the end | of the area | of the void ratio | steps not converged | s |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    for row in result["macro"]:
        signed = (
            f"{row[name]:+.2%} ± {row[f'{name}_spread']:.2%}"
            for name in ("peak_error", "last_error", "area_error")
        )
        lines.append(
            f"| {row['setting']} | {row['value']} | {row['evaluations']:.1f} |"
            f" {1e-3 * row['dem_steps']:.0f} |"
            f" {row['curve_error']:.2%} ± {row['curve_error_spread']:.2%} |"
            f" {' | '.join(signed)} | {row['void_ratio_error']:.4f} |"
            f" {row['not_converged']:.1f} | {row['seconds']:.1f} |"
        )
    if "critical" in result:
        lines += critical_table(result["critical"])
    for title, name in (("The packing", "sentences"), ("The coupled test", "macro_sentences")):
        lines += ["", f"{title}:", "", *(f"- {sentence}" for sentence in result[name])]
    return lines


def critical_table(critical: dict) -> list[str]:
    """Of the critical state at constant volume."""
    lines = [
        "",
        f"Simple shear at constant volume, void ratio {critical['void_ratio']:.3f}, mean of gamma"
        f" {critical['first']:g} to {critical['last']:g} and of {critical['packings']} packings:",
        "", "| accuracy | DEM steps | mean pressure, kPa | off `reference` | friction angle |",
        "|---|---|---|---|---|",
    ]  # fmt: skip
    for row in critical["rows"]:
        lines.append(
            f"| {row['accuracy']} | {row['dem_steps']:.0f} |"
            f" {1e-3 * row['pressure_Pa']:.0f} ± {1e-3 * row['pressure_standard_error_Pa']:.0f} |"
            f" {row['pressure_error']:+.0%} ± {row['pressure_error_standard_error']:.0%} |"
            f" {row['friction_angle_deg']:.1f} ± {row['friction_angle_standard_error_deg']:.1f}° |"
        )
    return lines


ALL = {"tradeoff": (run_tradeoff, draw_tradeoff)}
