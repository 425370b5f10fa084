"""Finite elements of the displacement, each with its quadrature points."""

from __future__ import annotations

from dataclasses import dataclass

import ufl

from . import _dolfinx

#: What the micro-strain of a second-gradient continuum can be within a cell.
MICRO_STRAINS = ("linear", "quadratic")


@dataclass(frozen=True)
class Element:
    """A displacement element and the quadrature rule of the law's points.

    Attributes:
        name: Q4, Q8, Q9 or T6 in 2D; H8, H27, T4 or T10 in 3D.
        cell: "quadrilateral", "triangle", "hexahedron" or "tetrahedron".
        degree: degree of the displacement, and of the mesh's geometry that moves with it.
        quadrature_degree: degree that Basix' default scheme integrates exactly.
        points_per_cell: number of quadrature points.
    """

    name: str
    cell: str
    degree: int
    quadrature_degree: int
    points_per_cell: int

    @property
    def dim(self) -> int:
        """Dimension of the space that it fills."""
        return 2 if self.cell in ("quadrilateral", "triangle") else 3

    def check_dim(self, dim: int) -> None:
        """Raise ValueError, with the elements to choose from, where it is for another dimension."""
        if self.dim != dim:
            known = ", ".join(names(dim))
            raise ValueError(f"element {self.name} is for {self.dim}D: choose one of {known}")

    def space(self, mesh):
        """Space of displacements (m) on a mesh made for this element."""
        return _dolfinx.functionspace(mesh, self.nodal((mesh.geometry.dim,)))

    def nodal(self, shape: tuple[int, ...]):
        """Finite element of tensors of that shape, () for scalars, with its nodes."""
        if self.name == "Q8":
            return _dolfinx.serendipity_element(shape)
        return _dolfinx.lagrange_element(self.cell, self.degree, shape)

    def check_second_gradient(self, micro_strain: str = "linear") -> None:
        """Raise ValueError, with what to choose from, where there is no mixed space."""
        if self.degree != 2:
            every = (next(iter(ELEMENTS[name].values())) for name in names(self.dim))
            known = ", ".join(other.name for other in every if other.degree == 2)
            raise ValueError(
                f"element {self.name} has no mixed space for the second gradient: choose one of "
                f"{known}"
            )
        if micro_strain not in MICRO_STRAINS:
            known = ", ".join(MICRO_STRAINS)
            raise ValueError(f"unknown micro-strain '{micro_strain}'; choose from {known}")
        if micro_strain == "quadratic" and self.cell != "quadrilateral":
            raise ValueError(f"a quadratic micro-strain needs element Q8 or Q9, not {self.name}")

    def second_gradient_space(self, mesh, micro_strain: str = "linear"):
        """Space of (u, nu, lambda): this element's u, linear nu, lambda constant in each cell.

        nu and lambda are (d, d) tensors (Desrues section 4.3). On triangles and tetrahedra lambda
        is linear and continuous: a constant one is not stable there (docs/second-gradient.md).

        Args:
            mesh: made for this element.
            micro_strain: "linear", or "quadratic": each component of nu is then in the space of a
                component of u, which follows a band that is few elements wide better.

        Raises:
            ValueError: an element of degree one, which has no space that is stable, an unknown
                micro-strain, and a quadratic one on other cells than quadrilaterals.
        """
        self.check_second_gradient(micro_strain)
        d = mesh.geometry.dim
        linear = _dolfinx.lagrange_element(self.cell, 1, (d, d))
        micro = linear if micro_strain == "linear" else self.nodal((d, d))
        boxes = self.cell in ("quadrilateral", "hexahedron")
        multiplier = _dolfinx.discontinuous_element(self.cell, (d, d)) if boxes else linear
        mixed = _dolfinx.mixed_element([self.nodal((d,)), micro, multiplier])
        return _dolfinx.functionspace(mesh, mixed)

    def dx(self, mesh) -> ufl.Measure:
        """Volume measure on this element's quadrature points."""
        rule = {"quadrature_degree": self.quadrature_degree, "quadrature_scheme": "default"}
        return ufl.Measure("dx", domain=mesh, metadata=rule)

    def ds(self, mesh, sides=None) -> ufl.Measure:
        """Boundary measure, exact for a follower pressure; `sides`: facet MeshTags."""
        rule = {"quadrature_degree": 2 * self.degree}
        return ufl.Measure("ds", domain=mesh, subdomain_data=sides, metadata=rule)


# name -> points -> element; the first choice of points is the default
ELEMENTS = {
    "Q4": {"2x2": Element("Q4", "quadrilateral", 1, 2, 4)},
    "Q8": {
        "2x2": Element("Q8", "quadrilateral", 2, 2, 4),
        "3x3": Element("Q8", "quadrilateral", 2, 4, 9),
    },
    "Q9": {"3x3": Element("Q9", "quadrilateral", 2, 4, 9)},
    "T6": {"3": Element("T6", "triangle", 2, 2, 3)},
    "H8": {"2x2x2": Element("H8", "hexahedron", 1, 2, 8)},
    "H27": {"3x3x3": Element("H27", "hexahedron", 2, 4, 27)},
    "T4": {"1": Element("T4", "tetrahedron", 1, 1, 1)},
    "T10": {"4": Element("T10", "tetrahedron", 2, 2, 4)},
}


def names(dim: int) -> list[str]:
    """Names of the elements for that dimension."""
    return [name for name, choices in ELEMENTS.items() if next(iter(choices.values())).dim == dim]


def element(name: str, points: str | None = None) -> Element:
    """The element `name`, with `points` ("2x2", "3x3", "3", ...) or its default quadrature.

    Raises:
        ValueError: unknown element, or points that this element cannot have. Q9 with 2x2 points
            has hourglass modes: its stiffness is singular and the solver does not notice.
    """
    if name not in ELEMENTS:
        raise ValueError(f"element {name!r} is unknown: choose one of {', '.join(ELEMENTS)}")
    choices = ELEMENTS[name]
    if points is None:
        return next(iter(choices.values()))
    if points not in choices:
        known = " or ".join(choices)
        reason = " (2x2 is singular: hourglass modes)" if (name, points) == ("Q9", "2x2") else ""
        raise ValueError(f"element {name} cannot have {points} points{reason}: choose {known}")
    return choices[points]
