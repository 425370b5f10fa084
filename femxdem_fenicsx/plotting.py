"""Pictures: packings with their force chains, roses of contact normals, curves, fields.

Nothing here touches pyplot: figures are objects of their own, drawn without a display. Files are
written in the format of their name's ending (png, pdf, svg, ...).
"""

from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, PolyCollection
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline
from matplotlib.ticker import MaxNLocator

from .dem.homogenisation import Contacts, coordination_number, fabric, fabric_anisotropy, touching
from .dem.packing import Packing
from .writing import aside

STYLE = {
    "font.family": "sans-serif",
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "legend.frameon": False,
    "lines.linewidth": 1.4,
    "savefig.dpi": 150,
    "savefig.bbox": "tight",
    "savefig.pad_inches": 0.03,
    "pdf.fonttype": 42,
}
#: Colours of curves, told apart by colour-blind readers too (Okabe and Ito); the first is ours.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00")
DASHES = ("--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)))
#: Width of the bar that carries the largest force, as a share of the mean grain diameter.
WIDEST_CHAIN = 0.8
#: Weak to strong forces, dark enough on grey grains; blue for contacts that pull (cohesion).
FORCES = LinearSegmentedColormap.from_list(
    "forces", matplotlib.colormaps["inferno_r"](np.linspace(0.2, 0.92, 64))
).with_extremes(under="#3B6FB6")

#: (label, axial strain, stress ratio, volumetric strain or None): see `save_history`.
Curve = tuple[str, np.ndarray, np.ndarray, np.ndarray | None]


def fourier_fit(phi: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """E(theta) = (1 + F_a : n (x) n) / 2 pi, the density of contact normals by the fabric alone.

    phi (2, 2) fabric; theta (k,) rad; E (k,) per rad (Guo-Zhao eq. 23-24).
    """
    n = np.stack([np.cos(theta), np.sin(theta)])
    return (1.0 + np.einsum("ij,ik,jk->k", 4.0 * (phi - np.eye(2) / 2), n, n)) / (2 * np.pi)


def rose(normals: np.ndarray, bins: int = 36) -> tuple[np.ndarray, np.ndarray]:
    """Bin edges (bins + 1,) rad and density (bins,) per rad of contact normals (C, 2).

    Every contact counts twice, as n and as -n, so an even number of `bins` gives a symmetric rose;
    the density integrates to 1, or is 0 without contacts.
    """
    both = np.concatenate([normals, -normals])
    angles = np.arctan2(both[:, 1], both[:, 0]) % (2 * np.pi)
    count, edges = np.histogram(angles, bins, (0.0, 2 * np.pi))
    return edges, count / (max(len(both), 1) * 2 * np.pi / bins)


def draw_packing(
    axes: Axes,
    packing: Packing,
    title: str | None = None,
    largest_force: float | None = None,
    colour_bar: bool = False,
) -> PolyCollection:
    """Draw one packing, cut out along its box, with its force chains (Guo-Zhao fig. 16a).

    A chain joins the centres of every contact; its width is proportional to the normal force and
    its colour follows it. Contacts that pull (cohesion) are blue.

    Args:
        axes: where; its limits are set to the box, its frame is taken away.
        packing: what; one without contacts is drawn too.
        title: above the picture.
        largest_force: N, the force that gets the widest bar and the top of the colour scale, so
            that packings can be compared; by default the largest of this packing.
        colour_bar: whether to put one beside the picture.

    Returns:
        the chains, weakest first: forces in N by `get_array()`, ready for `figure.colorbar`.
    """
    contacts = touching(packing)
    if largest_force is None:
        largest_force = np.abs(contacts.normal_force).max(initial=0.0)
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]]) @ packing.box.T
    outline = PathPatch(Outline(corners), facecolor="none", edgecolor="0.25", lw=0.7, zorder=3)
    axes.add_patch(outline)
    grains = _grains(axes, packing)
    chains = _chains(packing, contacts, largest_force or 1.0)
    for collection in (grains, chains):
        axes.add_collection(collection, autolim=False)
        collection.set_clip_path(outline)
    _scale_bar(axes, corners, 6 * packing.mean_diameter)
    axes.autoscale_view()
    axes.set_aspect("equal")
    axes.set_axis_off()
    if title:
        axes.set_title(title)
    if colour_bar:
        axes.figure.colorbar(chains, ax=axes, label="normal force (N)", shrink=0.8)
    return chains


