"""Pictures of the laboratory: packings, element tests, response envelopes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from .dem.homogenisation import fabric, touching
from .dem.packing import Packing
from .dem.probes import Envelope
from .dem.structure import contact_numbers, rattlers
from .plotting import COLOURS, STYLE, draw_packing, draw_rose, save

#: Classes of the angle between a contact normal and the vertical axis, in 3D.
CLASSES = 18


def draw_contact_numbers(axes: Axes, packings: Sequence[tuple[str, Packing]]) -> None:
    """Share of the grains with 0, 1, 2, ... contacts (Guo-Zhao fig. 3), side by side."""
    numbers = [contact_numbers(packing) for _, packing in packings]
    most = max(int(z.max()) for z in numbers)
    width = 0.85 / len(packings)
    for k, ((label, _), z) in enumerate(zip(packings, numbers, strict=True)):
        place = np.arange(most + 1) + (k - 0.5 * (len(packings) - 1)) * width
        share = np.bincount(z, minlength=most + 1) / len(z)
        axes.bar(place, 100 * share, width, color=COLOURS[k % len(COLOURS)], label=label)
    axes.set_xlabel("contacts of a grain")
    axes.set_ylabel("grains (%)")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    if len(packings) > 1:
        axes.legend(fontsize="small", handlelength=0.8, loc="upper right", borderaxespad=0)
        axes.margins(y=0.25)


@matplotlib.rc_context(STYLE)
def save_packing_picture(path: str | Path, packing: Packing, title: str | None = None) -> None:
    """Grains with force chains, rose of contact normals with its fit, contact numbers.

    Of spheres there is no picture of the grains (see `paraview`), and the rose becomes the density
    of normals over their angle to the vertical axis.
    """
    if packing.dim == 2:
        figure = Figure((7.0, 3.6), layout="constrained")
        grid = figure.add_gridspec(2, 2, width_ratios=[1.7, 1])
        draw_packing(figure.add_subplot(grid[:, 0]), packing, title, colour_bar=True)
        rose = figure.add_subplot(grid[0, 1], projection="polar")
        draw_rose(rose, packing)
        rose.set_ylabel("contact normals (1/rad)", labelpad=18)
        histogram = figure.add_subplot(grid[1, 1])
    else:
        figure = Figure((6.4, 2.5), layout="constrained")
        polar, histogram = figure.subplots(1, 2)
        _draw_polar_angles(polar, packing)
        if title:
            figure.suptitle(title)
    draw_contact_numbers(histogram, [("", packing)])
    share = rattlers(packing).mean()
    z = contact_numbers(packing)
    histogram.annotate(
        f"mean {z.mean():.2f}\nrattlers {share:.1%}", (0.98, 0.96), xycoords="axes fraction",
        ha="right", va="top", size="small",
    )  # fmt: skip
    save(figure, path)


def _draw_polar_angles(axes: Axes, packing: Packing) -> None:
    """Density of contact normals (1/sr) over their angle to the last axis, with the fabric's fit.

    The fit is E(n) = (1 + F_a : n n) / 4 pi with F_a = 15/2 (phi - I / 3), mean over all azimuths.
    """
    contacts = touching(packing)
    if len(contacts.pairs) == 0:
        axes.set_xlabel("no contacts")
        return
    edges = np.linspace(0, np.pi / 2, CLASSES + 1)
    angle = np.arccos(np.clip(np.abs(contacts.normals[:, -1]), 0, 1))
    count, _ = np.histogram(angle, edges)
    solid = 4 * np.pi * -np.diff(np.cos(edges))  # of both hemispheres
    axes.bar(
        np.degrees(edges[:-1]), count / len(angle) / solid, np.degrees(np.diff(edges)),
        align="edge", color="0.82", edgecolor="w", lw=0.4,
    )  # fmt: skip
    F = np.diag(7.5 * (fabric(contacts) - np.eye(3) / 3))
    theta = np.linspace(0, np.pi / 2, 91)
    fit = 1 + F[2] * np.cos(theta) ** 2 + 0.5 * (F[0] + F[1]) * np.sin(theta) ** 2
    axes.plot(np.degrees(theta), fit / (4 * np.pi), color=COLOURS[1])
    axes.set_xlabel("angle to the vertical axis (degrees)")
    axes.set_ylabel("contact normals (1/sr)")


def _column(rows: Sequence[dict[str, float]], name: str) -> np.ndarray:
    return np.array([row[name] for row in rows])


def _drains(rows: Sequence[dict[str, float]]) -> bool:
    return np.ptp(_column(rows, "volumetric_strain")) > 1e-9


@matplotlib.rc_context(STYLE)
def save_compression_test(path: str | Path, rows: Sequence[dict[str, float]]) -> None:
    """Stress and volume over axial strain, stress path, coordination number and fabric.

    Mean pressure takes the place of a volume that is constant.
    """
    axis = "zz" if "strain_zz" in rows[0] else "yy"
    strain = 100 * _column(rows, f"strain_{axis}")
    axial = 1e-3 * _column(rows, f"stress_{axis}_Pa")
    lateral = 1e-3 * _column(rows, "stress_xx_Pa")
    figure = Figure((6.6, 4.4), layout="constrained")
    (stress, way), (volume, micro) = figure.subplots(2, 2)
    stress.plot(strain, axial, color=COLOURS[0], label="axial")
    if axis == "zz":
        second = 1e-3 * _column(rows, "stress_yy_Pa")
        stress.plot(strain, second, color=COLOURS[2], lw=1.0, label="second lateral")
    stress.plot(strain, lateral, color=COLOURS[1], lw=1.0, label="lateral")
    stress.legend()
    stress.set_ylabel("stress (kPa),\ncompression positive")
    if _drains(rows):
        volume.plot(strain, 100 * _column(rows, "volumetric_strain"), color=COLOURS[0])
        volume.axhline(0.0, color="0.7", lw=0.5, zorder=1)
        volume.set_ylabel("volumetric strain (%),\ndilation positive")
    else:
        volume.plot(strain, 1e-3 * _column(rows, "pressure_Pa"), color=COLOURS[0])
        volume.set_ylabel("mean pressure (kPa)")
        volume.set_ylim(bottom=0)
    volume.set_xlabel("axial strain (%)")
    way.plot(1e-3 * _column(rows, "pressure_Pa"), axial - lateral, color=COLOURS[0])
    way.set_xlabel("mean pressure (kPa)")
    way.set_ylabel("axial − lateral stress (kPa)")
    way.set_xlim(left=0)
    _draw_micro(micro, strain, rows)
    micro.set_xlabel("axial strain (%)")
    save(figure, path)


def _draw_micro(axes: Axes, x: np.ndarray, rows: Sequence[dict[str, float]]) -> None:
    axes.plot(x, _column(rows, "coordination_number"), color=COLOURS[0])
    axes.set_ylabel("coordination number", color=COLOURS[0])
    other = axes.twinx()
    other.spines["right"].set_visible(True)
    other.plot(x, _column(rows, "fabric_anisotropy"), color=COLOURS[1], lw=1.0)
    other.set_ylabel("fabric anisotropy $F_a$", color=COLOURS[1])


@matplotlib.rc_context(STYLE)
def save_shear_test(path: str | Path, rows: Sequence[dict[str, float]]) -> None:
    """Shear stress over gamma and over vertical stress (Guo-Zhao fig. 20), pressure and volume."""
    dim = 3 if "strain_zz" in rows[0] else 2
    plane, vertical = ("xz", "zz") if dim == 3 else ("xy", "yy")
    gamma = 100 * _column(rows, f"gamma_{plane}")
    tau = 1e-3 * _column(rows, f"tau_{plane}_Pa")
    normal = 1e-3 * _column(rows, f"stress_{vertical}_Pa")
    way = np.append(0.0, np.cumsum(np.abs(np.diff(gamma))))
    figure = Figure((6.6, 4.4), layout="constrained")
    (loop, path_axes), (pressure, volume) = figure.subplots(2, 2)
    loop.plot(gamma, tau, color=COLOURS[0], lw=0.9)
    loop.set_xlabel(f"shear strain $\\gamma_{{{plane}}}$ (%)")
    loop.set_ylabel("shear stress (kPa)")
    path_axes.plot(normal, tau, color=COLOURS[0], lw=0.9)
    path_axes.set_xlabel("vertical stress (kPa), compression positive")
    path_axes.set_ylabel("shear stress (kPa)")
    path_axes.set_xlim(left=min(0, normal.min()))
    pressure.plot(way, 1e-3 * _column(rows, "pressure_Pa"), color=COLOURS[0])
    pressure.set_ylabel("mean pressure (kPa)")
    pressure.set_ylim(bottom=0)
    if _drains(rows):
        volume.plot(way, 100 * _column(rows, "volumetric_strain"), color=COLOURS[0])
        volume.set_ylabel("volumetric strain (%),\ndilation positive")
    else:
        _draw_micro(volume, way, rows)
    for axes in (pressure, volume):
        axes.set_xlabel("accumulated shear strain (%)")
    save(figure, path)


@matplotlib.rc_context(STYLE)
def save_consolidation(path: str | Path, rows: Sequence[dict[str, float]]) -> None:
    """Void ratio and the stresses over mean pressure, of isotropic and oedometric compression."""
    axis = "zz" if "strain_zz" in rows[0] else "yy"
    figure = Figure((6.6, 2.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    pressure = 1e-3 * _column(rows, "pressure_Pa")
    left.plot(pressure, _column(rows, "void_ratio"), "o-", ms=2.5, color=COLOURS[0])
    left.set(xscale="log", xlabel="mean pressure (kPa)", ylabel="void ratio")
    if pressure.max() < 10 * pressure.min():  # a logarithmic axis labels decades
        left.set_xscale("linear")
    strain = 100 * _column(rows, f"strain_{axis}")
    right.plot(strain, 1e-3 * _column(rows, f"stress_{axis}_Pa"), color=COLOURS[0], label="axial")
    lateral = 1e-3 * _column(rows, "stress_xx_Pa")
    right.plot(strain, lateral, color=COLOURS[1], lw=1.0, label="lateral")
    right.set(xlabel="axial strain (%)", ylabel="stress (kPa),\ncompression positive")
    right.legend()
    save(figure, path)


@matplotlib.rc_context(STYLE)
def save_envelope(
    path: str | Path, envelope: Envelope, upper_bound: Envelope | None = None
) -> None:
    """Strain probes and their stress answers, or the other way round (Gudehus 1979).

    upper_bound: what the same packing would answer if all grains followed the strain (UKO).
    """
    figure = Figure((7.4, 3.0), layout="constrained")
    axes = figure.subplots(1, 2)
    for k, (name, unit, of) in enumerate(
        (("strain", "", "strain"), ("stress", " (kPa)", "stress"))
    ):
        scale = 1e-3 if name == "stress" else 1e4
        unit = unit or " ($10^{-4}$)"
        values = scale * getattr(envelope, of)
        closed = np.concatenate([values, values[:1]])
        axes[k].plot(*closed.T, "o-", ms=3, color=COLOURS[0], lw=1.0, label="grains")
        if upper_bound is not None:
            bound = scale * getattr(upper_bound, of)
            bound = np.concatenate([bound, bound[:1]])
            axes[k].plot(*bound.T, color=COLOURS[1], ls="--", lw=1.0, label="upper bound (UKO)")
        axes[k].plot(0, 0, "+", color="0.4")
        axes[k].set(xlabel=f"lateral {name}{unit}", ylabel=f"axial {name}{unit}", aspect="equal")
    if upper_bound is not None:
        axes[1].legend(fontsize="small", loc="upper left", bbox_to_anchor=(1.0, 1.0))
    save(figure, path)
