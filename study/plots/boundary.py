"""Figures 2.11 and 2.12: what the target boundary is for, computed on one plane.

The two-dimensional miller here is the framework in its smallest form: a disc for the burr, a square
for the supervoxel, no shaft. It exists for these figures; plans are made by `study.planners`.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from scipy import ndimage

from study.errors import InputError
from study.plots.modified import BURR, circle
from study.plots.palette import STYLES
from study.plots.style import legend_below, new_axes, patches, show_labels, styled
from study.volumes import ball_element

AIR, PROTECTED, TARGET, BOUNDARY, REMOVED = range(5)
NAMES = {
    AIR: "air",
    PROTECTED: "protected",
    TARGET: "target",
    BOUNDARY: "target_boundary",
    REMOVED: "removed",
}
FACES = ((0, 1), (0, -1), (1, 0), (-1, 0))


@dataclass(frozen=True, eq=False)
class FlatMilling:
    """A milled plane.

    Attributes
    ----------
    segmented : (n, m) uint8 array
        AIR, PROTECTED, TARGET.
    modified : (n, m) uint8 array
        The same after erosion, with BOUNDARY if it is used.
    modified_end, unmodified_end : (n, m) uint8 arrays
        Both simulations at the end of the path, with REMOVED.
    path : (k, 2) int array
        Rows and columns of the centre, each sharing a face with the one before.
    unreachable : (n, m) bool array
        Target that no allowed position of the disc reaches.
    spacing, burr_radius : float
        mm.
    reach : int
        Voxels from the supervoxel's centre to its side.
    """

    segmented: np.ndarray
    modified: np.ndarray
    modified_end: np.ndarray
    unmodified_end: np.ndarray
    path: np.ndarray
    unreachable: np.ndarray
    spacing: float
    burr_radius: float
    reach: int

    @property
    def left(self) -> int:
        """Target voxels that the burr could have removed and did not."""
        return int(np.count_nonzero((self.unmodified_end == TARGET) & ~self.unreachable))


def pocket(shape: tuple[int, int] = (48, 62)) -> np.ndarray:
    """A plane of air above bone with a rounded target, (n, m) uint8."""
    rows, columns = np.indices(shape)
    labels = np.where(rows < 14, AIR, PROTECTED).astype(np.uint8)
    wide = np.hypot((columns - shape[1] / 2) / (0.40 * shape[1]), (rows - 14) / (0.58 * shape[0])) < 1
    labels[wide & (rows >= 14)] = TARGET
    return labels


def mill_plane(
    segmented: np.ndarray, *, boundary: bool, spacing: float = 0.4, burr_radius: float = 2.5, reach: int = 2
) -> FlatMilling:
    """Mill a plane: always to the position near the supervoxel that clears most, else to the nearest left.

    Parameters
    ----------
    segmented : (n, m) uint8 array
        AIR, PROTECTED, TARGET; target away from the plane's edge.
    boundary : bool
        Whether the outermost target, next to protected bone by a face, has to be visited by the centre.
    spacing, burr_radius : float
        mm.
    reach : int
        Of the supervoxel.

    Raises
    ------
    InputError
        If the burr fits nowhere in the target.
    """
    ball = ball_element(burr_radius, np.full(3, spacing))
    disc = ball[:, :, ball.shape[2] // 2]
    air, target = segmented == AIR, segmented == TARGET
    allowed = ~ndimage.binary_dilation(segmented == PROTECTED, disc)
    allowed &= ndimage.binary_erosion(np.ones_like(allowed), disc)  # the disc stays on the plane
    eroded = target & allowed
    goals = eroded | (air & allowed & ndimage.binary_dilation(eroded, disc))
    if not goals.any():
        raise InputError(f"a burr of {2 * burr_radius:g} mm fits nowhere in the target")
    modified = np.where(air, AIR, PROTECTED).astype(np.uint8)
    modified[goals] = TARGET
    if boundary:
        modified[goals & ndimage.binary_dilation(~goals & ~air)] = BOUNDARY
    now, bone = modified.copy(), segmented.copy()
    here = tuple(int(i) for i in np.argwhere(goals)[0])
    path = [here]
    _arrive(now, bone, here, reach, disc)
    while np.isin(now, (TARGET, BOUNDARY)).any():
        way = _next_way(now, allowed, here, reach)
        if way is None:
            break
        for here in way:
            path.append(here)
            _arrive(now, bone, here, reach, disc)
    return FlatMilling(
        segmented, modified, now, bone, np.array(path),
        target & ~ndimage.binary_dilation(goals, disc), spacing, burr_radius, reach,
    )  # fmt: skip


def _arrive(now, bone, here, reach, disc) -> None:
    square = tuple(slice(max(0, i - reach), i + reach + 1) for i in here)
    now[square][now[square] == TARGET] = REMOVED
    if now[here] == BOUNDARY:
        now[here] = REMOVED
    r, c = (n // 2 for n in disc.shape)
    cut = tuple(slice(i - n, i + n + 1) for i, n in zip(here, (r, c), strict=True))
    part = bone[cut]
    part[disc & (part == TARGET)] = REMOVED


def _next_way(now, allowed, here, reach) -> list[tuple[int, int]] | None:
    near = [
        (here[0] + i, here[1] + j)
        for i in range(-reach - 1, reach + 2)
        for j in range(-reach - 1, reach + 2)
        if 0 <= here[0] + i < now.shape[0] and 0 <= here[1] + j < now.shape[1]
    ]
    wanted = {at for at in near if now[at] in (TARGET, BOUNDARY)}
    if wanted:

        def gain(at):
            square = now[tuple(slice(max(0, i - reach), i + reach + 1) for i in at)]
            level = abs(at[0] - here[0])
            return 10 * (now[at] == BOUNDARY) + np.count_nonzero(square == TARGET) - 2 * level

        way = _way(allowed, here, {max(sorted(wanted), key=gain)})
        if way is not None:
            return way
    return _way(allowed, here, {tuple(at) for at in np.argwhere(np.isin(now, (TARGET, BOUNDARY))).tolist()})


def _way(allowed, here, goals) -> list[tuple[int, int]] | None:
    """Shortest way by faces through allowed positions to the nearest goal."""
    came = {here: here}
    queue = deque([here])
    while queue:
        at = queue.popleft()
        if at in goals and at != here:
            way = [at]
            while came[way[-1]] != here:
                way.append(came[way[-1]])
            return way[::-1]
        for i, j in FACES:
            to = (at[0] + i, at[1] + j)
            inside = 0 <= to[0] < allowed.shape[0] and 0 <= to[1] < allowed.shape[1]
            if inside and to not in came and allowed[to]:
                came[to] = at
                queue.append(to)
    return None


@styled()
def boundary_figure(*, boundary: bool, segmented: np.ndarray | None = None) -> Figure:
    """Figure 2.11 (`boundary` False) or 2.12 (True): both simulations at the path's start and end."""
    segmented = pocket() if segmented is None else segmented
    milled = mill_plane(segmented, boundary=boundary)
    figure, axes = new_axes(2, 2, (11, 8.6), sharex=True, sharey=True)
    start_modified, start_bone = milled.modified.copy(), milled.segmented.copy()
    ball = ball_element(milled.burr_radius, np.full(3, milled.spacing))
    _arrive(start_modified, start_bone, tuple(milled.path[0]), milled.reach, ball[:, :, ball.shape[2] // 2])
    rows = (("modified simulation", start_modified, milled.modified_end),
            ("unmodified simulation", start_bone, milled.unmodified_end))  # fmt: skip
    letters = iter("abcd")
    for (name, start, end), pair in zip(rows, axes, strict=True):
        for labels, ax, when, at in zip((start, end), pair, ("start", "end"), (0, -1), strict=True):
            show_labels(ax, labels, NAMES, (milled.spacing, milled.spacing), grid=True)
            ax.set_title(f"({next(letters)}) {name}, {when} of path")
            y, x = milled.path[at] * milled.spacing
            if name.startswith("modified"):
                side = (2 * milled.reach + 1) * milled.spacing
                ax.add_patch(
                    Rectangle((x - side / 2, y - side / 2), side, side, fc="none", ec="black", lw=1.6)
                )
            else:
                circle(ax, x, y, milled.burr_radius)
            if when == "end":
                ax.plot(*(milled.path[:, ::-1] * milled.spacing).T, color=STYLES["path"].colour, lw=1.1)
    axes[1, 1].set_title(f"(d) unmodified simulation, end: {milled.left} reachable voxels left")
    square = Line2D([], [], marker="s", ls="", ms=10, mfc="none", mec="black", mew=1.6, label="supervoxel")
    path = Line2D([], [], color=STYLES["path"].colour, label="path")
    kinds = ("air", "protected", "target", "target_boundary", "removed")
    legend_below(
        figure, [*patches(*(k for k in kinds if boundary or k != "target_boundary")), square, BURR, path], 4
    )
    return figure
