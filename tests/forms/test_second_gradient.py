"""The second gradient against exact solutions: patches, rotations, boundary layers."""

import h5py
import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from benchmarks.inf_sup import constant
from femxdem_fenicsx.double_stress import mindlin, one_parameter
from femxdem_fenicsx.fem.convergence import Convergence
from femxdem_fenicsx.fem.elements import element
from femxdem_fenicsx.fem.external_operator import ExternalOperator
from femxdem_fenicsx.fem.problem import Problem
from femxdem_fenicsx.fem.quadrature_points import QuadraturePoints
from femxdem_fenicsx.law import LinearElastic, NeoHookean, elasticity
from forms.second_gradient import SecondGradient
from meshes import box, rectangle
from tests.fem.layer import Layer
from tests.fem.specimen import Specimen

GRADIENT = np.array([[0.03, 0.02, 0.01], [-0.01, -0.05, 0.02], [0.015, -0.02, 0.04]])
E, NU, D = 100.0, 0.3, 2.0
SHEAR = E / (2 * (1 + NU))
FORMULATIONS = [("small", LinearElastic), ("finite", NeoHookean)]


class Patch:
    """A patch whose whole boundary is displaced; `second`: for this gradient of the strain.

    Then it has the body force and the double tractions on its boundary that belong to that.
    """

    def __init__(
        self,
        name,
        formulation="small",
        law=LinearElastic,
        distortion=0.2,
        second=None,
        micro_strain="linear",
    ):
        kind = element(name)
        self.d = d = kind.dim
        if d == 2:
            domain = rectangle.rectangle(MPI.COMM_WORLD, 1.0, 2.0, 3, 4, kind, distortion)
        else:
            domain = box.box(MPI.COMM_WORLD, (1.0,) * 3, (2, 2, 2), kind, distortion / 2)
        if distortion == 0:  # parallelograms
            domain.geometry.x[:, 0] += 0.3 * domain.geometry.x[:, 1]
        self.points = QuadraturePoints(domain, kind)
        self.law = law(self.points.size, E, NU, dim=d)
        self.medium = SecondGradient(self.points, formulation, one_parameter(D, d), micro_strain)
        self.operator = ExternalOperator(
            self.medium.F, self.law, self.points, 0.5, self.medium.states
        )
        residual, jacobian = self.medium.equilibrium(self.operator.stress, self.operator.tangent)
        if second is not None:
            w, eta, _ = self.medium._fields(ufl.TestFunction(self.medium.unknown.function_space))
            force = -np.einsum("ijkl,klj->i", elasticity(E, NU), second)
            residual -= ufl.inner(ufl.as_vector(list(force)), w) * kind.dx(domain)
            Sigma = np.einsum("ijklmn,lmn->ijk", one_parameter(D), second)
            traction = ufl.dot(ufl.as_tensor(Sigma.tolist()), ufl.FacetNormal(domain))
            residual -= ufl.inner(traction, eta) * ufl.ds(domain)
        everywhere = mesh.locate_entities_boundary(
            domain, d - 1, lambda x: np.full(x.shape[1], True)
        )
        space = self.medium.space
        collapsed, _ = space.collapse()
        self.displacement = fem.Function(collapsed)
        dofs = fem.locate_dofs_topological((space, collapsed), d - 1, everywhere)
        bcs = [fem.dirichletbc(self.displacement, dofs, space)]
        self.problem = Problem(
            self.medium.unknown, residual, jacobian, self.operator, bcs, Convergence(1e-12)
        )

    def prescribe(self, displacement):
        """A function of x (d, n) with values (d, n)."""
        self.displacement.interpolate(lambda x: displacement(x[: self.d]))

    def put(self, displacement, gradient):
        """Make these functions of x the unknown, the gradient with values (d, d, n)."""
        unknown, d, length = self.medium.unknown, self.d, self.medium.length
        for k, field in enumerate((displacement, lambda x: length * gradient(x).reshape(d**2, -1))):
            space, dofs = unknown.function_space.sub(k).collapse()
            function = fem.Function(space)
            function.interpolate(lambda x, field=field: field(x[:d]))
            unknown.x.array[dofs] = function.x.array

    @property
    def double_stress(self):
        return self.medium.states[0].values

    @property
    def micro_stress(self):
        return self.medium.states[1].values


