"""Packings in which nothing slides, at rest to the last digits, and their derivative."""

import numpy as np

from femxdem_fenicsx.dem.accuracy import PRESETS
from femxdem_fenicsx.dem.packing import Packing
from femxdem_fenicsx.dem.response import Response
from femxdem_fenicsx.dem.tangents import operator

EXACT = PRESETS["fast"].but(tolerance=1e-10, hold_limit=40000)


def at_rest(packing: Packing, F=None, accuracy=EXACT) -> Response:
    """The packing deformed by F (d, d), I by default, and committed where it is at rest."""
    response = Response(packing, 1, accuracy)
    F = np.eye(packing.dim) if F is None else np.array(F)
    response.deform(F[None])
    response.commit()
    return response


def derivative(response: Response, step: float) -> np.ndarray:
    """C (d, d, d, d), Pa, by central differences of the response."""
    dim = response.latest.template.dim
    C = np.zeros((dim,) * 4)
    for k, m in np.ndindex(dim, dim):
        dF = np.zeros((1, dim, dim))
        dF[0, k, m] = step
        plus = response.deform(np.eye(dim) + dF).stress[0]
        minus = response.deform(np.eye(dim) - dF).stress[0]
        C[:, :, k, m] = (plus - minus) / (2 * step)
    response.discard()
    return C


def tangent(name: str, response: Response) -> np.ndarray:
    """C (d, d, d, d), Pa, of the first packing as it stands."""
    dim = response.latest.template.dim
    return operator(name)(response, np.tile(np.eye(dim), (response.size, 1, 1)))[0]
