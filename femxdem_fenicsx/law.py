"""The constitutive law that the macro scale sees, and small laws with a closed form.

A law holds the state of all quadrature points of a rank. `evaluate` deforms them from the
committed state and is a function of F alone; `commit` makes the last trial the state.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np


class InadmissibleDeformation(ValueError):
    """A law cannot follow this deformation gradient.

    The solver takes it as an iterate that went astray: the load step is cut, the run goes on. Any
    other error of a law ends the run.
    """


class Law(Protocol):
    """Stress of `size` material points as a function of their deformation gradient.

    Attributes:
        dim: 2 or 3.
        size: number of material points on this rank.
    """

    dim: int
    size: int

    def evaluate(self, F: np.ndarray) -> np.ndarray:
        """Cauchy stress at the end of the step, (n, d, d), Pa, tension positive.

        Args:
            F: deformation gradient relative to the committed state, (n, d, d).

        Raises:
            InadmissibleDeformation: F is beyond what the law can follow.
        """
        ...

    def tangent(self) -> np.ndarray:
        """C_ijkl = d stress_ij / d F_kl at the last trial (Argilaga eq. 4), (n, d, d, d, d), Pa."""
        ...

    def commit(self) -> None:
        """Make the last trial the state."""
        ...

    def discard(self) -> None:
        """Forget the last trial."""
        ...

    def save(self, group) -> None:
        """Write the committed state into an HDF5 group."""
        ...

    def load(self, group) -> None:
        """Read the committed state back, bit for bit."""
        ...


class _Analytic:
    """State handling of the laws below: named arrays, a committed set and a trial set.

    In 2D they are laws of plane strain.
    """

    FIELDS = ("stress",)
    threads = 1

    def __init__(self, dim: int, **state: np.ndarray):
        self.dim = dim
        self.size = len(next(iter(state.values())))
        self._state = state
        self._trial = state
        self._tangent = None

    def commit(self) -> None:
        self._state = self._trial

    def discard(self) -> None:
        self._trial = self._state

    def state(self) -> dict[str, np.ndarray]:
        """The committed state: arrays with one row per point."""
        return self._state

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Take over what `state` gave, of any number of points."""
        self._state = {name: np.array(state[name]) for name in self._state}
        self.size = len(next(iter(self._state.values())))
        self._trial = self._state

    def expected_cost(self, F: np.ndarray) -> np.ndarray:
        """Nothing that could be counted."""
        return np.zeros(self.size, np.int64)

    def save(self, group) -> None:
        for name, values in self._state.items():
            group.create_dataset(name, data=values)

    def load(self, group) -> None:
        self.restore({name: group[name][...] for name in self._state})


def elasticity(young: float, poisson: float, dim: int = 2) -> np.ndarray:
    """Isotropic stiffness C_ijkl, (d, d, d, d), Pa; of plane strain in 2D.

    Raises:
        ValueError: modulus not positive, or Poisson's ratio outside (-1, 0.5).
    """
    lame, shear = _lame(young, poisson)
    delta = np.eye(dim)
    return lame * np.einsum("ij,kl->ijkl", delta, delta) + shear * (
        np.einsum("ik,jl->ijkl", delta, delta) + np.einsum("il,jk->ijkl", delta, delta)
    )


def _lame(young: float, poisson: float) -> tuple[float, float]:
    if not young > 0 or not -1 < poisson < 0.5:
        raise ValueError(
            f"elastic law with E = {young} Pa, nu = {poisson}: E > 0 and -1 < nu < 0.5 are needed"
        )
    return young * poisson / ((1 + poisson) * (1 - 2 * poisson)), young / (2 * (1 + poisson))


class LinearElastic(_Analytic):
    """Small-strain increments: stress = committed stress + C : sym(F - I).

    Not objective; it belongs to the `small` formulation.

    Args:
        size: number of points.
        young: Young's modulus, Pa.
        poisson: Poisson's ratio.
        initial_stress: (d, d), Pa, the same everywhere; zero by default.
        dim: 2 or 3.
    """

    def __init__(self, size: int, young: float, poisson: float, initial_stress=None, dim: int = 2):
        self._stiffness = elasticity(young, poisson, dim)
        stress = np.zeros((size, dim, dim))
        if initial_stress is not None:
            stress += initial_stress
        super().__init__(dim, stress=stress)

    @property
    def stress(self) -> np.ndarray:
        """Committed stress (n, d, d), Pa."""
        return self._state["stress"]

    def evaluate(self, F: np.ndarray) -> np.ndarray:
        strain = F - np.eye(self.dim)
        stress = self._state["stress"] + np.einsum("ijkl,nkl->nij", self._stiffness, strain)
        self._trial = {"stress": stress}
        return stress

    def tangent(self) -> np.ndarray:
        return np.broadcast_to(self._stiffness, (self.size, *self._stiffness.shape))