def uniform(gradient):
    """Displacement and gradient of a uniform deformation."""
    constant_in_space = lambda x: np.repeat(gradient[..., None], x.shape[1], axis=2)  # noqa: E731
    return (lambda x: gradient @ x), constant_in_space


# Patch tests


@pytest.mark.parametrize("formulation, law", FORMULATIONS)
@pytest.mark.parametrize(
    "name, micro_strain", [("Q8", "linear"), ("T6", "linear"), ("Q8", "quadratic")]
)
def test_uniform_strain_of_a_distorted_patch_has_no_double_stress(
    name, micro_strain, formulation, law
):
    patch = Patch(name, formulation, law, micro_strain=micro_strain)
    step, deformation, before = GRADIENT[:2, :2], np.eye(2), patch.points.coordinates()
    for _ in range(2):  # the second step starts from the moved mesh
        patch.prescribe(uniform(step)[0])
        assert patch.problem.solve().converged
        patch.problem.accept()
        deformation = (np.eye(2) + step) @ deformation
    np.testing.assert_allclose(patch.points.coordinates(), before @ deformation.T, atol=1e-9)
    assert np.abs(patch.double_stress).max() < 1e-9
    assert np.abs(patch.micro_stress).max() < 1e-9


@pytest.mark.parametrize("name", ["H27", "T10"])
def test_uniform_strain_of_a_distorted_patch_in_3d(name):
    patch = Patch(name)
    before = patch.points.coordinates()
    patch.prescribe(uniform(GRADIENT)[0])
    assert patch.problem.solve().converged
    patch.problem.accept()
    moved = before @ (np.eye(3) + GRADIENT).T
    np.testing.assert_allclose(patch.points.coordinates(), moved, atol=1e-9)
    assert np.abs(patch.double_stress).max() < 1e-9


def test_an_iterative_solver_comes_to_the_same(petsc_options):
    displacement = lambda x: np.array([0.02 * x[1] ** 2, -0.05 * x[1] + 0.01 * x[0] * x[1]])  # noqa: E731
    ends = []
    for options in (
        "-femxdem_ksp_type preonly",
        "-femxdem_ksp_type gmres -femxdem_ksp_rtol 1e-10 -femxdem_pc_type asm"
        " -femxdem_pc_asm_blocks 4 -femxdem_pc_asm_overlap 1 -femxdem_sub_pc_type lu"
        " -femxdem_sub_pc_factor_mat_solver_type mumps",
    ):
        petsc_options(options)
        patch = Patch("Q8")
        patch.prescribe(displacement)
        assert patch.problem.solve().converged
        ends.append((patch.problem.u.x.array.copy(), patch.problem.snes.getKSP()))
    assert ends[1][1].getIterationNumber() > 3
    np.testing.assert_allclose(ends[1][0], ends[0][0], rtol=0, atol=1e-8)


SECOND = 1e-2 * np.array([[[1.0, 0.5], [0.5, -2.0]], [[-1.5, 1.0], [1.0, 0.7]]])


def quadratic():
    """u_i = E_ijk x_j x_k / 2."""
    displacement = lambda x: 0.5 * np.einsum("ijk,jn,kn->in", SECOND, x, x)  # noqa: E731
    return displacement, lambda x: np.einsum("ijk,kn->ijn", SECOND, x)


