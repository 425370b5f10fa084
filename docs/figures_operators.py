"""Argilaga's study of the tangent operators (docs/operators.md)."""

import json

import matplotlib
import numpy as np
from figures_common import FIGURES, OURS, THEIRS, THIRD, python
from matplotlib.figure import Figure

from femxdem_fenicsx import plotting


def run_operators() -> None:
    output = python("benchmarks/operators.py", "--quick").splitlines()[-1]
    rounded = json.loads(output, parse_float=lambda text: float(f"{float(text):.4g}"))
    (FIGURES / "operators.json").write_text(json.dumps(rounded) + "\n")


#: Line styles of the operators by kind: perturbed, affine, elastic.
KINDS = {
    "CTO": (THEIRS, "-"), "AEO": (THEIRS, "--"), "UKO": ("0.55", "-"), "UCKO": ("0.55", "--"),
    "UCKO-2DOF": ("0.55", ":"), "KAO": ("0.25", "-."), "DEMQO": (THIRD, "--"), "PSTLO": (OURS, "-"),
    "PSTLO-secant": (OURS, "--"), "default": (OURS, "-"),
}  # fmt: skip


@matplotlib.rc_context(plotting.STYLE)
def draw_operators() -> None:
    study = json.loads((FIGURES / "operators.json").read_text())
    draw_convergence(study)
    draw_cost(study)
    draw_spectra(study)


def draw_convergence(study: dict) -> None:
    """Argilaga's fig. 6."""
    figure = Figure((7.0, 3.0), layout="constrained")
    for axes, state in zip(figure.subplots(1, 2, sharey=True), ("start", "after"), strict=True):
        for name, ratios in study["states"][state]["curves"].items():
            colour, style = KINDS[name]
            axes.semilogy(ratios, color=colour, ls=style, label=name)
        axes.axhline(1e-2, color="0.8", lw=0.8, zorder=0)
        axes.set_xlabel("iteration")
        axes.set_title(f"from {100 * study['states'][state]['strain']:g} % strain")
    figure.axes[0].set_ylabel("FNORM/RNORM")
    figure.axes[1].legend(fontsize="small", ncols=2)
    figure.savefig(FIGURES / "operators_convergence.png")


def draw_cost(study: dict) -> None:
    """Argilaga's fig. 7, with evaluations beside iterations."""
    rows = {name: row for name, row in study["operators"].items() if row["strain_at_end"] > 0.0199}
    place = np.arange(len(rows))
    figure = Figure((7.0, 2.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    for shift, when, label in ((-0.2, "pre", "before the peak"), (0.2, "post", "after it")):
        values = [row[f"evaluations_{when}"] for row in rows.values()]
        left.bar(place + shift, values, 0.4, color=OURS if shift < 0 else THEIRS, label=label)
    left.set_ylabel("evaluations of the law per step")
    left.legend(fontsize="small")
    timed = {name: row for name, row in rows.items() if row["wall_s"] is not None}
    tangents = np.array([row["tangent_s"] for row in timed.values()])
    total = np.array([row["wall_s"] for row in timed.values()])
    right.bar(list(timed), total - tangents, 0.6, color="0.7", label="evaluations and FEM")
    right.bar(list(timed), tangents, 0.6, total - tangents, color=THIRD, label="tangents")
    right.set_ylabel("wall-clock to 2 %, s")
    right.legend(fontsize="small")
    left.set_xticks(place, rows, rotation=60, ha="right")
    right.set_xticks(range(len(timed)), timed, rotation=60, ha="right")
    for axes in (left, right):
        axes.set_ylim(0, 1.3 * axes.get_ylim()[1])  # room for the legend
    figure.savefig(FIGURES / "operators_cost.png")


def draw_spectra(study: dict) -> None:
    """Eigenvalues of K^-1 J; 1 is perfect."""
    figure = Figure((7.0, 2.8), layout="constrained")
    for axes, state in zip(figure.subplots(1, 2, sharey=True), ("before", "after"), strict=True):
        spectra = study["states"][state]["spectra"]
        for place, (name, (real, _)) in enumerate(spectra.items()):
            axes.plot(np.full(len(real), place), real, "_", ms=9, color=KINDS[name][0], alpha=0.6)
        axes.axhline(1.0, color="0.8", lw=0.8, zorder=0)
        axes.axhline(0.0, color="0.8", lw=0.8, zorder=0)
        axes.set_ylim(-1.0, 2.0)
        axes.set_xticks(range(len(spectra)), spectra, rotation=60, ha="right")
        axes.set_title(f"at {100 * study['states'][state]['strain']:g} % strain")
    figure.axes[0].set_ylabel("eigenvalues of $K^{-1}J$, real part")
    figure.savefig(FIGURES / "operators_spectra.png")


ALL = {"operators": (run_operators, draw_operators)}
