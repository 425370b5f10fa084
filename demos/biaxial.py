# # Drained biaxial compression of a granular specimen
#
# A specimen of 50 mm x 100 mm stands between smooth plates under a lateral pressure of 100 kPa.
# The upper plate moves down; past the peak the deformation localises in a shear band
# (Guo and Zhao 2014, section 4; Desrues et al. 2019, section 4.5). This demo shows how to
#
# - prepare a packing of grains, or read one from a file
# - let one copy of it answer for the material at every quadrature point
# - solve the equilibrium of the specimen step by step, with cut steps where it is needed
# - write fields, a table and pictures
#
# Run it with `.venv/bin/python demos/biaxial.py --help`, or under `mpirun -n 2`.

import argparse
from pathlib import Path
from time import perf_counter

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from femxdem_fenicsx import arguments as shared
from femxdem_fenicsx import plotting, script
from femxdem_fenicsx.collective import together
from femxdem_fenicsx.compression import (
    Run,
    Specimen,
    load,
    packing_at_extreme,
    save_curves,
    tell,
)
from femxdem_fenicsx.dem.files import save_packing
from femxdem_fenicsx.dem.packing import Packing
from femxdem_fenicsx.fem.elements import element
from femxdem_fenicsx.fem.external_operator import ExternalOperator
from femxdem_fenicsx.fem.output import writable_folder
from femxdem_fenicsx.fem.problem import Problem
from femxdem_fenicsx.fem.quadrature_points import QuadraturePoints
from femxdem_fenicsx.plane_strain import PlaneStrain
from forms.first_gradient import FORMULATIONS
from forms.media import medium_for
from meshes.rectangle import BOTTOM, LEFT, RIGHT, TOP, rectangle, sides, vertex_near

#: Largest strain of a point in one load step, over the step's axial strain: beyond it, cut.
LARGEST_INCREMENT = 30
#: Where dents are on the left and on the right, in heights: a band at 52 degrees joins them.
DENTS = (0.18, 0.82)


# ## The scene
#
# Everything that a user may want to change has an option. With `--dim 3` the grains are spheres,
# and the specimen is in plane strain.


def arguments() -> argparse.ArgumentParser:
    parser = shared.parser("Drained biaxial compression, FEM x DEM.")
    specimen = parser.add_argument_group("specimen")
    specimen.add_argument("--width", type=float, default=0.05, help="m")
    specimen.add_argument("--height", type=float, default=0.1, help="m")
    specimen.add_argument(
        "--imperfection",
        type=float,
        default=0.0,
        help="depth of a dent in each side, share of the width",
    )
    shared.add_discretisation(specimen, 2, (6, 12), "Q4", FORMULATIONS)
    shared.add_variability(specimen)
    grains = shared.add_grains(parser, 400, "disks, or spheres")
    grains.add_argument("--dim", type=int, default=2, help="2: disks, 3: spheres, in plane strain")
    shared.add_compression(parser, strain=0.04)
    shared.add_solution(parser)
    shared.add_output(parser, "results/biaxial")
    return parser


# ## The boundary value problem
#
# Find the displacement $u$ of a load step such that the internal forces of the stress
# $\sigma(F)$, $F = I + \nabla u$, balance the pressure on the sides. The stress comes from the
# grains through an external operator. The plates are smooth: they prescribe $u_y$ alone, and one
# point is held so that the specimen cannot drift sideways.