@pytest.mark.parametrize(
    "name, distortion, micro_strain",
    [
        ("Q8", 0.0, "linear"),
        ("T6", 0.2, "linear"),
        ("Q9", 0.2, "linear"),
        ("Q8", 0.0, "quadratic"),
        ("Q9", 0.2, "quadratic"),
    ],
)
def test_linear_strain_of_a_patch_has_a_constant_double_stress(name, distortion, micro_strain):
    """Q8 holds all quadratic functions on parallelograms alone (Arnold, Boffi and Falk 2002)."""
    patch = Patch(name, distortion=distortion, second=SECOND, micro_strain=micro_strain)
    x = patch.points.coordinates()
    patch.prescribe(quadratic()[0])
    assert patch.problem.solve().converged
    patch.problem.accept()
    exact = np.einsum("ijklmn,lmn->ijk", one_parameter(D), SECOND)
    np.testing.assert_allclose(patch.double_stress, np.tile(exact, (len(x), 1, 1, 1)), atol=1e-9)
    assert np.abs(patch.micro_stress).max() < 1e-8
    displacement = quadratic()[0](x.T).T
    np.testing.assert_allclose(patch.points.coordinates(), x + displacement, atol=1e-10)


# Rotations


def rotation(degrees: float) -> np.ndarray:
    angle = np.radians(degrees)
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def some_double_stress(patch):
    values = np.random.default_rng(1).normal(size=patch.double_stress.shape)
    patch.medium.states[0]._set(values)
    patch.medium.states[1]._set(values[:, 0])  # a micro-stress
    return values


@pytest.mark.parametrize("formulation, law", FORMULATIONS)
def test_a_rotation_by_90_degrees_in_steps_turns_the_double_stress(formulation, law):
    patch = Patch("Q8", formulation, law)
    before = some_double_stress(patch)
    for _ in range(6):
        patch.put(*uniform(rotation(15) - np.eye(2)))
        patch.problem.accept()
    after = patch.double_stress
    Q = rotation(90)
    np.testing.assert_allclose(after, np.einsum("ia,jb,kc,nabc->nijk", Q, Q, Q, before), atol=1e-12)
    np.testing.assert_allclose((after**2).sum(), (before**2).sum(), rtol=1e-12)
    turned = np.einsum("ia,jb,nab->nij", Q, Q, before[:, 0])
    np.testing.assert_allclose(patch.micro_stress, turned, atol=1e-12)


def test_a_rotation_in_3d_turns_the_double_stress():
    patch = Patch("H27")
    before = some_double_stress(patch)
    R = Rotation.from_rotvec([0.3, -0.2, 0.25]).as_matrix()
    patch.put(*uniform(R - np.eye(3)))
    patch.problem.accept()
    np.testing.assert_allclose(
        patch.double_stress, np.einsum("ia,jb,kc,nabc->nijk", R, R, R, before), atol=1e-12
    )


def test_a_rotation_on_top_of_a_step_turns_the_result_and_changes_nothing_else():
    results, Q = [], rotation(25)
    for turn in (np.eye(2), Q):
        patch = Patch("Q8", "finite", NeoHookean, distortion=0.0)
        some_double_stress(patch)
        patch.put(
            lambda x, R=turn: R @ (x + quadratic()[0](x)) - x,
            lambda x, R=turn: np.einsum(
                "ia,ajn->ijn", R, np.eye(2)[..., None] + quadratic()[1](x)
            ) - np.eye(2)[..., None],
        )  # fmt: skip
        patch.problem.accept()
        results.append(patch.double_stress)
    expected = np.einsum("ia,jb,kc,nabc->nijk", Q, Q, Q, results[0])
    np.testing.assert_allclose(results[1], expected, atol=1e-12)


