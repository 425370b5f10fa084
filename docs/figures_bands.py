"""What docs/second-gradient.md shows of shear bands in grains: fields and curves of the benchmark.

The runs are those of `benchmarks/mesh_independence.py --quick`, which
keeps them in results/ and goes on where it was stopped.
"""

import h5py
import matplotlib
import numpy as np
from figures_common import FIGURES, RESULTS, python
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from femxdem_fenicsx import plotting

RUNS = RESULTS / "mesh_independence_quick"
#: Folder of a run, its title.
MAPS = {
    "128_10.0": "128\nD = 10 N", "512_10.0": "512\nD = 10 N", "2048_10.0": "2048\nD = 10 N",
    "2048_3.2": "2048\nD = 3.2 N", "2048_1.0": "2048\nD = 1 N",
    "128_first": "128\nfirst", "512_first": "512\nfirst",
}  # fmt: skip
#: Columns of elements, D and axial strain at the end of these runs.
CASES = ["8:10:0.04", "16:10:0.04", "32:10:0.04", "32:3.2:0.025", "32:1:0.025",
         "8:first:0.02", "16:first:0.0165"]  # fmt: skip
COLOURS = dict(zip(("10.0", "first", "3.2", "1.0"), plotting.COLOURS[:4], strict=True))
#: Of history.csv; and from which strain along it on a band is one.
COLUMNS = ("axial_strain", "stress_ratio", "band_width", "band_strain")
FORMED = 0.04
STYLES = {"128": ":", "512": "-", "2048": "--"}


def run_bands() -> None:
    """Corners of the deformed elements, deviatoric strain at the end, and stress, into one file."""
    python("benchmarks/mesh_independence.py", "--quick", "--runs", *CASES)
    kept = {}
    for name in MAPS:
        folder = RUNS / name
        last = max(folder.glob("biaxial_fields/0*.h5"))
        with h5py.File(folder / "biaxial_fields" / "mesh.h5") as mesh, h5py.File(last) as fields:
            x = mesh["geometry"][:, :2] + fields["displacement"][:, :2]
            kept[f"{name}/corners"] = x[mesh["topology"][:, :4]].astype(np.float32)
            kept[f"{name}/strain"] = fields["deviatoric_strain"][:, 0].astype(np.float32)
        rows = np.genfromtxt(folder / "history.csv", delimiter=",", names=True)
        kept[f"{name}/curve"] = np.column_stack([rows[column] for column in COLUMNS])
    np.savez_compressed(FIGURES / "bands.npz", **kept)


@matplotlib.rc_context(plotting.STYLE)
def draw_bands() -> None:
    kept = np.load(FIGURES / "bands.npz")
    figure = Figure((8.0, 5.6), layout="constrained")
    upper, lower = figure.subfigures(2, 1, height_ratios=[1, 1.2])
    stress, width, scaled = lower.subplots(1, 3)
    for axes, (name, title) in zip(upper.subplots(1, len(MAPS)), MAPS.items(), strict=True):
        strain, corners = kept[f"{name}/strain"], kept[f"{name}/corners"]
        look = {"cmap": "viridis", "lw": 0.2, "ec": "face"}
        cells = PolyCollection(corners, array=strain / strain.max(), **look)
        axes.add_collection(cells)
        axes.autoscale()
        axes.set(aspect="equal", xticks=[], yticks=[])
        axes.spines[:].set_visible(False)
        axes.set_title(title, fontsize="small")
        axial, ratio, across, within = kept[f"{name}/curve"].T
        axes.set_xlabel(f"{100 * axial[-1]:.1f} %\n{1e3 * across[-1]:.1f} mm", fontsize="small")
        elements, modulus = name.split("_")
        look = {"ls": STYLES[elements], "color": COLOURS[modulus]}
        stress.plot(100 * axial, ratio, label=title.replace("\n", " elements, "), **look)
        formed = within > FORMED
        width.plot(100 * within[formed], 1e3 * across[formed], **look)
        if elements == "2048":
            root = np.sqrt(float(modulus))
            scaled.plot(100 * within[formed], 1e3 * across[formed] / root, **look)
    stress.set(xlabel="axial strain (%), compression positive", ylabel="stress ratio")
    stress.legend(fontsize="x-small")
    along = "deviatoric strain along the band (%)"
    width.set(xlabel=along, ylabel="width of the band (mm)", ylim=(0, 30), xlim=(4, 25))
    scaled.set(xlabel=along, ylabel="width / √D (mm/√N), 2048 elements", ylim=(0, 15), xlim=(4, 25))
    figure.savefig(FIGURES / "bands.png")


ALL = {"bands": (run_bands, draw_bands)}
