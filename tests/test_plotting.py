"""What the pictures show, number by number; how they look is for the eye."""

import matplotlib
import numpy as np
import pytest
from matplotlib.collections import EllipseCollection, PolyCollection
from matplotlib.figure import Figure

from femxdem_fenicsx import plotting
from femxdem_fenicsx.dem import LinearContact, Packing
from femxdem_fenicsx.dem.homogenisation import fabric, touching

SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
LAW = LinearContact(modulus=6e8)


def hexagonal(columns: int = 6, rows: int = 4, radius: float = 5e-3, law=LAW) -> Packing:
    """Rows of disks that overlap a little, some of them more than others."""
    i, j = np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij")
    s = np.stack([(i + 0.5 * (j % 2)) / columns, j / rows], -1).reshape(-1, 2)
    box = np.diag([2 * radius * columns, np.sqrt(3) * radius * rows])
    radii = radius * np.random.default_rng(3).uniform(1.0005, 1.005, columns * rows)
    return Packing(box, s, radii, law)


def loose() -> Packing:
    packing = hexagonal()
    return packing.but(radii=0.8 * packing.radii)


def written(path) -> bool:
    """The file holds a picture with more than one colour."""
    return np.ptp(matplotlib.image.imread(path)[..., :3]) > 0.5


def one(axes, kind):
    (found,) = [c for c in axes.collections if isinstance(c, kind)]
    return found


def test_force_chains_are_as_wide_as_the_normal_forces():
    packing = hexagonal()
    largest = 2 * touching(packing).normal_force.max()
    chains = plotting.draw_packing(Figure().subplots(), packing, "title", largest)
    force = chains.get_array()
    corners = np.array([path.vertices[:4] for path in chains.get_paths()])
    width = np.linalg.norm(corners[:, 3] - corners[:, 0], axis=1)
    np.testing.assert_allclose(
        width, plotting.WIDEST_CHAIN * packing.mean_diameter * force / largest, rtol=1e-9
    )
    assert (np.diff(force) >= 0).all() and force[-1] == touching(packing).normal_force.max()
    assert chains.get_clim() == (0.0, largest)


def test_force_chains_join_centres_and_none_is_missing():
    packing = hexagonal().deformed(np.array([[1.0, 0.2], [0.0, 1.0]]))
    packing = packing.but(positions=packing.positions + 5.3)
    chains = plotting.draw_packing(Figure().subplots(), packing)
    assert set(touching(packing).normal_force) == set(chains.get_array())
    corners = np.array([path.vertices[:4] for path in chains.get_paths()])
    ends = np.concatenate([corners[:, [0, 3]].mean(1), corners[:, [1, 2]].mean(1)])
    apart = (ends @ np.linalg.inv(packing.box).T)[:, None] - packing.positions
    assert np.abs(apart - np.round(apart)).max(-1).min(1).max() < 1e-9


def test_grains_across_the_border_are_drawn_on_both_sides():
    packing = Packing(np.eye(2), [[0.0, 1.0], [0.5, 0.05], [0.5, 0.5]], [0.1, 0.1, 0.1], LAW)
    axes = Figure().subplots()
    plotting.draw_packing(axes, packing)
    grains = one(axes, EllipseCollection)
    drawn = {tuple(row) for row in grains.get_offsets().round(9)}
    corners = {(0, 0), (1, 0), (0, 1), (1, 1)}
    assert drawn == corners | {(0.5, 0.05), (0.5, 1.05), (0.5, 0.5)}


def test_a_packing_without_contacts_is_drawn():
    figure = Figure()
    chains = plotting.draw_packing(figure.subplots(), loose(), colour_bar=True)
    figure.canvas.draw()
    assert len(chains.get_array()) == 0


def test_contacts_that_pull_have_a_colour_of_their_own():
    overlap = 2 * hexagonal().radii.max() - 1e-2
    law = LinearContact(stiffness=1e6, cohesion=2e6 * overlap)
    chains = plotting.draw_packing(Figure().subplots(), hexagonal(law=law))
    assert (chains.get_array() < 0).all()
    colours = chains.to_rgba(chains.get_array())
    np.testing.assert_allclose(colours, np.broadcast_to(plotting.FORCES.get_under(), colours.shape))


def test_rose_and_fit_integrate_to_one_and_agree_with_the_fabric():
    normals = np.random.default_rng(1).normal(size=(5000, 2)) * (1.0, 2.0)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    edges, density = plotting.rose(normals)
    assert (density * np.diff(edges)).sum() == pytest.approx(1.0)
    np.testing.assert_allclose(density[:18], density[18:])
    phi = normals.T @ normals / len(normals)
    theta = np.linspace(0, 2 * np.pi, 721)[:-1]
    E, n = plotting.fourier_fit(phi, theta), np.stack([np.cos(theta), np.sin(theta)])
    step = theta[1]
    assert E.sum() * step == pytest.approx(1.0)
    np.testing.assert_allclose(np.einsum("k,ik,jk->ij", E, n, n) * step, phi, atol=1e-12)