class NeoHookean(_Analytic):
    """Compressible neo-Hookean solid: stress = (mu (b - I) + lambda ln(J) I) / J, b = F F^T.

    Objective, and a function of the total deformation gradient: the end of a path does not
    depend on the steps.

    Args:
        size: number of points.
        young: Young's modulus at small strain, Pa.
        poisson: Poisson's ratio at small strain.
        dim: 2 or 3.
    """

    def __init__(self, size: int, young: float, poisson: float, dim: int = 2):
        self._lambda, self._mu = _lame(young, poisson)
        super().__init__(dim, F=np.broadcast_to(np.eye(dim), (size, dim, dim)).copy())

    @property
    def stress(self) -> np.ndarray:
        """Committed stress (n, d, d), Pa."""
        return self._stress(self._state["F"])[0]

    def evaluate(self, F: np.ndarray) -> np.ndarray:
        total = F @ self._state["F"]
        stress, volume, b = self._stress(total)
        self._trial = {"F": total}
        self._last = (np.linalg.inv(F), volume[..., None, None], b, stress)
        return stress

    def _stress(self, F: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Stress, J (n, 1, 1) and b at the total F."""
        volume = np.linalg.det(F)[:, None, None]
        b, delta = F @ F.transpose(0, 2, 1), np.eye(self.dim)
        stress = (self._mu * (b - delta) + self._lambda * np.log(volume) * delta) / volume
        return stress, volume, b

    def tangent(self) -> np.ndarray:
        """With dF F^-1 = L: db = L b + b L^T and dJ = J tr L."""
        inverse, volume, b, stress = self._last
        delta = np.eye(self.dim)
        db = np.einsum("ik,njl->nijkl", delta, b @ inverse.transpose(0, 2, 1)) + np.einsum(
            "nil,jk->nijkl", b @ inverse.transpose(0, 2, 1), delta
        )
        isotropic = self._lambda / volume * np.einsum("ij,nlk->nijkl", delta, inverse)
        return self._mu / volume * db - np.einsum("nij,nlk->nijkl", stress, inverse) + isotropic


class Softening(_Analytic):
    """Isotropic damage: stress = (1 - D) C : strain, strains small and summed over the steps.

    With kappa the largest norm of strain so far, 1 - D = min(1, (k0 / kappa) exp(1 - kappa / k0)):
    the stress rises linearly to kappa = k0 and falls as exp(1 - kappa / k0) behind it.

    Args:
        size: number of points.
        young: Young's modulus, Pa.
        poisson: Poisson's ratio.
        threshold: k0, the strain norm at the peak; one value, or one per point (size,).
        dim: 2 or 3.
    """

    def __init__(self, size: int, young: float, poisson: float, threshold, dim: int = 2):
        self._stiffness = elasticity(young, poisson, dim)
        threshold = np.broadcast_to(np.asarray(threshold, dtype=float), (size,)).copy()
        if not (threshold > 0).all():
            raise ValueError(f"softening threshold {threshold.min()}: it must be positive")
        strain = np.zeros((size, dim, dim))
        super().__init__(dim, strain=strain, kappa=threshold, threshold=threshold)

    @property
    def stress(self) -> np.ndarray:
        """Committed stress (n, d, d), Pa."""
        elastic = np.einsum("ijkl,nkl->nij", self._stiffness, self._state["strain"])
        return self._intact(self._state["kappa"])[:, None, None] * elastic

    def evaluate(self, F: np.ndarray) -> np.ndarray:
        strain = self._state["strain"] + 0.5 * (F + F.transpose(0, 2, 1)) - np.eye(self.dim)
        kappa = np.maximum(self._state["kappa"], np.linalg.norm(strain, axis=(1, 2)))
        elastic = np.einsum("ijkl,nkl->nij", self._stiffness, strain)
        intact = self._intact(kappa)
        self._trial = self._state | {"strain": strain, "kappa": kappa}
        self._last = (strain, elastic, kappa, intact)
        return intact[:, None, None] * elastic

    def _intact(self, kappa: np.ndarray) -> np.ndarray:
        ratio = kappa / self._state["threshold"]
        return np.exp(1 - ratio) / ratio

    def tangent(self) -> np.ndarray:
        strain, elastic, kappa, intact = self._last
        grows = kappa > self._state["kappa"]
        threshold = self._state["threshold"]
        slope = np.where(grows, -intact * (1 / threshold + 1 / kappa) / kappa, 0.0)
        return intact[:, None, None, None, None] * self._stiffness + np.einsum(
            "n,nij,nkl->nijkl", slope, elastic, strain
        )


class ShearSoftening(_Analytic):
    """Damage in shear alone, which makes shear bands: stress = k tr(e) I + 2 G (1 - D) dev e.

    e is the strain, small and summed over the steps, k = lambda + 2 G / d. With kappa the largest
    norm of dev e so far, 1 - D = (k0 / kappa) exp((1 - kappa / k0) / m) from kappa = k0 on: the
    deviator of the stress rises linearly up to there and falls exponentially behind it.

    Args:
        size: number of points.
        young: Young's modulus, Pa.
        poisson: Poisson's ratio.
        threshold: k0, the norm of dev e at the peak; one value, or one per point (size,).
        ductility: m; behind the peak the curve falls with the slope of the rise over m.
        dim: 2 or 3.
    """

    def __init__(
        self, size: int, young: float, poisson: float, threshold, ductility: float, dim: int = 2
    ):
        lame, self._shear = _lame(young, poisson)
        self._bulk = lame + 2 * self._shear / dim
        threshold = np.broadcast_to(np.asarray(threshold, dtype=float), (size,)).copy()
        self._ductility = ductility
        if not ((threshold > 0).all() and ductility > 0):
            raise ValueError(
                f"softening threshold {threshold.min()}, ductility {ductility}: both must be "
                "positive"
            )
        strain = np.zeros((size, dim, dim))
        super().__init__(dim, strain=strain, kappa=threshold, threshold=threshold)

    @property
    def deviatoric_strain(self) -> np.ndarray:
        """Committed norm of dev e, (n,)."""
        return np.linalg.norm(self._deviator(self._state["strain"]), axis=(1, 2))

    @property
    def stress(self) -> np.ndarray:
        """Committed stress (n, d, d), Pa."""
        strain, kappa = self._state["strain"], self._state["kappa"]
        intact, _ = self._intact(kappa)
        return self._stress(strain, self._deviator(strain), intact)

    def evaluate(self, F: np.ndarray) -> np.ndarray:
        strain = self._state["strain"] + 0.5 * (F + F.transpose(0, 2, 1)) - np.eye(self.dim)
        deviator = self._deviator(strain)
        kappa = np.maximum(self._state["kappa"], np.linalg.norm(deviator, axis=(1, 2)))
        intact, fall = self._intact(kappa)
        self._trial = self._state | {"strain": strain, "kappa": kappa}
        self._last = (deviator, kappa, intact, fall)
        return self._stress(strain, deviator, intact)

    def _stress(self, strain: np.ndarray, deviator: np.ndarray, intact: np.ndarray) -> np.ndarray:
        mean = np.trace(strain, axis1=1, axis2=2)[:, None, None] * np.eye(self.dim)
        return self._bulk * mean + 2 * self._shear * intact[:, None, None] * deviator

    def _intact(self, kappa: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """1 - D, and its derivative by kappa."""
        ratio = kappa / self._state["threshold"]
        height, slope = self._curve(ratio)
        intact = height / ratio
        return intact, (slope - intact) / kappa

    def _curve(self, ratio: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The deviator over its peak, and its slope, at kappa / k0 >= 1."""
        height = np.exp((1 - ratio) / self._ductility)
        return height, -height / self._ductility

    def _deviator(self, strain: np.ndarray) -> np.ndarray:
        trace = np.trace(strain, axis1=1, axis2=2)[:, None, None]
        return strain - trace * np.eye(self.dim) / self.dim

    def tangent(self) -> np.ndarray:
        deviator, kappa, intact, fall = self._last
        delta, grows = np.eye(self.dim), kappa > self._state["kappa"]
        spheric = np.einsum("ij,kl->ijkl", delta, delta)
        symmetric = np.einsum("ik,jl->ijkl", delta, delta) + np.einsum("il,jk->ijkl", delta, delta)
        slope = np.where(grows, fall / kappa, 0.0)
        return (
            self._bulk * spheric
            + self._shear * intact[:, None, None, None, None] * (symmetric - 2 / self.dim * spheric)
            + 2 * self._shear * np.einsum("n,nij,nkl->nijkl", slope, deviator, deviator)
        )


class LinearShearSoftening(ShearSoftening):
    """The same with a straight branch behind the peak: 1 - D = (k0 / kappa) (1 - (kappa / k0 - 1)
    / m), and 0 from kappa = (1 + m) k0 on.

    In shear its softening modulus is 2 G / m wherever it softens, so that bands have a closed form.
    """

    def _curve(self, ratio: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        height = np.maximum(1 - (ratio - 1) / self._ductility, 0.0)
        return height, np.where(height > 0, -1 / self._ductility, 0.0)