def _grains(axes: Axes, packing: Packing) -> EllipseCollection:
    """Every grain that reaches into the box, images across its sides included."""
    reach = packing.radii[:, None] * np.linalg.norm(np.linalg.inv(packing.box), axis=1)
    wrapped = packing.positions % 1.0
    k, shift = _images(wrapped - reach, wrapped + reach)
    diameters = 2 * packing.radii[k]
    return EllipseCollection(
        diameters, diameters, np.zeros(len(k)), units="xy",
        offsets=(wrapped[k] + shift) @ packing.box.T, offset_transform=axes.transData,
        facecolor="0.9", edgecolor="0.65", linewidth=0.3, zorder=1,
    )  # fmt: skip


def _chains(packing: Packing, contacts: Contacts, largest_force: float) -> PolyCollection:
    """One bar along the branch vector of every contact, as wide as its normal force is large."""
    start = packing.positions[contacts.pairs[:, 0]] % 1.0
    end = start + contacts.branches @ np.linalg.inv(packing.box).T
    k, shift = _images(np.minimum(start, end), np.maximum(start, end))
    weakest_first = np.argsort(np.abs(contacts.normal_force[k]), kind="stable")
    k, shift = k[weakest_first], shift[weakest_first]
    force = contacts.normal_force[k]
    a, b = (start[k] + shift) @ packing.box.T, (end[k] + shift) @ packing.box.T
    half = 0.5 * WIDEST_CHAIN * packing.mean_diameter * np.abs(force) / largest_force
    side = half[:, None] * np.column_stack([-contacts.normals[k, 1], contacts.normals[k, 0]])
    chains = PolyCollection(
        np.stack([a - side, b - side, b + side, a + side], 1),
        array=force, cmap=FORCES, linewidth=0, zorder=2,
    )  # fmt: skip
    chains.set_clim(0.0, largest_force)
    return chains


