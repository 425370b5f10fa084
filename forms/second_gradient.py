"""Equilibrium of a second-gradient continuum, for one load step (Desrues section 4).

Beside the displacement u of the step there are its micro-strain nu (d, d), which follows grad u
weakly, and the micro-stress lambda (d, d) that makes it follow (eq. 41, 43). For all w, eta, mu:

    int (sigma - lambda)_ij dw_i/dx_j + Sigma_ijk deta_ij/dx_k + lambda_ij eta_ij  dv
        = int p_i w_i + P_i eta_ik n_k  da
    int mu_ij (du_i/dX_j - nu_ij)  dV = 0

with x, n, dv, da at the end of the step and X, dV at its start; the formulation `small` takes the
start for both. The double stress Sigma (d, d, d), N/m, starts from the committed one: `increment`.

A multiplier that is constant in a cell holds the mean of grad u to that of nu alone. What it leaves
free, that some points of a cell strain on while others unload, a softening material would do
(docs/second-gradient.md). The solution does not change where in these equations lambda is

    lambda - k (du_i/dX_j - nu_ij),    k = 12 D / l^2

with k the stiffness that D gives to a strain that is linear across a cell of size l.

So that all rows are forces and all unknowns lengths, nu is solved for times the size l of a cell,
and the increment of lambda times l^3/D.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from femxdem_fenicsx.fem.point_state import PointState
from femxdem_fenicsx.fem.quadrature_points import QuadraturePoints

from .first_gradient import deformation_gradient, pressure_work, stress_increment

#: k l^2 / D. Any value between 3 and 24 gives the same.
WITHIN_A_CELL = 12.0


class SecondGradient:
    """A second-gradient continuum: what is solved for, and its equilibrium.

    Attributes:
        unknown: the mixed function of the step, (u, l nu, l^3/D lambda's increment), m.
        displacement: u, m, as a UFL expression.
        micro_strain: nu, as a UFL expression.
        space: of displacements, to fix components of.
        micro_space: of l nu; fix component d*i + j at l times a value of du_i/dx_j.
        length: l, the size of a cell in the mean, m.
        F: deformation gradient of the step.
        states: the committed double stress (N/m) and micro-stress (Pa).

    Args:
        points: of the mesh.
        formulation: "small" or "finite", as for the first gradient.
        stiffness: A of the double stress, (d,) * 6, N: see :mod:`femxdem_fenicsx.double_stress`.
        micro_strain: of nu within a cell, "linear" (Desrues section 4.3) or "quadratic".

    Raises:
        ValueError: an element without a mixed space; "finite" in 3D, whose form is too large.
    """

    def __init__(
        self,
        points: QuadraturePoints,
        formulation: str,
        stiffness: np.ndarray,
        micro_strain: str = "linear",
    ):
        mesh, self._points = points.mesh, points
        d = mesh.geometry.dim
        self._finite = {"small": False, "finite": True}[formulation]
        if self._finite and d == 3:
            raise ValueError("second gradient in 3D: use --formulation small")
        self.unknown = fem.Function(points.element.second_gradient_space(mesh, micro_strain))
        self.space, self.micro_space = (self.unknown.function_space.sub(k) for k in range(2))
        self.length = _cell_size(points)
        largest = np.abs(stiffness).max()
        # constants, not numbers: the compiled forms serve any mesh and modulus
        self._l = fem.Constant(mesh, self.length)
        self._scale = fem.Constant(mesh, largest / self.length**3)
        modulus = fem.Constant(mesh, largest)
        u, nu, step = self._fields(self.unknown)
        self.displacement, self.micro_strain = u, nu
        self.F = deformation_gradient(u)
        double_stress = PointState("double_stress", points, (d, d, d))
        micro_stress = PointState("micro_stress", points, (d, d))
        self.states = (double_stress, micro_stress)
        self._increment = partial(increment, self.F, stiffness / largest, modulus, self._finite)
        turned = transformed(double_stress.committed, *[rotation(self.F)] * 3)
        self._Sigma = turned + self._increment(ufl.grad(nu))
        self._fine = fem.Constant(mesh, WITHIN_A_CELL * largest / self.length**2)
        self._lambda = transformed(micro_stress.committed, rotation(self.F), rotation(self.F))
        self._lambda += self._multiplier(u, nu, step)
        double_stress.follow(self._Sigma)
        micro_stress.follow(self._lambda)

    def _fields(self, mixed):
        u, nu, multiplier = ufl.split(mixed)
        return u, nu / self._l, self._scale * multiplier

    def _multiplier(self, u, nu, step):
        """The increment of lambda, Pa."""
        return step - self._fine * (ufl.grad(u) - nu)

    def straight(self, side: np.ndarray, normal: int, component: int) -> list:
        """Conditions that go with a displacement component that is uniform along a plane side.

        Its derivatives along the side are zero there. Where they are left free, the multiplier
        carries them with an error of the size of a cell (docs/second-gradient.md).

        Args:
            side: its facets.
            normal: axis that it is normal to.
            component: of the displacement.
        """
        d = len(self.displacement)
        zero = fem.Constant(self._points.mesh, 0.0)
        conditions = []
        for axis in set(range(d)) - {normal}:
            space = self.micro_space.sub(d * component + axis)
            dofs = fem.locate_dofs_topological(space, d - 1, side)
            conditions.append(fem.dirichletbc(zero, dofs, space))
        return conditions

    def equilibrium(
        self, stress, tangent, pressures: Sequence = (), double_forces: Sequence = ()
    ) -> tuple[ufl.Form, ufl.Form]:
        """Residual (internal minus external forces) and Jacobian.

        In 3D the Jacobian holds the rotation that turns the committed double stress and
        micro-stress: its derivative would take minutes to compile. In 2D it is exact.

        Args:
            stress: quadrature function (d, d), Pa.
            tangent: its derivative, quadrature function (d*d, d*d), Pa.
            pressures: pairs (p, ds), p in Pa, compression positive.
            double_forces: pairs (P, ds), P (d,) in N/m, per area of the boundary (eq. 35); where
                there are none, the boundary is free of them (eq. 39).
        """
        space = self.unknown.function_space
        dx = self._points.element.dx(self._points.mesh)
        w, eta, mu = self._fields(ufl.TestFunction(space))
        trial = ufl.TrialFunction(space)
        u, nu, d = self.displacement, self.micro_strain, len(self.displacement)
        du, dnu, dstep = self._fields(trial)
        # dv/dx = cofactor dV/dX, n da = cofactor N dA (Nanson), dv = J dV
        J = ufl.det(self.F) if self._finite else 1.0
        cofactor = J * ufl.inv(self.F).T if self._finite else ufl.Identity(d)

        def derivative(expression):
            return ufl.derivative(expression, self.unknown, trial)

        def double_work(Sigma, area):
            i, j, k, K = ufl.indices(4)
            return Sigma[i, j, k] * area[k, K] * ufl.grad(eta)[i, j, K] * dx

        def micro_work(micro, area, volume):
            work = volume * ufl.inner(micro, eta) - ufl.inner(micro * area, ufl.grad(w))
            return work * dx

        residual = ufl.inner(stress * cofactor, ufl.grad(w)) * dx
        residual -= ufl.inner(mu, ufl.grad(u) - nu) * dx
        normal = cofactor * ufl.FacetNormal(space.mesh)
        residual += pressure_work(pressures, normal, w)
        for double_force, ds in double_forces:
            residual -= ufl.inner(double_force, eta * normal) * ds
        jacobian = derivative(residual)
        jacobian += ufl.inner(stress_increment(tangent, du) * cofactor, ufl.grad(w)) * dx
        exact = d == 2
        dSigma = derivative(self._Sigma) if exact else self._increment(ufl.grad(dnu))
        dlambda = derivative(self._lambda) if exact else self._multiplier(du, dnu, dstep)
        jacobian += double_work(dSigma, cofactor) + micro_work(dlambda, cofactor, J)
        if self._finite:
            jacobian += double_work(self._Sigma, derivative(cofactor))
            jacobian += micro_work(self._lambda, derivative(cofactor), derivative(J))
        residual += double_work(self._Sigma, cofactor) + micro_work(self._lambda, cofactor, J)
        return residual, jacobian


def increment(F, A: np.ndarray, D, finite: bool, G):
    """Double stress of one step (d, d, d), N/m: the Jaumann rate (Desrues eq. 44, 45) integrated.

    With F = R U (polar decomposition), and the rate held in the material's turning frame R(t):

        Sigma <- R * (Sigma + D A : E),    E = U_m^-1 (R^T G) U_m^-1 U_m^-1,   U_m = (I + U) / 2

    where * turns all three indices, and E is the gradient of the velocity gradient at the middle
    of the step, times its length. A rotation put on top of the step turns the result and changes
    nothing else; the error in the step's size is of second order. This function returns
    R * (D A : E), or D A : G for small strains.

    Args:
        F: deformation gradient of the step, (d, d).
        A: shape of the stiffness, (d,) * 6.
        D: its size, N.
        finite: whether the strains of a step may be large.
        G: dnu_ij/dX_k, (d, d, d), 1/m.
    """
    if not finite:
        return D * _contracted(A, G)
    R = rotation(F)
    middle = ufl.inv((ufl.Identity(len(A)) + R.T * F) / 2)
    E = transformed(G, middle * R.T, middle.T, middle.T)
    return D * transformed(_contracted(A, E), R, R, R)


def rotation(F):
    """R of F = R U. In 3D by Halley's iteration, exact to 1e-8 for stretches up to 30 %."""
    if F.ufl_shape == (2, 2):
        sum_ = F + ufl.det(F) * ufl.inv(F).T
        return sum_ / ufl.sqrt(ufl.det(sum_))
    R, one = F, ufl.Identity(3)
    for _ in range(2):
        C = R.T * R
        R = R * (3 * one + C) * ufl.inv(one + 3 * C)
    return R


def transformed(T, *by):
    """P_ia Q_jb R_kc T_abc for a tensor T of as many indices as there are P, Q, R."""
    new, old = ufl.indices(len(by)), ufl.indices(len(by))
    product = T[old]
    for matrix, i, a in zip(by, new, old, strict=True):
        product = matrix[i, a] * product
    return ufl.as_tensor(product, new)


def _contracted(A: np.ndarray, E):
    """A_ijklmn E_lmn, without the terms that are zero."""
    d = len(A)
    places = list(np.ndindex(d, d, d))
    matrix = A.reshape(d**3, d**3)

    def component(i: int, j: int, k: int):
        row = matrix[(d * i + j) * d + k]
        return sum(float(a) * E[place] for a, place in zip(row, places, strict=True) if a)

    return ufl.as_tensor(
        [[[component(i, j, k) for k in range(d)] for j in range(d)] for i in range(d)]
    )


def _cell_size(points: QuadraturePoints) -> float:
    """The d-th root of the mean volume of a cell."""
    own = np.array([points.volumes().sum(), len(points.cells)])
    volume, cells = points.mesh.comm.allreduce(own, MPI.SUM)
    return float((volume / cells) ** (1 / points.mesh.geometry.dim))
