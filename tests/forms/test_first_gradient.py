"""Both formulations against exact solutions: the patch test, closed forms, a rigid rotation."""

import numpy as np
import pytest
from dolfinx import fem, mesh
from mpi4py import MPI
from petsc4py import PETSc
from scipy.optimize import brentq

from femxdem_fenicsx.fem.convergence import Convergence
from femxdem_fenicsx.fem.elements import element
from femxdem_fenicsx.fem.external_operator import ExternalOperator
from femxdem_fenicsx.fem.problem import Problem
from femxdem_fenicsx.fem.quadrature_points import QuadraturePoints
from femxdem_fenicsx.law import LinearElastic, NeoHookean, elasticity
from forms import first_gradient
from meshes.box import box
from meshes.rectangle import rectangle
from tests.fem.specimen import HEIGHT, WIDTH, Specimen

ELEMENTS = [("Q4", None), ("Q8", "2x2"), ("Q8", "3x3"), ("Q9", None), ("T6", None)]
ELEMENTS_3D = [("H8", None), ("H27", None), ("T4", None), ("T10", None)]
GRADIENT = np.array([[0.03, 0.02, 0.01], [-0.01, -0.05, 0.02], [0.015, -0.02, 0.04]])
E, NU = 100.0, 0.3


@pytest.mark.parametrize("name, points", ELEMENTS + ELEMENTS_3D)
@pytest.mark.parametrize("formulation, law", [("small", LinearElastic), ("finite", NeoHookean)])
def test_patch_of_distorted_cells_deforms_as_its_boundary_step_after_step(
    name, points, formulation, law
):
    kind = element(name, points)
    d, world = kind.dim, MPI.COMM_WORLD
    if d == 2:
        domain = rectangle(world, 1.0, 2.0, 3, 3, kind, distortion=0.25)
    else:
        domain = box(world, (1.0, 1.0, 2.0), (2, 3, 3), kind, distortion=0.15)
    gradient = GRADIENT[:d, :d]
    at = QuadraturePoints(domain, kind)
    material = law(at.size, E, NU, dim=d)
    u = fem.Function(kind.space(domain))
    operator = ExternalOperator(first_gradient.deformation_gradient(u), material, at)
    residual, jacobian = getattr(first_gradient, formulation)(
        u, operator.stress, operator.tangent, kind.dx(domain)
    )
    boundary = mesh.locate_entities_boundary(domain, d - 1, lambda x: np.full(x.shape[1], True))
    prescribed = fem.Function(u.function_space)
    dofs = fem.locate_dofs_topological(u.function_space, d - 1, boundary)
    bc = fem.dirichletbc(prescribed, dofs)
    problem = Problem(u, residual, jacobian, operator, [bc], Convergence(1e-13))
    step, deformation = np.eye(d) + gradient, np.eye(d)
    before = at.coordinates()
    for _ in range(2):  # the second step starts from the moved mesh
        prescribed.interpolate(lambda x: gradient @ x[:d])
        assert problem.solve().converged
        problem.accept()
        deformation = step @ deformation
    exact = law(1, E, NU, dim=d)
    if formulation == "small":
        exact.evaluate(step[None])
        exact.commit()
        stress = exact.evaluate(step[None])
    else:
        stress = exact.evaluate(deformation[None])
    found = material.evaluate(np.tile(np.eye(d), (at.size, 1, 1)))
    np.testing.assert_allclose(found, np.tile(stress, (at.size, 1, 1)), atol=1e-10)
    np.testing.assert_allclose(at.coordinates(), before @ deformation.T, atol=1e-10)


@pytest.mark.parametrize("name", ["Q4", "Q8", "Q9", "T6"])
def test_linear_elastic_biaxial_compression_has_its_closed_form(name):
    cell_pressure, strain = 1.0, 0.02
    specimen = Specimen(
        lambda points: LinearElastic(points.size, E, NU, -0.4 * np.eye(2)),
        name=name,
        formulation="small",
    )
    specimen.pressure.value = cell_pressure
    specimen.compress(0.0, strain)
    solution = specimen.problem.solve()
    specimen.problem.accept()
    assert solution.converged
    C = elasticity(E, NU)
    lateral = (-cell_pressure + 0.4 + C[0, 0, 1, 1] * strain) / C[0, 0, 0, 0]
    axial = -0.4 + C[1, 1, 0, 0] * lateral - C[1, 1, 1, 1] * strain
    assert specimen.top_force() == pytest.approx(axial * WIDTH, rel=1e-11)
    assert specimen.volume() == pytest.approx(
        WIDTH * HEIGHT * (1 + lateral) * (1 - strain), rel=1e-12
    )