def _images(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Number k (M,) and shift (M, 2) of all images of the extents low, high (N, 2) in the box.

    Reduced coordinates. A shift of one box is enough: no grain is wider than half a box.
    """
    shifts = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)], float)
    inside = ((low + shifts[:, None] < 1) & (high + shifts[:, None] > 0)).all(-1)
    which, k = np.nonzero(inside)
    return k, shifts[which]


def _scale_bar(axes: Axes, corners: np.ndarray, longest: float) -> None:
    """A bar of a round length, at most `longest` (m), below the box."""
    left, bottom = corners.min(0)
    decade = 10.0 ** np.floor(np.log10(longest))
    length = decade * max(f for f in (1, 2, 5) if f * decade <= longest)
    y = bottom - 0.05 * np.ptp(corners[:, 1])
    axes.plot([left, left + length], [y, y], color="0.25", lw=1.2, solid_capstyle="butt")
    axes.annotate(
        f"{1e3 * length:g} mm", (left + length, y), (4, 0), textcoords="offset points",
        va="center", size="small", color="0.25",
    )  # fmt: skip


@matplotlib.rc_context(STYLE)
def save_force_chains(path: str | Path, packings: Sequence[tuple[str, Packing]]) -> None:
    """Packings (title, packing) side by side at one scale of length and of force, roses below.

    A rose is the density of contact normals with its Fourier fit (Guo-Zhao fig. 16, eq. 23).
    ValueError without packings.
    """
    if len(packings) == 0:
        raise ValueError("save_force_chains: there are no packings to draw")
    forces = [np.abs(touching(p).normal_force).max(initial=0.0) for _, p in packings]
    width = 2.2 * len(packings) + 0.6
    figure = Figure((width, 4.4), layout="constrained")
    grid = figure.add_gridspec(2, len(packings), height_ratios=[1.35, 1])
    top = [figure.add_subplot(grid[0, k]) for k in range(len(packings))]
    for axes, (title, packing) in zip(top, packings, strict=True):
        chains = draw_packing(axes, packing, title, max(forces))
    spans = np.array([[axes.get_xlim(), axes.get_ylim()] for axes in top])
    half = 0.5 * np.ptp(spans, axis=-1).max(0)
    for axes, middle in zip(top, spans.mean(-1), strict=True):
        low, high = middle - half, middle + half
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    figure.colorbar(chains, ax=top, label="normal force (N)", shrink=0.8, aspect=25)
    bottom = [figure.add_subplot(grid[1, k], projection="polar") for k in range(len(packings))]
    for axes, (_, packing) in zip(bottom, packings, strict=True):
        draw_rose(axes, packing)
    outer = max(axes.get_ylim()[1] for axes in bottom)
    for axes in bottom:
        axes.set_ylim(0.0, outer)
    bottom[0].set_ylabel("contact normals (1/rad)", labelpad=18)
    save(figure, path)


def draw_rose(axes: Axes, packing: Packing) -> None:
    """Rose of contact normals and its Fourier fit on polar axes."""
    contacts = touching(packing)
    edges, density = rose(contacts.normals)
    axes.bar(edges[:-1], density, np.diff(edges), align="edge", color="0.82", edgecolor="w", lw=0.4)
    label = "no contacts"
    if len(contacts.pairs):
        phi, theta = fabric(contacts), np.linspace(0, 2 * np.pi, 181)
        axes.plot(theta, fourier_fit(phi, theta), color=COLOURS[1])
        z = coordination_number(packing, contacts)
        label = f"$F_a$ = {fabric_anisotropy(phi):.2f},  $z$ = {z:.2f}"
    axes.set_xlabel(label)
    axes.set_xticks(np.arange(4) * np.pi / 2)
    axes.yaxis.set_major_locator(MaxNLocator(3, prune="lower"))
    axes.set_rlabel_position(45)
    axes.tick_params(labelsize="x-small", pad=-2)
    axes.set_axisbelow("line")
    axes.grid(lw=0.3)
    axes.spines["polar"].set_linewidth(0.4)


@matplotlib.rc_context(STYLE)
def save_history(
    path: str | Path,
    axial_strain: np.ndarray,
    stress_ratio: np.ndarray,
    volumetric_strain: np.ndarray,
    others: Sequence[Curve] = (),
    label: str = "femxdem_fenicsx",
) -> None:
    """Stress ratio with its peak, and volumetric strain, over axial strain (Guo-Zhao fig. 10).

    Args:
        path: file to write.
        axial_strain: (n,) as a fraction, compression positive.
        stress_ratio: (n,) sigma_1 / sigma_3.
        volumetric_strain: (n,) as a fraction, dilation positive; drawn upward.
        others: further curves (label, axial strain, stress ratio, volumetric strain or None), each
            of its own length, to compare with.
        label: of the first curve, where there are others.

    Raises ValueError for arrays of one curve that differ in length, or are empty.
    """
    curves = [(label, axial_strain, stress_ratio, volumetric_strain), *others]
    figure = Figure((3.5, 4.0), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[1.2, 1])
    for k, (name, *values) in enumerate(curves):
        strain, ratio, volume = _curve(name, *values)
        style = {"color": COLOURS[k % len(COLOURS)], "label": name, "zorder": 3}
        if k > 0:
            style |= {"ls": DASHES[(k - 1) % len(DASHES)], "lw": 1.1, "zorder": 2}
        upper.plot(strain, ratio, **style)
        if volume is not None:
            lower.plot(strain, volume, **style)
    _mark_peak(upper, *_curve(*curves[0])[:2])
    lower.axhline(0.0, color="0.7", lw=0.5, zorder=1)
    upper.set_ylabel("stress ratio $\\sigma_1/\\sigma_3$ (–)")
    lower.set_ylabel("volumetric strain (%),\ndilation positive")
    lower.set_xlabel("axial strain (%), compression positive")
    lower.margins(x=0.0)
    if others:
        upper.legend()
    figure.align_ylabels()
    save(figure, path)


def _curve(name: str, strain, ratio, volume) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """One curve as arrays, strains in %; ValueError where their lengths do not agree."""
    strain, ratio = 100 * np.asarray(strain, float), np.asarray(ratio, float)
    volume = None if volume is None else 100 * np.asarray(volume, float)
    shapes = [x.shape for x in (strain, ratio, volume) if x is not None]
    if strain.ndim != 1 or strain.size == 0 or len(set(shapes)) > 1:
        raise ValueError(
            f"save_history: the arrays of {name!r} have shapes {shapes}, expected (n,)"
        )
    return strain, ratio, volume


def _mark_peak(axes: Axes, strain: np.ndarray, ratio: np.ndarray) -> None:
    """Mark the largest stress ratio; strain in %."""
    if np.isnan(ratio).all():
        return
    top = np.nanargmax(ratio)
    axes.plot(strain[top], ratio[top], "o", ms=4, mfc="w", mec=COLOURS[0], zorder=4)
    axes.annotate(
        f"peak {ratio[top]:.2f} at {strain[top]:.1f} %", (strain[top], ratio[top]), (0, 5),
        textcoords="offset points", ha="center", va="bottom", size="small", color=COLOURS[0],
    )  # fmt: skip
    axes.margins(y=0.12)


@matplotlib.rc_context(STYLE)
def save_fields(
    path: str | Path, corners: np.ndarray, fields: Sequence[tuple[str, np.ndarray]]
) -> None:
    """One value per cell, drawn on the deformed mesh, one panel per field.

    Args:
        path: file to write.
        corners: (n_cells, k, 2) m, k >= 3 points in order around each cell (its corners; with the
            nodes on the edges between them for curved ones).
        fields: (label with unit, values (n_cells,)); cells that are not finite stay grey.

    Raises ValueError for no fields and for shapes that do not fit.
    """
    corners = np.asarray(corners, float)
    if corners.ndim != 3 or corners.shape[0] == 0 or corners.shape[1] < 3 or corners.shape[2] != 2:
        raise ValueError(f"save_fields: corners has shape {corners.shape}, expected (n, k >= 3, 2)")
    if len(fields) == 0:
        raise ValueError("save_fields: there are no fields to draw")
    low, high = corners.min((0, 1)), corners.max((0, 1))
    width, height = high - low
    panel = np.clip(3.0 * width / height, 1.2, np.clip(7.0 / len(fields), 1.6, 3.2))
    size = (panel * len(fields) + 0.6, panel * height / width + 1.0)
    figure = Figure(size, layout="constrained")
    row = figure.subplots(1, len(fields), sharex=True, sharey=True, squeeze=False)[0]
    for axes, (label, values) in zip(row, fields, strict=True):
        values = np.ma.masked_invalid(np.asarray(values, float))
        if values.shape != corners.shape[:1]:
            raise ValueError(
                f"save_fields: {label!r} has shape {values.shape}, expected {corners.shape[:1]}"
            )
        cmap = matplotlib.colormaps["viridis"].with_extremes(bad="0.85")
        cells = PolyCollection(corners, array=values, cmap=cmap, edgecolor="face", linewidth=0.5)
        axes.add_collection(cells)
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xlabel="x (m)")
        axes.xaxis.set_major_locator(MaxNLocator(max(3, int(2 * panel)), steps=[1, 2, 5, 10]))
        axes.spines[["left", "bottom"]].set_position(("outward", 3))
        bar = figure.colorbar(cells, ax=axes, location="top", label=label, aspect=panel / 0.1)
        bar.locator = MaxNLocator(3)
        bar.outline.set_linewidth(0.4)
        bar.update_ticks()
    row[0].set_ylabel("y (m)")
    save(figure, path)


def save(figure: Figure, path: str | Path) -> None:
    """Write the picture, aside first; folders that are missing are made."""
    with aside(path) as beside:
        figure.savefig(beside)