def specimen_for(args: argparse.Namespace, packing: Packing, comm: MPI.Comm) -> Specimen:
    kind = element(args.element, args.points)
    mesh = rectangle(comm, args.width, args.height, *args.mesh, kind)
    tags = sides(mesh, args.width, args.height)
    dent(mesh, args.imperfection, args.width, args.height)
    points = QuadraturePoints(mesh, kind)
    law = shared.law_for(args, packing, points, comm)
    if packing.dim == 3:
        law = PlaneStrain(law)
    medium = medium_for(args, points)
    sigma = ExternalOperator(medium.F, law, points, LARGEST_INCREMENT * args.step, medium.states)

    ds = kind.ds(mesh, tags)
    p = fem.Constant(mesh, args.pressure)
    residual, jacobian = medium.equilibrium(sigma.stress, sigma.tangent, [(p, ds((LEFT, RIGHT)))])

    V_x, V_y = medium.space.sub(0), medium.space.sub(1)
    descent, zero = fem.Constant(mesh, 0.0), fem.Constant(mesh, 0.0)
    top = fem.locate_dofs_topological(V_y, 1, tags.find(TOP))
    bottom = fem.locate_dofs_topological(V_y, 1, tags.find(BOTTOM))
    held = fem.locate_dofs_topological(V_x, 0, vertex_near(mesh, args.width / 2, 0.0))
    bcs = [
        fem.dirichletbc(descent, top, V_y),
        fem.dirichletbc(zero, bottom, V_y),
        fem.dirichletbc(zero, held, V_x),
        *medium.straight(tags.find(TOP), normal=1, component=1),
        *medium.straight(tags.find(BOTTOM), normal=1, component=1),
    ]
    problem = Problem(medium.unknown, residual, jacobian, sigma, bcs, shared.convergence_of(args))
    return Specimen(problem, descent, top, args.height, args.pressure)


# The specimen is homogeneous, so that a shear band may start anywhere. Two smooth dents, low on the
# left and high on the right, give it its place, the same in every mesh. At the beginning the stress
# is isotropic, so that the dented specimen is in equilibrium too.


def dent(mesh, depth: float, width: float, height: float) -> None:
    x, y = mesh.geometry.x[:, 0] / width, mesh.geometry.x[:, 1] / height
    left, right = (np.exp(-(((y - place) / 0.08) ** 2)) for place in DENTS)
    mesh.geometry.x[:, 0] += depth * width * (left * (1 - x) - right * x)


# ## Loading
#
# `load` goes along the load path and cuts steps where the iteration fails. After every accepted
# step it writes a row of the table and the fields, and every now and then a checkpoint.


def compress(specimen: Specimen, args: argparse.Namespace) -> Run:
    stepping, saving = shared.stepping_of(args), shared.saving_of(args, specimen.law)
    return load(
        specimen, args.strain, stepping, args.output / "biaxial", args.quiet, saving, args.fields
    )


# ## Results


def pictures(specimen: Specimen, rows: list[dict[str, float]], folder: Path) -> None:
    law, points, comm = specimen.law, specimen.points, specimen.mesh.comm
    strain = law.deviatoric_strain
    cells = points.gather(
        points.cell_corners(), points.cell_means(strain), points.cell_means(law.void_ratio)
    )
    inside = packing_at_extreme(specimen, strain)
    outside = packing_at_extreme(specimen, -strain)

    def save() -> None:
        if comm.rank > 0:
            return
        corners, deviatoric_strain, void_ratio = cells
        plotting.save_fields(
            folder / "fields.png",
            corners,
            [("deviatoric strain", deviatoric_strain), ("void ratio", void_ratio)],
        )
        chains = [("in the band", inside), ("outside the band", outside)]
        if inside.dim == 2:
            plotting.save_force_chains(folder / "force_chains.png", chains)
        for name, packing in chains:
            save_packing(folder / f"packing_{name.split()[0]}.h5", packing)
        if rows:
            save_curves(folder / "history.png", rows)

    together(comm, save)


def main(comm: MPI.Comm) -> int:
    started = perf_counter()
    args = script.parse(arguments(), comm)
    shared.check(args, 2, FORMULATIONS)
    if not 0 <= args.imperfection < 0.2:
        raise ValueError(f"--imperfection {args.imperfection}: it must be in [0, 0.2)")
    writable_folder(comm, args.output)
    specimen = specimen_for(args, shared.packing_for(args, comm, args.dim), comm)
    run = compress(specimen, args)
    if not run.signal:
        pictures(specimen, run.rows, args.output)
    seconds = perf_counter() - started
    return tell("Drained biaxial compression", specimen, run, seconds, args.quiet)


if __name__ == "__main__":
    script.run(main)
