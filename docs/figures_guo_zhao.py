"""What docs/localisation.md shows beside Guo and Zhao's section 4: curves, bands, local responses.

The runs are those of `benchmarks/localisation.py`, which take hours and are kept in
results/localisation. Where they are, `run_guo_zhao` takes over what is drawn; where they are not,
what was kept before is drawn.
"""

import h5py
import matplotlib
import numpy as np
from figures_common import FIGURES, RESULTS
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from femxdem_fenicsx import plotting
from femxdem_fenicsx.dem.loading import FAILED_CONTACTS_PER_GRAIN
from femxdem_fenicsx.fem import _dolfinx
from femxdem_fenicsx.fem.elements import element

#: Folder of a run, its title.
MESHES = {
    "localisation/6x10_Q4_2x2": "6 x 10 Q4", "localisation/10x15_Q4_2x2": "10 x 15 Q4",
    "localisation/12x20_Q4_2x2_varied_0.05": "12 x 20 Q4, varied",
    "localisation/6x10_Q8_3x3_varied_0.05": "6 x 10 Q8, varied",
}  # fmt: skip
*_, FINEST, QUADRATIC = MESHES
#: The mesh of Guo and Zhao's Fig. 15 and 17, and the axial strains of its fabric (Fig. 18).
LOCAL, FABRIC = "localisation/10x15_Q4_2x2", (0.04, 0.048)
#: Cells that stand for what is outside the band, inside, and at the edge where points fail.
PLACES = ("outside", "inside", "edge")
FIELDS = ("deviatoric_strain", "void_ratio", "fabric_anisotropy")


def run_guo_zhao() -> None:
    if not all((RESULTS / name / "history.csv").exists() for name in MESHES):
        print("drawn as kept: benchmarks/localisation.py computes the runs anew, in hours")
        return
    kept = {}
    for name in MESHES:
        rows = np.genfromtxt(RESULTS / name / "history.csv", delimiter=",", names=True)
        columns = ("axial_strain", "stress_ratio", "volumetric_strain", "failed_points")
        kept[f"{name}/history"] = np.column_stack([rows[column] for column in columns])
        kept[f"{name}/corners"], fields = fields_of(name, -1)
        kept[f"{name}/end"] = fields
        kept[f"{name}/failed"], kept[f"{name}/points"] = failed_points(name)
    strains = kept[f"{LOCAL}/history"][:, 0]
    for strain in FABRIC:
        step = int(np.abs(strains - strain).argmin()) + 1
        kept[f"fabric_{strain}/corners"], fields = fields_of(LOCAL, step)
        kept[f"fabric_{strain}"] = fields[:, 2]
    kept |= local_responses(len(strains))
    np.savez_compressed(
        FIGURES / "guo_zhao.npz", **{k: np.asarray(v, np.float32) for k, v in kept.items()}
    )


def files(name: str) -> list:
    return sorted((RESULTS / name / "biaxial_fields").glob("0*.h5"))


