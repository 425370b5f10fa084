"""Tell LLVM that the arrays of a kernel do not overlap, so that it vectorises the kernel's loops.

Numba never says so by itself, and LLVM then reads every operand again after every store. For the
contact loop of `dynamics` the promise halves the time of a step (docs/performance.md).
"""

from collections.abc import Callable
from hashlib import sha256
from pathlib import Path

from llvmlite import ir
from numba import njit
from numba.core import types
from numba.extending import intrinsic

_compile = njit(
    nogil=True,
    cache=True,
    error_model="numpy",
    fastmath={"reassoc", "contract", "arcp", "nsz"},
)


def _fingerprint() -> str:
    """Of all sources of the kernels."""
    digest = sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


FINGERPRINT = _fingerprint()


def kernel(function: Callable):
    """Compile a kernel: no GIL, cached on disk, sums may be reordered, NaN stays NaN.

    A cached kernel holds copies of those that it calls, in other files. Numba would use it until
    its own file changes; here any change of `dem` makes all of them be compiled anew.
    """
    compiled = _compile(function)
    try:
        compiled._cache._cache_file._source_stamp = FINGERPRINT
    except AttributeError:  # a Numba that keeps its cache otherwise looks at the function's file
        pass
    return compiled


@intrinsic
def arrays_do_not_overlap(typingctx):
    """First line of a kernel: promise that no two array arguments share memory (C's `restrict`)."""

    def generate(context, builder, signature, args):
        function = builder.function
        for argument in function.args:
            if isinstance(argument.type, ir.PointerType):
                argument.add_attribute("noalias")
        function.attributes.add("noinline")  # inlined, the promise would be lost
        return context.get_dummy_value()

    return types.void(), generate


@intrinsic
def stays_out_of_line(typingctx):
    """First line of a kernel: never copy it into its callers.

    It is then compiled once, and gives the same bits wherever it is called from.
    """

    def generate(context, builder, signature, args):
        builder.function.attributes.add("noinline")
        return context.get_dummy_value()

    return types.void(), generate
