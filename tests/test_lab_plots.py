"""What the laboratory's pictures show, number by number."""

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure

from femxdem_fenicsx import lab_plots
from femxdem_fenicsx.dem.probes import Envelope
from femxdem_fenicsx.dem.structure import contact_numbers
from tests.dem.scenes import cubic, hexagonal


def bars(axes) -> np.ndarray:
    return np.array([patch.get_height() for patch in axes.patches])


def test_contact_numbers_are_shares_of_the_grains():
    packing = hexagonal()
    radii = packing.radii.copy()
    radii[8] *= 0.9
    packing = packing.but(radii=radii)
    axes = Figure().subplots()
    lab_plots.draw_contact_numbers(axes, [("one", packing), ("two", hexagonal())])
    heights = bars(axes).reshape(2, -1)
    np.testing.assert_allclose(heights.sum(1), 100)
    share = np.bincount(contact_numbers(packing)) / packing.size
    np.testing.assert_allclose(heights[0], 100 * share)
    assert heights[1][6] == 100 and len(axes.get_legend().get_texts()) == 2


def test_normals_of_spheres_have_a_density_that_integrates_to_one(tmp_path, figures):
    path = tmp_path / "spheres.png"
    lab_plots.save_packing_picture(path, cubic(), "spheres")
    assert np.ptp(matplotlib.image.imread(path)[..., :3]) > 0.5
    polar, histogram = figures[0].axes
    edges = np.linspace(0, np.pi / 2, lab_plots.CLASSES + 1)
    solid = 4 * np.pi * -np.diff(np.cos(edges))
    assert (bars(polar) * solid).sum() == pytest.approx(1.0)
    _, fit = polar.lines[0].get_data()
    np.testing.assert_allclose(fit, 1 / (4 * np.pi))  # an isotropic fabric
    assert bars(histogram)[6] == 100


def row(strain: float, dim: int = 2) -> dict[str, float]:
    axis = "yy" if dim == 2 else "zz"
    plane = "xy" if dim == 2 else "xz"
    return {
        f"strain_{axis}": strain, f"gamma_{plane}": 2 * strain, "stress_xx_Pa": 1e5,
        "stress_yy_Pa": 1e5 + 1e7 * strain, f"stress_{axis}_Pa": 1e5 + 1e7 * strain,
        f"tau_{plane}_Pa": 5e6 * strain, "volumetric_strain": -strain, "pressure_Pa": 1e5,
        "void_ratio": 0.2 - strain, "coordination_number": 4.0, "fabric_anisotropy": 0.1,
    }  # fmt: skip


@pytest.mark.parametrize("dim", [2, 3])
def test_tests_are_drawn_in_per_cent_and_kilopascal(tmp_path, figures, dim):
    rows = [row(strain, dim) for strain in np.linspace(0, 0.02, 5)]
    lab_plots.save_compression_test(tmp_path / "a.png", rows)
    lab_plots.save_shear_test(tmp_path / "b.png", rows)
    lab_plots.save_consolidation(tmp_path / "c.png", rows)
    compression, shear, consolidation = (figure.axes for figure in figures)
    x, y = compression[0].lines[0].get_data()
    np.testing.assert_allclose(x, [0, 0.5, 1.0, 1.5, 2.0])
    np.testing.assert_allclose(y, [100, 150, 200, 250, 300])
    x, y = shear[0].lines[0].get_data()
    np.testing.assert_allclose((x[-1], y[-1]), (4.0, 100.0))
    assert shear[3].get_ylabel().startswith("volumetric strain")
    np.testing.assert_allclose(consolidation[0].lines[0].get_ydata(), [0.2 - s for s in x / 200])


def test_an_envelope_is_closed(tmp_path, figures):
    circle = np.column_stack([np.cos(np.arange(8)), np.sin(np.arange(8))])
    found = Envelope(1e-4 * circle, 1e3 * circle)
    lab_plots.save_envelope(tmp_path / "a.png", found, Envelope(1e-4 * circle, 2e3 * circle))
    for axes, scale in zip(figures[0].axes, (1.0, 1.0), strict=True):
        curve = axes.lines[0].get_xydata()
        np.testing.assert_allclose(curve, scale * np.vstack([circle, circle[:1]]))
    np.testing.assert_allclose(figures[0].axes[1].lines[1].get_xydata()[:8], 2 * circle)
