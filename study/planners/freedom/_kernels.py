"""What the strategies ask of the robot; numba picks the answer by the type of the simulation's shaft.

A *window* is two numbers that a voxel is reached with: the ends of a range of tilts for 4 degrees of
freedom, tilt and tip of one direction for 5. The burr's pose is a float64 array: layer, depth, lateral,
tilt, tip, and the two numbers of its window.
"""

from __future__ import annotations

from numba.extending import overload

from study.planners.pointing import _kernels as pointing
from study.planners.tilting import _kernels as tilting


def _kernels_for(sim):
    shaft = dict(zip(sim.fields, sim.types, strict=True))["shaft"]
    return tilting if shaft.instance_class.__name__ == "Shaft" else pointing


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


@overload(remove, inline="always")
def _remove(sim, layer, depth, lateral):
    answer = _kernels_for(sim).remove
    return lambda sim, layer, depth, lateral: answer(sim, layer, depth, lateral)


@overload(keep_up, inline="always")
def _keep_up(sim):
    answer = _kernels_for(sim).keep_up
    return lambda sim: answer(sim)


@overload(start_window, inline="always")
def _start_window(sim, layer, depth, lateral):
    answer = _kernels_for(sim).start_window
    return lambda sim, layer, depth, lateral: answer(sim, layer, depth, lateral)


@overload(window_from, inline="always")
def _window_from(sim, a, b, i, j, k, layer, depth, lateral):
    answer = _kernels_for(sim).window_from
    return lambda sim, a, b, i, j, k, layer, depth, lateral: answer(sim, a, b, i, j, k, layer, depth, lateral)


@overload(search_window, inline="always")
def _search_window(sim, a, b, i, j, k, layer, depth, lateral):
    answer = _kernels_for(sim).search_window
    return lambda sim, a, b, i, j, k, layer, depth, lateral: answer(sim, a, b, i, j, k, layer, depth, lateral)


@overload(passing, inline="always")
def _passing(sim, burr, a, b):
    answer = _kernels_for(sim).passing
    return lambda sim, burr, a, b: answer(sim, burr, a, b)


@overload(turn, inline="always")
def _turn(sim, burr, tilt, tip):
    answer = _kernels_for(sim).turn
    return lambda sim, burr, tilt, tip: answer(sim, burr, tilt, tip)


@overload(position_is_free, inline="always")
def _position_is_free(sim, layer, depth, lateral, tilt, tip):
    answer = _kernels_for(sim).position_is_free
    return lambda sim, layer, depth, lateral, tilt, tip: answer(sim, layer, depth, lateral, tilt, tip)


@overload(window_around, inline="always")
def _window_around(sim, tilt, tip, layer, depth, lateral):
    answer = _kernels_for(sim).window_around
    return lambda sim, tilt, tip, layer, depth, lateral: answer(sim, tilt, tip, layer, depth, lateral)


@overload(best_for_cut, inline="always")
def _best_for_cut(sim, burr, a, b, layer, depth, lateral):
    answer = _kernels_for(sim).best_for_cut
    return lambda sim, burr, a, b, layer, depth, lateral: answer(sim, burr, a, b, layer, depth, lateral)
