"""Bands of a softening law on two meshes (docs/second-gradient.md)."""

import matplotlib
import numpy as np
from figures_common import FIGURES, OURS, THEIRS
from matplotlib.figure import Figure

from femxdem_fenicsx import plotting


def softening_fields() -> dict[str, np.ndarray]:
    """(points, x y and deviatoric strain) by gradient and columns."""
    from petsc4py import PETSc

    from tests.forms.test_localisation import compressed

    PETSc.Options()["femxdem_snes_type"] = "newtonls"
    fields = {}
    for gradient, modulus in (("first", None), ("second", 0.006)):
        for columns in (8, 16):
            curve, x, strain, _ = compressed(columns, modulus, 0.016, 0.002)
            fields[f"{gradient}_{columns}"] = np.column_stack([x, strain])
            fields[f"{gradient}_{columns}_curve"] = curve.T
    return fields


def run_second_gradient() -> None:
    np.savez_compressed(FIGURES / "second_gradient.npz", **softening_fields())


@matplotlib.rc_context(plotting.STYLE)
def draw_second_gradient() -> None:
    fields = np.load(FIGURES / "second_gradient.npz")
    figure = Figure((7.0, 3.2), layout="constrained")
    *maps, right = figure.subplots(1, 5, width_ratios=[1, 1, 1, 1, 2.2])
    cases = [(g, c) for g in ("first", "second") for c in (8, 16)]
    for axes, (gradient, columns) in zip(maps, cases, strict=True):
        x, y, strain = fields[f"{gradient}_{columns}"].T
        axes.tripcolor(x, y, 100 * strain, vmin=0, vmax=15, shading="gouraud", rasterized=True)
        axes.set(aspect="equal", xticks=[], yticks=[])
        axes.set_title(f"{gradient}\n{columns} x {2 * columns}", fontsize="small")
    for gradient, colour in (("first", THEIRS), ("second", OURS)):
        for columns, style in ((8, "--"), (16, "-")):
            load, force = fields[f"{gradient}_{columns}_curve"].T
            label = f"{gradient}, {columns} x {2 * columns}"
            right.plot(100 * load, -force, color=colour, ls=style, label=label)
    right.set_xlabel("axial strain (%), compression positive")
    right.set_ylabel("force on the plate (N/m), compression positive")
    right.legend(fontsize="small")
    figure.savefig(FIGURES / "second_gradient.png")


ALL = {"second_gradient": (run_second_gradient, draw_second_gradient)}
