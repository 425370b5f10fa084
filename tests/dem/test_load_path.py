"""A path from a CSV file: what it says, and what is refused."""

import numpy as np
import pytest

from femxdem_fenicsx.dem.load_path import INCREMENTS, read_path


def written(tmp_path, text: str):
    path = tmp_path / "path.csv"
    path.write_text(text)
    return path


def test_strain_stress_and_shear_have_their_signs_and_places(tmp_path):
    text = "strain_yy,stress_xx_Pa,gamma_xy,increments\n# a remark\n0.01,1e5,0.02,4\n0.02,2e5,0,5\n"
    first, second = read_path(written(tmp_path, text), 2)
    np.testing.assert_array_equal(first.controlled, [[True, False], [False, False]])
    np.testing.assert_array_equal(first.strained, [[False, True], [False, True]])
    np.testing.assert_allclose(first.deformation, [[1.0, 0.02], [0.0, 0.99]])
    assert first.stress[0, 0] == -1e5 and first.increments == 4
    assert second.stress[0, 0] == -2e5 and second.increments == 5


def test_a_component_may_go_from_strain_to_stress_control(tmp_path):
    text = "strain_zz,stress_zz_Pa,tau_xz_Pa\n0.01,,2e4\n,3e5,0\n"
    first, second = read_path(written(tmp_path, text), 3)
    assert first.strained[2, 2] and not first.controlled[2, 2] and first.increments == INCREMENTS
    assert second.controlled[2, 2] and not second.strained[2, 2]
    assert first.controlled[0, 2] and first.stress[0, 2] == 2e4


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (
            "strain_xx,strain_yy\n0.01,0.01\n,0.02\n",
            "row 2 .* there is a gap, 'strain_xx' is empty",
        ),
        ("strain_xx,strain_yy\n0.01,0.01\n0.02\n", "row 2 .* 1 cells, there are 2 columns"),
        ("strain_xx\nnan\n", "strain_xx must be a finite number"),
        ("stress_xx_Pa\ninf\n", "stress_xx_Pa must be a finite number"),
        ("strain_xx\none\n", "strain_xx is no number: 'one'"),
        ("strain_xx,pressure\n0.01,1e5\n", "unknown column 'pressure'; choose from strain_xx"),
        ("strain_zz\n0.01\n", "unknown column 'strain_zz'"),
        ("strain_xx,strain_xx\n0.01,0.01\n", "two columns 'strain_xx'"),
        ("strain_xx,stress_xx_Pa\n0.01,1e5\n", "both 'strain_xx' and 'stress_xx_Pa'"),
        ("strain_xx,increments\n0.01,2.5\n", "whole number"),
        ("strain_xx,increments\n0.01,0\n", "whole number"),
        ("strain_xx,increments\n0.01,\n", "increments must be a finite number"),
        ("strain_xx\n1.0\n", "leaves nothing of the box"),
        ("increments\n5\n", "no column prescribes"),
        ("strain_xx\n", "one row or more"),
        ("", "one row or more"),
    ],
)
def test_a_file_that_is_no_path_is_refused_with_the_place(tmp_path, text, complaint):
    path = written(tmp_path, text)
    with pytest.raises(ValueError, match=complaint) as error:
        read_path(path, 2)
    assert str(path) in str(error.value) and "\n" not in str(error.value)


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"none\.csv: cannot read the path"):
        read_path(tmp_path / "none.csv", 2)