def test_simple_shear_turns_the_double_stress_by_half_its_angle_with_second_order_error():
    """The Jaumann rate: spin gamma / 2 (Desrues eq. 45)."""
    gamma, errors = 0.8, []
    for steps in (2, 4):
        patch = Patch("Q8", "finite", NeoHookean, distortion=0.0)
        before = some_double_stress(patch)
        for _ in range(steps):
            patch.put(*uniform(np.array([[0.0, gamma / steps], [0.0, 0.0]])))
            patch.problem.accept()
        exact = np.einsum("ia,jb,kc,nabc->nijk", *[rotation(-np.degrees(gamma / 2))] * 3, before)
        errors.append(np.abs(patch.double_stress - exact).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)


# Boundary layers


def layer(name, cells, length, *, prescribe=True, stiffness=None):
    """A strip of height 1 sheared by 1e-3 between rough plates; internal length `length`.

    Either du_x/dy is zero at the plates, or the double force at the upper one is D/l^2 times 1e-3
    per metre. Returns shear stress and the relative L2 error of nu_xy.
    """
    shear, d = 1e-3, element(name).dim
    modulus = SHEAR * length**2
    strip = Layer(
        lambda points: LinearElastic(points.size, E, NU, dim=d),
        one_parameter(modulus, d) if stiffness is None else modulus * stiffness,
        cells,
        name=name,
        bent=not prescribe,
        double_force=None if prescribe else modulus * shear,
    )
    strip.shear(0.0, shear)
    assert strip.problem.solve().converged
    stress, up = strip.stress(), d - 1
    y = ufl.SpatialCoordinate(strip.mesh)[up]
    if prescribe:
        exact_stress = SHEAR * shear / (1 - 2 * length * np.tanh(0.5 / length))
        x = (y - 0.5) / length
        exact = exact_stress / SHEAR * (1 - ufl.cosh(x) / np.cosh(0.5 / length))
    else:  # D g'' = G g - stress; g' = 0 below, shear above
        size = shear * length / np.sinh(1 / length)
        exact_stress = SHEAR * (shear - size * length * np.sinh(1 / length))
        exact = exact_stress / SHEAR + size * ufl.cosh(y / length)
    dx = ufl.dx(metadata={"quadrature_degree": 8})

    def norm(value):
        return np.sqrt(fem.assemble_scalar(fem.form(value**2 * dx)))

    error = norm(strip.medium.micro_strain[0, up] - exact) / norm(exact)
    return stress, error, exact_stress


@pytest.mark.parametrize("name, bound", [("Q8", 1e-2), ("T6", 1e-2)])
def test_a_sheared_layer_has_its_cosh_profile_and_gives_the_internal_length_back(name, bound):
    shear, errors = 1e-3, []
    for rows in (16, 32):
        stress, error, _ = layer(name, (3, rows), 0.1)
        errors.append(error)
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)
    found = brentq(
        lambda length: 1 - 2 * length * np.tanh(0.5 / length) - SHEAR * shear / stress, 0.01, 0.4
    )
    assert found == pytest.approx(0.1, rel=bound)


def test_a_prescribed_double_force_has_its_closed_form():
    errors = []
    for rows in (8, 16):
        stress, error, exact = layer("Q8", (3, rows), 0.2, prescribe=False)
        errors.append(error)
    assert stress == pytest.approx(exact, rel=1e-3)
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.15)


def test_mindlins_law_in_a_layer_of_hexahedra():
    """Of the five constants, 2 (a3 + a4) resists d^2 u_x / dz^2."""
    constants = np.array([0.1, 0.4, 0.2, 0.8, -0.3])
    A = mindlin(constants / (2 * (constants[2] + constants[3])), 3)
    stress, error, exact = layer("H27", (2, 2, 8), 0.2, stiffness=A)
    assert stress == pytest.approx(exact, rel=1e-2)
    assert error < 0.03


# The mixed space


@pytest.mark.parametrize("name, multiplier, lowest", [("Q8", "P0", 0.65), ("T6", "P1", 0.4)])
def test_the_multiplier_passes_the_inf_sup_test(name, multiplier, lowest):
    coarse, fine = (constant(name, cells, multiplier, 0.2) for cells in (5, 10))
    assert fine > lowest
    assert fine > 0.85 * coarse