def neo_hookean(lateral: float, axial: float) -> np.ndarray:
    return NeoHookean(1, E, NU).evaluate(np.diag([lateral, axial])[None])[0]


@pytest.mark.parametrize("name", ["Q4", "Q8", "T6"])
def test_neo_hookean_biaxial_compression_by_30_percent_under_follower_pressure(name):
    cell_pressure, steps = 5.0, 6
    specimen = Specimen(lambda points: NeoHookean(points.size, E, NU), name=name, tolerance=1e-12)
    specimen.pressure.value = cell_pressure
    for step in range(steps):
        specimen.compress(0.3 * step / steps, 0.3 * (step + 1) / steps)
        assert specimen.problem.solve().converged
        specimen.problem.accept()
    lateral = brentq(lambda s: neo_hookean(s, 0.7)[0, 0] + cell_pressure, 0.5, 2.0, xtol=1e-14)
    force = neo_hookean(lateral, 0.7)[1, 1] * lateral * WIDTH
    assert specimen.top_force() == pytest.approx(force, rel=1e-9)
    assert specimen.volume() == pytest.approx(0.7 * lateral * WIDTH * HEIGHT, rel=1e-10)
    assert lateral > 1.05  # so that the pressure acts on a turned and stretched side


@pytest.mark.parametrize("name", ["H8", "T4", "T10"])
def test_neo_hookean_triaxial_compression_by_20_percent_under_follower_pressure(name):
    cell_pressure, steps = 5.0, 4
    specimen = Specimen(
        lambda points: NeoHookean(points.size, E, NU, dim=3), name=name, tolerance=1e-12
    )
    specimen.pressure.value = cell_pressure
    for step in range(steps):
        specimen.compress(0.2 * step / steps, 0.2 * (step + 1) / steps)
        assert specimen.problem.solve().converged
        specimen.problem.accept()

    def stress(lateral: float) -> np.ndarray:
        return NeoHookean(1, E, NU, dim=3).evaluate(np.diag([lateral, lateral, 0.8])[None])[0]

    lateral = brentq(lambda s: stress(s)[0, 0] + cell_pressure, 0.5, 2.0, xtol=1e-14)
    force = stress(lateral)[2, 2] * (lateral * WIDTH) ** 2
    assert specimen.top_force() == pytest.approx(force, rel=1e-9)
    assert specimen.volume() == pytest.approx(0.8 * (lateral * WIDTH) ** 2 * HEIGHT, rel=1e-10)


def test_dead_pressure_of_the_small_formulation_ignores_the_new_width():
    specimen = Specimen(lambda points: LinearElastic(points.size, E, 0.0), formulation="small")
    specimen.pressure.value = 10.0
    specimen.compress(0.0, 0.1)
    specimen.problem.solve()
    specimen.problem.accept()
    assert specimen.committed_stress()[:, 0, 0] == pytest.approx(-10.0)


def test_a_rigid_rotation_turns_the_nodal_forces_and_adds_none():
    specimen = Specimen(lambda points: NeoHookean(points.size, E, NU), rough=True)
    specimen.pressure.value = 3.0
    specimen.compress(0.0, 0.1)
    specimen.problem.solve()
    specimen.problem.accept()
    angle = np.radians(20)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])

    def forces(rotation):
        specimen.u.interpolate(lambda x: (rotation - np.eye(2)) @ x[:2])
        specimen.problem.balance.evaluate()
        return specimen.problem.balance.forces.array.reshape(-1, 2).copy()

    at_rest = forces(np.eye(2))
    assert np.abs(at_rest).max() > 0.1
    np.testing.assert_allclose(forces(turn), at_rest @ turn.T, atol=1e-12)


@pytest.mark.parametrize("formulation", ["small", "finite"])
def test_newton_converges_quadratically_with_the_exact_tangent(formulation, petsc_options):
    petsc_options("-femxdem_snes_type newtonls")
    specimen = Specimen(
        lambda points: NeoHookean(points.size, E, NU),
        formulation=formulation,
        rough=True,
        tolerance=1e-13,
    )
    specimen.pressure.value = 10.0
    specimen.compress(0.0, 0.25)
    norms = []
    specimen.problem.snes.setMonitor(lambda snes, iteration, norm: norms.append(norm))
    specimen.problem.solve()
    assert specimen.problem.snes.getType() == PETSc.SNES.Type.NEWTONLS
    logarithms = np.log(norms)
    order = np.diff(logarithms)[1:] / np.diff(logarithms)[:-1]
    assert order[np.array(norms[2:]) > 1e-11 * norms[0]].max() > 1.8, norms
