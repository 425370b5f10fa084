"""What docs/second-gradient.md shows of shear bands in grains: fields and curves of the benchmark.

The runs are those of `benchmarks/mesh_independence.py --quick`, which
keeps them in results/ and goes on where it was stopped.
"""

import json

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
    "128_10.0": "128 elements\nD = 10 N", "512_10.0": "512 elements\nD = 10 N",
    "512_3.2": "512 elements\nD = 3.2 N", "128_first": "128 elements\nfirst gradient",
    "512_first": "512 elements\nfirst gradient",
}  # fmt: skip
COLOURS = dict(zip(("10.0", "first", "3.2"), plotting.COLOURS[:3], strict=True))


def run_bands() -> None:
    """Corners of the deformed elements, deviatoric strain at the end, and stress, into one file."""
    python("benchmarks/mesh_independence.py", "--quick")
    kept = {}
    for name in MAPS:
        folder = RUNS / name
        last = max(folder.glob("biaxial_fields/0*.h5"))
        with h5py.File(folder / "biaxial_fields" / "mesh.h5") as mesh, h5py.File(last) as fields:
            x = mesh["geometry"][:, :2] + fields["displacement"][:, :2]
            kept[f"{name}/corners"] = x[mesh["topology"][:, :4]].astype(np.float32)
            kept[f"{name}/strain"] = fields["deviatoric_strain"][:, 0].astype(np.float32)
        rows = np.genfromtxt(folder / "history.csv", delimiter=",", names=True)
        kept[f"{name}/curve"] = np.column_stack([rows["axial_strain"], rows["stress_ratio"]])
        kept[f"{name}/width"] = json.loads((folder / "run.json").read_text())["band_width"]
    np.savez_compressed(FIGURES / "bands.npz", **kept)


@matplotlib.rc_context(plotting.STYLE)
def draw_bands() -> None:
    kept = np.load(FIGURES / "bands.npz")
    figure = Figure((8.0, 3.0), layout="constrained")
    *maps, right = figure.subplots(1, len(MAPS) + 1, width_ratios=[1] * len(MAPS) + [2.6])
    for axes, (name, title) in zip(maps, MAPS.items(), strict=True):
        strain, corners = kept[f"{name}/strain"], kept[f"{name}/corners"]
        cells = PolyCollection(corners, array=strain / strain.max(), cmap="viridis", lw=0)
        axes.add_collection(cells)
        axes.autoscale()
        axes.set(aspect="equal", xticks=[], yticks=[])
        axes.spines[:].set_visible(False)
        axes.set_title(title, fontsize="small")
        end, width = kept[f"{name}/curve"][-1, 0], 1e3 * float(kept[f"{name}/width"])
        axes.set_xlabel(f"{100 * end:.1f} %\n{width:.1f} mm", fontsize="small")
        curve = kept[f"{name}/curve"]
        style = "--" if name.startswith("128") else "-"
        colour = COLOURS[name.split("_")[1]]
        right.plot(
            100 * curve[:, 0], curve[:, 1], ls=style, color=colour, label=title.replace("\n", ", ")
        )
    right.set_xlabel("axial strain (%), compression positive")
    right.set_ylabel("stress ratio")
    right.legend(fontsize="x-small")
    figure.savefig(FIGURES / "bands.png")


ALL = {"bands": (run_bands, draw_bands)}
