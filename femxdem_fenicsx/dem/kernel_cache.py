"""Compiled kernels on disk, for the next process. A help, never a condition.

Whatever is wrong with the folder or its files, a kernel is compiled; the process is warned once.
"""

import ast
import pickle
import sys
import warnings
from collections.abc import Callable, Iterable
from functools import cache
from hashlib import sha256
from pathlib import Path
from types import FunctionType
from uuid import uuid4

import numba
from numba.core import config, types
from numba.core.caching import FunctionCache, NullCache
from numba.core.serialize import dumps

#: The warning of this process, once it has been given.
_given: list[str] = []


def warn_once(folder: Path | str, trouble: str) -> None:
    """Say, once in a process and in one line, why kernels are not kept and what helps."""
    if not _given:
        _given.append(
            f"numba's cache in {folder} cannot serve every kernel ({' '.join(trouble.split())}),"
            " processes compile anew: set NUMBA_CACHE_DIR to a folder that can be written and has"
            " space left"
        )
        # below the whole stack: a second line with somebody's source would explain nothing
        warnings.warn(_given[0], stacklevel=sys.getrecursionlimit())


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
    for node in ast.walk(ast.parse(path.read_bytes())):
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


class KernelFiles:
    """The compiled kernels of one function, each in a file of its own, named after its key.

    Numba's own files are an index and numbered data. The index is replaced before the data, and
    two processes may give one number to different kernels; it can then lead to a kernel for other
    arguments, or to one of an older source. Here a file begins with a digest of all that it must
    agree with: numba, the source, the key, the data. Cut off, damaged, outdated or of another
    kernel, it counts as missing, and what is compiled instead replaces it.
    """

    def __init__(self, folder: Path, name: str, source: str):
        self.folder, self.name, self.source = folder, name, source

    def path(self, key: tuple) -> Path:
        """Of the file with this key."""
        return self.folder / f"{self.name}.{sha256(repr(key).encode()).hexdigest()[:24]}.nbc"

    def _digest(self, key: tuple, data: bytes) -> bytes:
        identity = repr((numba.__version__, self.source, key, len(data)))
        return sha256(identity.encode() + data).digest()

    def load(self, key: tuple):
        """What was saved with this key; None without a file that agrees with it."""
        try:
            content = self.path(key).read_bytes()
        except OSError:
            return None
        digest, data = content[: sha256().digest_size], content[sha256().digest_size :]
        return pickle.loads(data) if digest == self._digest(key, data) else None

    def save(self, key: tuple, compiled) -> None:
        """Write aside and rename: others see the old file or the whole new one."""
        data, path = dumps(compiled), self.path(key)
        # processes on two machines that share the folder can have one number
        aside = path.with_name(f"{path.name}.{uuid4().hex}")
        try:
            aside.write_bytes(self._digest(key, data) + data)
            aside.replace(path)
        finally:
            aside.unlink(missing_ok=True)

    def flush(self) -> None:
        """Forget all kernels of the function."""
        for path in self.folder.glob(f"{self.name}.*.nbc"):
            path.unlink(missing_ok=True)


class KernelCache(FunctionCache):
    """Numba's cache on disk, but with `KernelFiles`, and for two things that it does not know.

    A cached kernel holds copies of those that it calls, in other files. Numba would use it until
    its own file changes; here a change of any file that it depends on makes it be compiled anew.
    It holds copies of a contact law's methods, too. The key of a compiled kernel is hence a text
    with the fingerprints of its laws' files. (Numba's key is the types themselves, whose text
    alone would not tell two laws of one name apart.)
    """

    def __init__(self, function: Callable):
        super().__init__(function)
        source = fingerprint(Path(function.__code__.co_filename))
        self._cache_file = KernelFiles(Path(self.cache_path), self._impl.filename_base, source)

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
        """The kernel for these arguments; None if it must be compiled."""
        if all(map(can_be_imported, laws_among(arguments))):
            try:
                return super().load_overload(arguments, target_context)
            except Exception as error:  # whatever it is, compiling does not need the file
                warn_once(self.cache_path, f"{type(error).__name__}: {error}")

    def save_overload(self, arguments, data):
        """Keep a kernel, if its laws can be found again and the folder takes it."""
        if all(map(can_be_imported, laws_among(arguments))):
            try:
                super().save_overload(arguments, data)
            except Exception as error:  # whatever it is, the kernel is there
                warn_once(self.cache_path, f"{type(error).__name__}: {error}")


class NoCache(NullCache):
    """Of a function for which no folder can be written; the first kernel compiled says so."""

    def __init__(self, function: Callable, trouble: str):
        beside = Path(function.__code__.co_filename).parent / "__pycache__"
        self.folder, self.trouble = config.CACHE_DIR or beside, trouble

    def save_overload(self, arguments, data):
        """Warn; not before: a process that compiles nothing misses nothing."""
        warn_once(self.folder, self.trouble)


def cache_of(function: Callable) -> KernelCache | NoCache:
    """A function's cache; one that keeps nothing where there is no folder or no source file."""
    try:
        return KernelCache(function)
    except (OSError, RuntimeError) as error:
        return NoCache(function, str(error))
