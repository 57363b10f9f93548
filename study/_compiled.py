"""How this package compiles its kernels, and where numba keeps them.

`kernel` compiles a function that Python calls, `inner` one that only other kernels call: leaving out
the wrappers that nobody uses takes a quarter off the first compilation.

Numba notices when the file of a cached function changes, but not when a function it calls, in another
file, does: after an update a planner would go on with yesterday's collision check. So each room's
compiled kernels are kept in a folder whose name carries a digest of their source and of all sources of
the package that it imports, and those import: a change recompiles the kernels it can reach, and leaves
the other rooms' alone.
"""

from __future__ import annotations

import ast
import hashlib
import inspect
import os
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import numba

PACKAGE = Path(__file__).resolve().parent


@cache
def _names_imported(source: bytes) -> tuple[str, ...]:
    """Dotted names that a source text imports; kept, since many rooms import the same files."""
    names = []
    for item in ast.walk(ast.parse(source)):
        if isinstance(item, ast.Import):
            names += [name.name for name in item.names]
        elif isinstance(item, ast.ImportFrom) and not item.level:
            names += [f"{item.module}.{name.name}" for name in item.names]
    return tuple(names)


def _sources_imported(source: Path, package: Path) -> Iterator[Path]:
    """Files of the package that a file imports; for a name out of a module, the module's."""
    for name in _names_imported(source.read_bytes()):
        top, *parts = name.split(".")
        if top == package.name:
            path = package.joinpath(*parts)
            choices = (path.with_suffix(".py"), path / "__init__.py", path.parent.with_suffix(".py"))
            yield next((c for c in choices if c.is_file()), path.parent / "__init__.py")


def kernel_sources(source: Path, package: Path = PACKAGE) -> set[Path]:
    """A file and all files of the package that what it compiles can come from.

    A file outside of the package, or one of its plain modules, may call any kernel.
    """
    within = source.name == "_kernels.py" and source.is_relative_to(package)
    waiting = [source] if within else [source, *package.rglob("_kernels.py")]
    found = set()
    while waiting:
        file = waiting.pop()
        if file not in found:
            found.add(file)
            waiting += _sources_imported(file, package)
    return found


def kernel_digest(source: Path, package: Path = PACKAGE) -> str:
    """Digest of `kernel_sources` and of numba's version."""
    digest = hashlib.sha256(numba.__version__.encode())
    for file in sorted(kernel_sources(source, package)):
        digest.update(os.path.relpath(file, package).encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


@cache
def _cache_folder(source: Path) -> str | None:
    """Where the compiled kernels of a file are kept; None where numba's own default has to do.

    Below the user's NUMBA_CACHE_DIR, or beside the package.
    """
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    base = Path(chosen) if chosen else PACKAGE / "__pycache__"
    try:
        base.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    if not os.access(base, os.W_OK):
        return None
    room = source.parent.relative_to(PACKAGE).parts if source.is_relative_to(PACKAGE) else ("others",)
    return str(base / f"kernels-{'.'.join(room)}-{kernel_digest(source, PACKAGE)}")


def _njit(function: Callable, **options) -> Callable:
    file = Path(inspect.getfile(function))
    folder = _cache_folder(file.resolve()) if file.is_file() else None  # no file: typed in somewhere
    before = numba.config.CACHE_DIR
    try:
        # Numba reads it when a function is decorated.
        numba.config.CACHE_DIR = folder or before
        return numba.njit(cache=True, no_cfunc_wrapper=True, **options)(function)
    finally:
        numba.config.CACHE_DIR = before


def kernel(function: Callable) -> Callable:
    """Compile a function that Python calls."""
    return _njit(function)


def inner(function: Callable) -> Callable:
    """Compile a function that only other compiled ones call."""
    return _njit(function, no_cpython_wrapper=True)


def threaded(function: Callable) -> Callable:
    """Compile a function that lets other threads run meanwhile.

    For kernels of which two may work on two halves of the same arrays.
    """
    return _njit(function, nogil=True)


# Copied into its callers before they are compiled: a function of its own would carry all it calls along
# through the optimiser once more. For thin functions over large ones; large functions take numba more
# time in one piece.
inlined = numba.njit(inline="always")
