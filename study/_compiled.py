"""How this package compiles its kernels, and where numba keeps them.

`kernel` compiles a function that Python calls, `inner` one that only other kernels call: leaving out
the wrappers that nobody uses takes a quarter off the first compilation.

Compiled kernels are kept in one folder for each state of their sources. Numba notices when the file
of a cached function changes, but not when a function it calls, in another file, does: after an update
a planner would go on with yesterday's collision check. So the folder's name carries a digest of every
kernel source.
"""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

import numba

PACKAGE = Path(__file__).parent

kernel = numba.njit(cache=True, no_cfunc_wrapper=True)
inner = numba.njit(cache=True, no_cfunc_wrapper=True, no_cpython_wrapper=True)
# Lets other threads run meanwhile: for kernels of which two may work on two halves of the same arrays.
threaded = numba.njit(cache=True, no_cfunc_wrapper=True, nogil=True)
# Copied into its callers before they are compiled: a function of its own would carry all it calls along
# through the optimiser once more. For thin functions over large ones.
inlined = numba.njit(inline="always")


def kernel_digest(package: Path = PACKAGE) -> str:
    """Digest of all ``_kernels.py`` below `package` and of numba's version."""
    digest = hashlib.sha256(numba.__version__.encode())
    for source in sorted(package.rglob("_kernels.py")):
        digest.update(str(source.relative_to(package)).encode())
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


def use_versioned_cache() -> None:
    """Point numba at this state's folder, below the user's NUMBA_CACHE_DIR or beside the package.

    Where neither can be written numba's own default stays.
    """
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    base = Path(chosen) if chosen else PACKAGE / "__pycache__"
    try:
        base.mkdir(parents=True, exist_ok=True)
    except OSError:
        return
    if os.access(base, os.W_OK):
        numba.config.CACHE_DIR = str(base / f"kernels-{kernel_digest()}")
