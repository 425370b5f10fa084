"""Grain-size distributions: the radii that are drawn have the distribution that was asked for."""

import numpy as np
import pytest

from femxdem_fenicsx.dem.grain_sizes import (
    GivenRadii,
    SieveCurve,
    UniformByNumber,
    UniformByVolume,
    read_sieve_curve,
)

CURVE = SieveCurve((2e-3, 4e-3, 8e-3), (0.0, 0.3, 1.0))


def passing(radii: np.ndarray, dim: int, diameter: float) -> float:
    """Share of the mass of grains finer than a diameter."""
    mass = radii**dim
    return mass[2 * radii < diameter].sum() / mass.sum()


def test_uniform_by_number_has_as_many_grains_of_every_radius():
    radii = UniformByNumber(1e-3, 3e-3).draw(20000, 2, np.random.default_rng(1))
    count, _ = np.histogram(radii, 10, (1e-3, 3e-3))
    assert np.abs(count / 2000 - 1).max() < 0.1


@pytest.mark.parametrize("dim", [2, 3])
def test_uniform_by_volume_has_as_much_volume_of_every_radius(dim):
    radii = UniformByVolume(1e-3, 3e-3).draw(4000, dim, np.random.default_rng(1))
    volume, _ = np.histogram(radii, 10, (1e-3, 3e-3), weights=radii**dim)
    np.testing.assert_allclose(volume / volume.sum(), 0.1, atol=2e-3)
    assert np.median(radii) < 1.8e-3  # many small ones


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("grains", [400, 4000])
def test_a_sieve_curve_is_met_by_the_mass_that_passes(dim, grains):
    radii = CURVE.draw(grains, dim, np.random.default_rng(3))
    assert radii.size == grains and 1e-3 <= radii.min() and radii.max() <= 4e-3
    for diameter in (2.5e-3, 3e-3, 4e-3, 5e-3, 7e-3):
        wanted = np.interp(np.log(diameter), np.log(CURVE.diameters), CURVE.passing)
        assert passing(radii, dim, diameter) == pytest.approx(wanted, abs=6 / grains)


def test_radii_stand_in_no_order():
    radii = CURVE.draw(400, 2, np.random.default_rng(3))
    assert abs(np.corrcoef(radii, np.arange(400))[0, 1]) < 0.2


def test_given_radii_are_these_in_their_order():
    given = tuple(np.linspace(1e-3, 2e-3, 50))
    drawn = GivenRadii(given).draw(50, 2, np.random.default_rng(0))
    np.testing.assert_array_equal(drawn, given)
    with pytest.raises(ValueError, match="50 radii are given for 40 grains"):
        GivenRadii(given).draw(40, 2, np.random.default_rng(0))


@pytest.mark.parametrize(
    ("diameters", "shares", "complaint"),
    [
        ((1e-3, 2e-3, 3e-3), (0.0, 0.6, 0.4), "passes does not increase from sieve 2 to 3"),
        ((1e-3, 2e-3, 3e-3), (0.0, 0.5, 0.5), "passes does not increase from sieve 2 to 3"),
        ((2e-3, 1e-3), (0.0, 1.0), "diameter does not increase from sieve 1 to 2"),
        ((1e-3, 2e-3), (0.1, 1.0), "from 0 to 1"),
        ((1e-3, 2e-3), (0.0, 0.9), "from 0 to 1"),
        ((1e-3,), (0.0,), "at least two sieves"),
        ((1e-3, 2e-3), (0.0, 0.5, 1.0), "at least two sieves"),
        ((-1e-3, 2e-3), (0.0, 1.0), "positive"),
        ((1e-3, 2e-3), (0.0, float("nan")), "finite"),
    ],
)
def test_a_curve_that_is_none_is_refused_in_one_line(diameters, shares, complaint):
    with pytest.raises(ValueError, match=complaint) as error:
        SieveCurve(diameters, shares)
    assert "\n" not in str(error.value)


def test_a_curve_is_read_from_a_file_in_millimetres_and_per_cent(tmp_path):
    path = tmp_path / "sieve.csv"
    path.write_text("diameter_mm,passing_percent\n# fine\n2,0\n4;30\n8,100\n")
    curve = read_sieve_curve(path)
    np.testing.assert_allclose(curve.diameters, CURVE.diameters)
    np.testing.assert_allclose(curve.passing, CURVE.passing)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("2,0\n4,60\n8,40\n", "does not increase from sieve 2 to 3"),
        ("2,0\n4\n8,100\n", "line 2: expected"),
        ("2,0\nfour,50\n8,100\n", "line 2: expected"),
        ("", "at least two sieves"),
    ],
)
def test_a_bad_file_is_refused_with_its_name_and_the_place(tmp_path, text, complaint):
    path = tmp_path / "sieve.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=complaint) as error:
        read_sieve_curve(path)
    assert str(path) in str(error.value) and "\n" not in str(error.value)
    with pytest.raises(ValueError, match="cannot read the sieve curve"):
        read_sieve_curve(tmp_path / "none.csv")
