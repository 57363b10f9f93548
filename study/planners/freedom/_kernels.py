"""What the strategies ask of the robot; numba picks the answer by the type of the simulation's shaft.

A *window* is two numbers that a voxel is reached with: the ends of a range of tilts for 4 degrees of
freedom, tilt and tip of one direction for 5. The burr's pose is a float64 array: layer, depth, lateral,
tilt, tip, and the two numbers of its window.
"""

from __future__ import annotations

from numba.core import types
from numba.core.typing.templates import AbstractTemplate, infer_global

from study.collision._kernels import Shaft
from study.planners.pointing import _kernels as pointing
from study.planners.tilting import _kernels as tilting


def asked_of_the_robot(question):
    """Numba compiles a call of `question` as one of the robot's kernel of the same name.

    Not by `numba.extending.overload`, which would put a function of its own in between and compile all
    that the kernel calls once more for it.
    """

    class Answer(AbstractTemplate):
        key = question

        def generic(self, args, kws):
            kernels = tilting if args[0].type_of("shaft").instance_class is Shaft else pointing
            self._kernel = types.Dispatcher(getattr(kernels, question.__name__))
            return self._kernel.get_call_type(self.context, args, kws)

        def get_impl_key(self, sig):
            return self._kernel.get_impl_key(sig)

    infer_global(question, types.Function(Answer))
    return question


@asked_of_the_robot
def remove(sim, layer, depth, lateral):
    """Take a voxel, just milled, out of what the shaft can meet."""


@asked_of_the_robot
def keep_up(sim):
    """After a decision: bring up to date what may lag behind."""


@asked_of_the_robot
def start_window(sim, layer, depth, lateral):
    """(accessible, window) of a voxel to start from, out of the air."""


@asked_of_the_robot
def window_from(sim, a, b, i, j, k, layer, depth, lateral):
    """(accessible, window) of a voxel, coming from the voxel (i, j, k) with the window (a, b)."""


@asked_of_the_robot
def search_window(sim, a, b, i, j, k, layer, depth, lateral):
    """The same for a search over many voxels, which may use what earlier searches found."""


@asked_of_the_robot
def passing(sim, burr, a, b):
    """Tilt and tip at which to pass from the burr's window to the window (a, b)."""


@asked_of_the_robot
def turn(sim, burr, tilt, tip):
    """Turn the shaft in place."""


@asked_of_the_robot
def position_is_free(sim, layer, depth, lateral, tilt, tip):
    """Whether the shaft is free at a fractional position."""


@asked_of_the_robot
def window_around(sim, tilt, tip, layer, depth, lateral):
    """(free, window) of a pose the burr has been at."""


@asked_of_the_robot
def best_for_cut(sim, burr, a, b, layer, depth, lateral):
    """The window by which to go to an accessible voxel: (a, b), or a better one for cutting there."""