def test_a_constant_multiplier_on_triangles_and_a_linear_one_on_q8_do_not():
    for name, multiplier in (("T6", "P0"), ("Q8", "P1")):
        coarse, fine = (constant(name, cells, multiplier, 0.2) for cells in (4, 8))
        assert fine < 0.65 * coarse


@pytest.mark.parametrize("name", ["Q8", "Q9"])
def test_periodic_sides_and_an_even_number_of_columns_leave_a_multiplier_that_nothing_feels(name):
    odd, even = (constant(name, columns, sides="periodic") for columns in (3, 4))
    assert odd > 0.5
    assert even < 1e-6


@pytest.mark.parametrize("name", ["Q8", "Q9"])
@pytest.mark.parametrize("sides", ["free", "periodic"])
def test_a_quadratic_micro_strain_feels_every_multiplier_between_two_plates(name, sides):
    coarse, fine = (
        constant(name, columns, sides=sides, micro_strain="quadratic") for columns in (4, 8)
    )
    assert fine > 0.75
    assert fine > 0.95 * coarse
    assert constant(name, 8, sides=sides) < 0.4  # a linear one does not


# The solver and the state


def test_newton_converges_quadratically_with_the_exact_jacobian(petsc_options):
    petsc_options("-femxdem_snes_type newtonls")
    specimen = Specimen(
        lambda points: NeoHookean(points.size, E, NU), modulus=5.0, rough=True, tolerance=1e-13
    )
    specimen.pressure.value = 10.0
    for step in (0, 1):  # in the second one there is a double stress to turn
        specimen.compress(0.15 * step, 0.15 * (step + 1))
        norms = []
        specimen.problem.snes.setMonitor(lambda snes, iteration, norm, n=norms: n.append(norm))
        specimen.problem.solve()
        specimen.problem.accept()
    logarithms = np.log(norms)
    order = np.diff(logarithms)[1:] / np.diff(logarithms)[:-1]
    assert order[np.array(norms[2:]) > 1e-11 * norms[0]].max() > 1.8, norms
    assert np.abs(specimen.medium.states[0].values).max() > 1e-2


def test_a_saved_state_is_read_back_bit_for_bit_and_a_rejected_step_leaves_no_trace(tmp_path):
    first, second = (
        Specimen(lambda points: NeoHookean(points.size, E, NU), modulus=5.0, rough=True)
        for _ in range(2)
    )
    first.compress(0.0, 0.1)
    first.problem.solve()
    first.problem.accept()
    with h5py.File(tmp_path / "state.h5", "w") as file:
        for state in first.operator.states:
            state.save(file.create_group(state.name))
    with h5py.File(tmp_path / "state.h5") as file:
        for state in second.operator.states:
            state.load(file[state.name])
    second.compress(0.0, 0.05)
    second.problem.solve()
    second.problem.reject()
    for one, two in zip(first.operator.states, second.operator.states, strict=True):
        assert np.abs(one.values).max() > 0
        np.testing.assert_array_equal(one.values, two.values)
    other = Specimen(lambda points: NeoHookean(points.size, E, NU), modulus=5.0, cells=(1, 1))
    with h5py.File(tmp_path / "state.h5") as file:
        with pytest.raises(ValueError, match="double_stress has shape"):
            other.operator.states[0].load(file["double_stress"])


def test_an_element_without_a_mixed_space_is_refused_with_those_to_choose_from():
    points = QuadraturePoints(
        rectangle.rectangle(MPI.COMM_WORLD, 1.0, 1.0, 1, 1, element("Q4")), element("Q4")
    )
    with pytest.raises(ValueError, match=r"Q4 has no mixed space .* choose one of Q8, Q9, T6"):
        SecondGradient(points, "small", one_parameter(1.0))