def test_force_chains_share_one_scale(tmp_path, figures):
    packing = hexagonal()
    pressed = packing.deformed(np.diag([1.0, 0.99]))
    path = tmp_path / "new" / "chains.png"
    plotting.save_force_chains(path, [("initial", packing), ("pressed", pressed), ("", loose())])
    assert written(path)
    drawn = [axes for axes in figures[0].axes if axes.get_aspect() == 1 and axes.name != "polar"]
    scales = {one(axes, PolyCollection).get_clim() for axes in drawn[:3]}
    assert scales == {(0.0, touching(pressed).normal_force.max())}
    assert len({np.ptp(axes.get_xlim()).round(12) for axes in drawn[:3]}) == 1
    roses = [axes for axes in figures[0].axes if axes.name == "polar"]
    theta, E = roses[0].lines[0].get_data()
    np.testing.assert_allclose(E, plotting.fourier_fit(fabric(touching(packing)), theta))
    assert [rose.get_xlabel() for rose in roses][2] == "no contacts"


def test_no_packings_is_an_error(tmp_path):
    with pytest.raises(ValueError, match="no packings"):
        plotting.save_force_chains(tmp_path / "none.png", [])


def test_history_in_per_cent_with_the_peak_marked(tmp_path, figures):
    strain = np.linspace(0, 0.05, 51)
    ratio = 1 + 60 * strain * np.exp(-strain / 0.02)
    other = ("YADE", strain[:7], ratio[:7], None)
    path = tmp_path / "history.png"
    plotting.save_history(path, strain, ratio, -0.1 * strain, [other])
    assert written(path)
    upper, lower = figures[0].axes
    np.testing.assert_allclose(upper.lines[0].get_xydata(), np.stack([100 * strain, ratio], 1))
    np.testing.assert_allclose(lower.lines[0].get_ydata(), -10 * strain)
    (peak,) = upper.texts
    assert peak.xy == (pytest.approx(2.0), ratio.max())
    assert peak.get_text() == f"peak {ratio.max():.2f} at 2.0 %"
    assert [text.get_text() for text in upper.get_legend().texts] == ["femxdem_fenicsx", "YADE"]


@pytest.mark.parametrize("lengths", [(3, 2, 3), (3, 3, 2), (0, 0, 0)])
def test_history_refuses_curves_of_unequal_length(tmp_path, lengths):
    good, bad = [np.ones(3)] * 3, [np.ones(n) for n in lengths]
    with pytest.raises(ValueError, match=r"'femxdem_fenicsx' have shapes \[[^\n]*$"):
        plotting.save_history(tmp_path / "h.png", *bad)
    with pytest.raises(ValueError, match="'other' have shapes"):
        plotting.save_history(tmp_path / "h.png", *good, others=[("other", *bad)])
    assert not list(tmp_path.iterdir())


def test_fields_one_polygon_per_cell(tmp_path, figures):
    corners = np.concatenate([SQUARE[None] + (k, 0.0) for k in range(5)])
    corners = corners.reshape(5, 4, 2)
    values = np.array([0.1, 0.2, np.nan, 0.4, 0.5])
    path = tmp_path / "fields.png"
    plotting.save_fields(path, corners, [("void ratio (–)", values), ("p (Pa)", np.ones(5))])
    assert written(path)
    cells = [one(axes, PolyCollection) for axes in figures[0].axes[:2]]
    assert [len(c.get_paths()) for c in cells] == [5, 5]
    np.testing.assert_array_equal(cells[0].get_paths()[3].vertices[:4], corners[3])
    assert cells[0].get_clim() == (0.1, 0.5) and cells[0].get_array().mask.sum() == 1
    assert figures[0].axes[0].get_aspect() == 1


@pytest.mark.parametrize("corners", [SQUARE, SQUARE[None, :2], np.zeros((0, 4, 2))])
def test_fields_refuse_what_are_no_polygons(tmp_path, corners):
    with pytest.raises(ValueError, match=r"corners has shape [^\n]*$"):
        plotting.save_fields(tmp_path / "f.png", corners, [("e (–)", np.ones(len(corners)))])


def test_fields_refuse_values_that_do_not_fit(tmp_path):
    with pytest.raises(ValueError, match=r"'e \(–\)' has shape \(2,\), expected \(1,\)$"):
        plotting.save_fields(tmp_path / "f.png", SQUARE[None], [("e (–)", np.ones(2))])
    with pytest.raises(ValueError, match="no fields"):
        plotting.save_fields(tmp_path / "f.png", SQUARE[None], [])
    assert not list(tmp_path.iterdir())
