"""Tell LLVM that the arrays of a kernel do not overlap, so that it vectorises the kernel's loops.

Numba never says so by itself, and LLVM then reads every operand again after every store. For the
contact loop of `dynamics` the promise halves the time of a step (docs/performance.md).
"""

from collections.abc import Callable

from llvmlite import ir
from numba import njit
from numba.core import types
from numba.extending import intrinsic

from .kernel_cache import cache_of

#: Strict IEEE arithmetic: numba's default, without `fastmath`. Sums keep their order and nothing is
#: contracted, so that a kernel gives the same bits on every CPU, cached or not, inlined or not.
_compile = njit(nogil=True, error_model="numpy")


def kernel(function: Callable):
    """Compile a kernel: no GIL, cached on disk if possible, strict IEEE arithmetic."""
    compiled = _compile(function)
    compiled._cache = cache_of(function)
    return compiled


#: A part of kernels, copied into them as if it were written there: it costs no compilation of its
#: own, where a kernel that calls another is compiled together with it once more.
part_of_kernels = njit(inline="always")


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
def next_ticket(typingctx, tickets):
    """tickets[0]++ of an int64 array (1,), returning the old value; safe among threads."""

    def generate(context, builder, signature, args):
        array = context.make_array(signature.args[0])(context, builder, args[0])
        return builder.atomic_rmw("add", array.data, ir.Constant(ir.IntType(64), 1), "monotonic")

    return types.int64(tickets), generate
