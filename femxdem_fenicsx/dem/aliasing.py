"""Tell LLVM that the arrays of a kernel do not overlap, so that it vectorises the kernel's loops.

Numba never says so by itself, and LLVM then reads every operand again after every store. For the
contact loop of `dynamics` the promise halves the time of a step (docs/performance.md).
"""

from llvmlite import ir
from numba import njit
from numba.core import types
from numba.extending import intrinsic

#: Options of every kernel: no GIL, cached on disk, and sums that may be reordered; NaN stays NaN.
kernel = njit(
    nogil=True,
    cache=True,
    error_model="numpy",
    fastmath={"reassoc", "contract", "arcp", "nsz"},
)


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
