"""Tell LLVM that the arrays of a kernel do not overlap, so that it vectorises the kernel's loops.

Numba never says so by itself, and LLVM then reads every operand again after every store. For the
contact loop of `dynamics` the promise halves the time of a step (docs/performance.md).
"""

import ast
import sys
from collections.abc import Callable, Iterable
from functools import cache
from hashlib import sha256
from pathlib import Path
from types import FunctionType

from llvmlite import ir
from numba import njit
from numba.core import types
from numba.core.caching import FunctionCache
from numba.extending import intrinsic

#: Strict IEEE arithmetic: numba's default, without `fastmath`. Sums keep their order and nothing is
#: contracted, so that a kernel gives the same bits on every CPU, cached or not, inlined or not.
_compile = njit(nogil=True, cache=True, error_model="numpy")


@cache
def fingerprint(path: Path) -> str:
    """Of a source file and of all files of this package that it imports, directly or not."""
    digest = sha256()
    for file in sorted(_with_imports(path)):
        digest.update(file.read_bytes())
    return digest.hexdigest()


@cache
def _with_imports(path: Path) -> frozenset[Path]:
    files, pending = set(), [path]
    while pending:
        file = pending.pop()
        files.add(file)
        pending.extend(_imports(file) - files)
    return frozenset(files)


@cache
def _imports(path: Path) -> frozenset[Path]:
    """Files of this package that a source file imports by relative imports."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.level:
            package = path.parents[node.level - 1]
            folder = package.joinpath(*node.module.split(".")) if node.module else package
            modules = [folder / name.name for name in node.names]
            if node.module:
                modules.append(folder)
            found.update(module.with_suffix(".py") for module in modules)
            found.update(module / "__init__.py" for module in modules)
    return frozenset(file for file in found if file.is_file())


def laws_among(arguments: Iterable[types.Type]) -> set[type]:
    """NamedTuples with methods among the types of a kernel's arguments: contact laws."""
    found = set()
    for kind in arguments:
        if isinstance(kind, types.BaseNamedTuple):
            members = vars(kind.instance_class).items()
            if any(isinstance(value, FunctionType) and name[0] != "_" for name, value in members):
                found.add(kind.instance_class)
        if isinstance(kind, types.BaseTuple):
            found |= laws_among(kind)
    return found


def can_be_imported(law: type) -> bool:
    """Whether another process can find this class: it is not of a script or a console."""
    module = sys.modules.get(law.__module__)
    return getattr(module, "__file__", None) is not None and law.__module__ != "__main__"


class KernelCache(FunctionCache):
    """Numba's cache on disk, but for two things that it does not know.

    A cached kernel holds copies of those that it calls, in other files. Numba would use it until
    its own file changes; here a change of any file that it depends on makes it be compiled anew.
    It holds copies of a contact law's methods, too. The key of a compiled kernel is hence a text
    with the fingerprints of its laws' files. (Numba's key is the types themselves; a process that
    cannot import somebody's law could not even read a list with that in it.)
    """

    def __init__(self, function: Callable):
        super().__init__(function)
        self._cache_file._source_stamp = fingerprint(Path(function.__code__.co_filename))

    def _index_key(self, arguments, codegen):
        files = sorted(
            (
                law.__module__,
                law.__qualname__,
                fingerprint(Path(sys.modules[law.__module__].__file__)),
            )
            for law in laws_among(arguments)
        )
        return (str(arguments), *files, *super()._index_key(arguments, codegen)[1:])

    def load_overload(self, arguments, target_context):
        if all(map(can_be_imported, laws_among(arguments))):
            return super().load_overload(arguments, target_context)

    def save_overload(self, arguments, data):
        if all(map(can_be_imported, laws_among(arguments))):
            super().save_overload(arguments, data)


def kernel(function: Callable):
    """Compile a kernel: no GIL, cached on disk, strict IEEE arithmetic."""
    compiled = _compile(function)
    compiled._cache = KernelCache(function)
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
