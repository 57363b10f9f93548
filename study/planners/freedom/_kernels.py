"""What the strategies ask of the robot; numba picks the answer by the type of the simulation's shaft.

A *window* is two numbers that a voxel is reached with: the ends of a range of tilts for 4 degrees of
freedom, tilt and tip of one direction for 5. The burr's pose is a float64 array: layer, depth, lateral,
tilt, tip, and the two numbers of its window.
"""

from __future__ import annotations

from numba.extending import overload

from study.planners.pointing import _kernels as pointing
from study.planners.tilting import _kernels as tilting


def _answer(sim, name):
    shaft = dict(zip(sim.fields, sim.types, strict=True))["shaft"]
    kernels = tilting if shaft.instance_class.__name__ == "Shaft" else pointing
    return getattr(kernels, name).py_func


def remove(sim, layer, depth, lateral):
    """Take a voxel, just milled, out of what the shaft can meet."""


def keep_up(sim):
    """After a decision: bring up to date what may lag behind."""


def start_window(sim, layer, depth, lateral):
    """(accessible, window) of a voxel to start from, out of the air."""


def window_from(sim, a, b, i, j, k, layer, depth, lateral):
    """(accessible, window) of a voxel, coming from the voxel (i, j, k) with the window (a, b)."""


def search_window(sim, a, b, i, j, k, layer, depth, lateral):
    """The same for a search over many voxels, which may use what earlier searches found."""


def passing(sim, burr, a, b):
    """Tilt and tip at which to pass from the burr's window to the window (a, b)."""


def turn(sim, burr, tilt, tip):
    """Turn the shaft in place."""


def position_is_free(sim, layer, depth, lateral, tilt, tip):
    """Whether the shaft is free at a fractional position."""


def window_around(sim, tilt, tip, layer, depth, lateral):
    """(free, window) of a pose the burr has been at."""


def best_for_cut(sim, burr, a, b, layer, depth, lateral):
    """The window by which to go to an accessible voxel: (a, b), or a better one for cutting there."""


@overload(remove)
def _remove(sim, layer, depth, lateral):
    return _answer(sim, "remove")


@overload(keep_up)
def _keep_up(sim):
    return _answer(sim, "keep_up")


@overload(start_window)
def _start_window(sim, layer, depth, lateral):
    return _answer(sim, "start_window")


@overload(window_from)
def _window_from(sim, a, b, i, j, k, layer, depth, lateral):
    return _answer(sim, "window_from")


@overload(search_window)
def _search_window(sim, a, b, i, j, k, layer, depth, lateral):
    return _answer(sim, "search_window")


@overload(passing)
def _passing(sim, burr, a, b):
    return _answer(sim, "passing")


@overload(turn)
def _turn(sim, burr, tilt, tip):
    return _answer(sim, "turn")


@overload(position_is_free)
def _position_is_free(sim, layer, depth, lateral, tilt, tip):
    return _answer(sim, "position_is_free")


@overload(window_around)
def _window_around(sim, tilt, tip, layer, depth, lateral):
    return _answer(sim, "window_around")


@overload(best_for_cut)
def _best_for_cut(sim, burr, a, b, layer, depth, lateral):
    return _answer(sim, "best_for_cut")