def fields_of(name: str, step: int) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the deformed cells (c, 4, 2) and `FIELDS` (c, 3) behind a step; -1: the last."""
    mesh = RESULTS / name / "biaxial_fields" / "mesh.h5"
    with h5py.File(mesh) as mesh, h5py.File(files(name)[step]) as fields:
        x = mesh["geometry"][:, :2] + fields["displacement"][:, :2]
        return x[mesh["topology"][:, :4]], np.stack([fields[f][:, 0] for f in FIELDS], axis=1)


def failed_points(name: str) -> tuple[np.ndarray, int]:
    """Places of the points that carry no load at the end (n, 2), and how many points there are."""
    saved = max((RESULTS / name / "checkpoint").glob("step_*")) / "rank_0000.h5"
    with h5py.File(saved) as file:
        contacts, grains = file["law/outcome/contacts"][()], file["law/position"].shape[2]
        corners = file["problem/geometry"][:, :4, :2]
    failed = contacts < FAILED_CONTACTS_PER_GRAIN * grains
    kind, rule = name.split("/")[1].split("_")[1:3]
    one = element(kind, rule)
    r, s = _dolfinx.quadrature_rule(one.cell, one.quadrature_degree)[0].T
    shape = np.stack([(1 - r) * (1 - s), r * (1 - s), (1 - r) * s, r * s], axis=1)
    points = np.einsum("qk,cki->cqi", shape, corners).reshape(-1, 2)
    return points[failed], len(contacts)


def local_responses(steps: int) -> dict[str, np.ndarray]:
    """Strain, mean pressure, deviator, void ratio and fabric of three cells along the way."""
    order = fields_of(LOCAL, -1)[1][:, 0].argsort()
    with h5py.File(files(LOCAL)[-1]) as fields:
        weakest = fields["coordination_number"][:, 0].argmin()
    cells = [order[len(order) // 10], order[-len(order) // 50], weakest]
    histories = np.zeros((steps + 1, len(cells), 5))
    for step, path in enumerate(files(LOCAL)[: steps + 1]):
        with h5py.File(path) as fields:
            stress = -fields["stress"][()][cells].reshape(-1, 3, 3)[:, :2, :2]
            histories[step, :, 0] = fields["deviatoric_strain"][:, 0][cells]
            histories[step, :, 1] = 0.5 * np.trace(stress, axis1=1, axis2=2)
            half = 0.5 * (stress[:, 0, 0] - stress[:, 1, 1])
            histories[step, :, 2] = np.hypot(half, stress[:, 0, 1])
            histories[step, :, 3] = fields["void_ratio"][:, 0][cells]
            histories[step, :, 4] = fields["fabric_anisotropy"][:, 0][cells]
    return {"local": histories, "local_places": fields_of(LOCAL, -1)[0][cells].mean(1)}


@matplotlib.rc_context(plotting.STYLE)
def draw_guo_zhao() -> None:
    kept = np.load(FIGURES / "guo_zhao.npz")
    figure = Figure((9.0, 6.2), layout="constrained")
    above, below = figure.subfigures(2, 1, height_ratios=[1, 1.25])
    left, *local = above.subplots(1, 4)
    for name, title in MESHES.items():
        strain, ratio = kept[f"{name}/history"][:, :2].T
        left.plot(100 * strain, ratio, label=title)
    left.set(xlabel="axial strain (%)", ylabel="stress ratio", ylim=(1, 3))
    left.legend(fontsize="x-small")
    for k, place in enumerate(PLACES):
        strain, p, q, void_ratio, fabric = kept["local"][:, k].T
        local[0].plot(p / 1e3, q / 1e3, lw=0.9, label=place)
        local[1].plot(100 * strain, void_ratio, lw=0.9)
        local[2].plot(100 * strain, fabric, lw=0.9)
    local[0].set(xlabel="mean pressure p (kPa)", ylabel="deviator q (kPa)")
    local[1].set(xlabel="$\\varepsilon_q$ (%)", ylabel="void ratio")
    local[2].set(xlabel="$\\varepsilon_q$ (%)", ylabel="fabric anisotropy", ylim=(0, 0.7))
    local[0].legend(fontsize="x-small")
    _maps(below.subplots(1, 6), kept)
    figure.savefig(FIGURES / "guo_zhao.png", dpi=110)


def _maps(axes, kept) -> None:
    corners, end = kept[f"{LOCAL}/corners"], kept[f"{LOCAL}/end"]
    fine, finest = kept[f"{FINEST}/corners"], kept[f"{FINEST}/end"]
    q8, strain = kept[f"{QUADRATIC}/corners"], kept[f"{QUADRATIC}/end"]
    panels = [
        (corners, end[:, 0], "10 x 15\n$\\varepsilon_q$"),
        (corners, end[:, 1], "10 x 15\nvoid ratio"),
        *[
            (kept[f"fabric_{s}/corners"], kept[f"fabric_{s}"], f"10 x 15, {100 * s:.1f} %\nfabric")
            for s in FABRIC
        ],
        (fine, finest[:, 0], "12 x 20, varied\n$\\varepsilon_q$"),
        (q8, strain[:, 0], "6 x 10 Q8, varied\n$\\varepsilon_q$"),
    ]
    for one, (cells, values, title) in zip(axes, panels, strict=True):
        patches = PolyCollection(cells, array=values, cmap="viridis", lw=0)
        one.add_collection(patches)
        one.autoscale()
        one.set(aspect="equal", xticks=[], yticks=[])
        one.spines[:].set_visible(False)
        one.set_title(title, fontsize="small")
        one.figure.colorbar(patches, ax=one, location="bottom", shrink=0.9)
    axes[1].plot(*kept[f"{LOCAL}/failed"].T, "r.", ms=2)


ALL = {"guo_zhao": (run_guo_zhao, draw_guo_zhao)}
