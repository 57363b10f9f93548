"""Spheres in computed tomography: a rendered image of them, and their centres found in an image.

Baron, section 4.2: the spheres are detected with less than a voxel's error by an automatic method. How much
less follows from voxels, blur and noise and is measured here, `localisation_error`, not assumed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage
from scipy.special import erf

from study.errors import InputError
from study.registration.rigid import checked_points
from study.registration.sources import checked_vector

# Points a voxel and axis over which the image is averaged when rendered.
_FINE = 3
# Standard deviations of blur by which the centroid's window reaches beyond the surface: more of them let in
# more noise, less cut off brightness.
_TAIL = 1.5
# Windows in a row, each about the centroid that the one before found; more change nothing.
_WINDOWS = 2
# Share of the balls' volume that is surely of full brightness also where their radius is not as told.
_BRIGHT = 0.1
#: Largest relative difference between a bright region's radius, or half an axis, and the spheres' radius.
RADIUS_TOLERANCE = 0.25


def _voxel(voxel_mm: ArrayLike) -> np.ndarray:
    voxel = np.array(voxel_mm, dtype=float)
    if voxel.shape not in ((), (3,)) or not np.isfinite(voxel).all() or (voxel <= 0).any():
        raise InputError(f"voxel_mm: expected one or three lengths above 0, got {voxel_mm!r}")
    return np.broadcast_to(voxel, 3).astype(float)


def _number(name: str, value: float, above: bool = False) -> float:
    if not np.isfinite(value) or value < 0 or (above and value == 0):
        raise InputError(f"{name}: expected a number {'above' if above else 'of at least'} 0, got {value!r}")
    return float(value)


def blurred_ball(distance: np.ndarray, radius: float, blur: float) -> np.ndarray:
    """Brightness, 1 deep inside, at distances from the centre of a ball blurred by a normal curve.

    Parameters
    ----------
    distance : array
        mm.
    radius, blur : float
        mm; `blur` is the curve's standard deviation, 0 for a sharp edge.
    """
    if blur == 0:
        return (distance <= radius).astype(float)
    r = np.maximum(distance, 1e-4 * radius)  # the formula divides by it
    scale = np.sqrt(2.0) * blur
    edges = 0.5 * (erf((radius + r) / scale) + erf((radius - r) / scale))
    curves = np.exp(-(((r - radius) / scale) ** 2)) - np.exp(-(((r + radius) / scale) ** 2))
    return edges - blur / (np.sqrt(2.0 * np.pi) * r) * curves


def _profile(distance: np.ndarray, radius: float, blur: float) -> np.ndarray:
    """`blurred_ball`, from a table where it is smooth: error functions of a million distances take long."""
    if blur == 0:
        return blurred_ball(distance, radius, blur)
    table = np.linspace(0.0, radius + 6.0 * blur, 2000)
    return np.interp(distance, table, blurred_ball(table, radius, blur), right=0.0)


def render_spheres(
    centres: ArrayLike,
    radius_mm: float,
    shape: tuple[int, int, int],
    voxel_mm: ArrayLike,
    *,
    origin_mm: ArrayLike = (0.0, 0.0, 0.0),
    blur_mm: float = 0.2,
    contrast: float = 3000.0,
    noise: float = 50.0,
    noise_length_mm: float = 0.3,
    rng: object = None,
) -> np.ndarray:
    """Image of bright balls in a dark, even surrounding.

    Parameters
    ----------
    centres : (n, 3) array
        mm.
    radius_mm : float
    shape : (int, int, int)
        Voxels along x, y, z.
    voxel_mm : float or (3,) array
        Edges of a voxel, over which the image is averaged.
    origin_mm : (3,) array
        Centre of the first voxel.
    blur_mm : float
        Standard deviation of the scanner's point spread. Plausible: 0.1 to 0.4.
    contrast : float
        Of ball over surrounding, HU. Metal is at the end of most scanners' scale, about 3000.
    noise : float
        Standard deviation in a voxel, HU. Plausible: 20 to 150.
    noise_length_mm : float
        Standard deviation of the normal curve by which the noise of neighbouring voxels is alike, 0 for
        noise of each voxel alone: reconstruction smooths its noise as it does the image. Plausible: 0.1 to
        0.5.
    rng : anything `numpy.random.default_rng` takes

    Returns
    -------
    array of `shape`
        HU over the surrounding; index (i, j, k) is at ``origin + (i, j, k) * voxel``.

    Raises
    ------
    InputError
        If an argument is not what it should be.
    """
    centres = checked_points("centres", centres)
    voxel, origin = _voxel(voxel_mm), checked_vector("origin_mm", origin_mm, "mm")
    radius, blur = _number("radius_mm", radius_mm, above=True), _number("blur_mm", blur_mm)
    _number("noise", noise)
    if not np.isfinite(contrast):
        raise InputError(f"contrast: expected a finite number, got {contrast!r}")
    if len(shape) != 3 or any(int(s) != s or s < 1 for s in shape):
        raise InputError(f"shape: expected three positive numbers of voxels, got {shape!r}")
    rng = np.random.default_rng(rng)
    image = _noise(
        tuple(int(s) for s in shape), noise, _number("noise_length_mm", noise_length_mm) / voxel, rng
    )
    reach = radius + 4.0 * blur + voxel
    for centre in centres:
        low = np.maximum(np.floor((centre - reach - origin) / voxel).astype(int), 0)
        high = np.minimum(np.ceil((centre + reach - origin) / voxel).astype(int) + 1, shape)
        if (high <= low).any():
            continue  # outside the image
        fine = (np.arange(_FINE) + 0.5) / _FINE - 0.5
        axes = [
            (origin[a] + voxel[a] * (np.arange(low[a], high[a])[:, None] + fine) - centre[a]).ravel() ** 2
            for a in range(3)
        ]
        distance = np.sqrt(axes[0][:, None, None] + axes[1][:, None] + axes[2])
        ball = _profile(distance, radius, blur)
        counts = high - low
        ball = ball.reshape(counts[0], _FINE, counts[1], _FINE, counts[2], _FINE).mean(axis=(1, 3, 5))
        image[tuple(slice(a, b) for a, b in zip(low, high, strict=True))] += contrast * ball
    return image


def _noise(
    shape: tuple[int, int, int], std: float, length: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Noise of a standard deviation whose neighbours are alike over lengths in voxels."""
    white = rng.standard_normal(shape)
    if not std or not length.any():
        return white * std
    # Smoothing by a kernel shrinks white noise by the root of the kernel's sum of squares.
    spot = np.zeros([2 * int(np.ceil(5 * s)) + 1 for s in length])
    spot[tuple(n // 2 for n in spot.shape)] = 1.0
    shrunk = np.sqrt((ndimage.gaussian_filter(spot, length, mode="constant") ** 2).sum())
    return ndimage.gaussian_filter(white, length, mode="wrap") * (std / shrunk)


def detect_spheres(
    image: ArrayLike,
    radius_mm: float,
    voxel_mm: ArrayLike,
    *,
    count: int,
    origin_mm: ArrayLike = (0.0, 0.0, 0.0),
    blur_mm: float = 0.2,
    threshold: float | None = None,
) -> np.ndarray:
    """Centres of bright balls of known size in an image.

    Regions brighter than a threshold, round and of the volume of a ball of the radius, then the centroid of
    the brightness over the surrounding in a window about each. Balls must be apart by more than their blur.

    Parameters
    ----------
    image : (i, j, k) array
    radius_mm : float
    voxel_mm : float or (3,) array
        Edges of a voxel.
    count : int
        How many balls there are, at least one.
    origin_mm : (3,) array
        Centre of the first voxel.
    blur_mm : float
        Of the scanner; sets how far beyond the surface the window reaches.
    threshold : float, optional
        By default half way between the surrounding (median) and the level that as many voxels exceed as
        a tenth of the balls' volume fills.

    Returns
    -------
    (count, 3) array
        mm, by ascending first index. Which is which, `study.guidance.spheres.find_order` tells.

    Raises
    ------
    InputError
        If more or fewer balls are found; says what was found. Or if an argument is not what it should be.
    """
    image = np.asarray(image, dtype=float)
    if image.ndim != 3 or not image.size or not np.isfinite(image).all():
        raise InputError(f"image: expected finite numbers of shape (i, j, k), got shape {image.shape}")
    voxel, origin = _voxel(voxel_mm), checked_vector("origin_mm", origin_mm, "mm")
    radius = _number("radius_mm", radius_mm, above=True)
    reach = radius + _TAIL * _number("blur_mm", blur_mm) + 0.5 * voxel.max()
    if isinstance(count, bool) or int(count) != count or count < 1:
        raise InputError(f"count: expected a positive whole number of balls, got {count!r}")
    background = float(np.median(image))
    if threshold is None:
        filled = _BRIGHT * count * 4.0 / 3.0 * np.pi * radius**3 / voxel.prod()
        rank = max(0, image.size - 1 - int(filled))
        threshold = 0.5 * (background + float(np.partition(image, rank, axis=None)[rank]))
    labels, found = ndimage.label(image > threshold, structure=np.ones((3, 3, 3)))
    centres: list[np.ndarray] = []
    refused: list[str] = []
    for number, region in enumerate(ndimage.find_objects(labels), start=1):
        inside = labels[region] == number
        volume = np.count_nonzero(inside) * voxel.prod()
        size = np.cbrt(0.75 * volume / np.pi)
        corner = np.array([part.start for part in region])
        middle = origin + voxel * (corner + np.array(ndimage.center_of_mass(inside)))
        if size < 0.25 * radius:
            continue  # a few bright voxels are noise
        cut = (middle - reach < origin - 0.5 * voxel).any()
        cut = cut or (middle + reach > origin + voxel * (np.array(image.shape) - 0.5)).any()
        axes = _half_axes(inside, voxel)
        where = f"at {middle.round(1).tolist()}"
        if cut:
            refused.append(f"cut by the image's edge {where}")
        elif abs(size / radius - 1.0) > RADIUS_TOLERANCE:
            refused.append(f"radius {size:.2f} mm {where}")
        elif abs(axes / radius - 1.0).max() > RADIUS_TOLERANCE:
            refused.append(f"not round, half axes {axes.round(2).tolist()} mm {where}")
        else:
            centres.append(_centroid(image - background, middle - origin, reach, voxel) + origin)
    if len(centres) != count:
        where = "; ".join(str(centre.round(1).tolist()) for centre in centres)
        raise InputError(
            f"spheres: expected {count} of radius {radius:g} mm brighter than {threshold:.4g}, found "
            f"{len(centres)}{': ' + where if where else ''}"
            f"{' (also ' + '; '.join(refused[:5]) + ')' if refused else ''}, of {found} bright regions"
        )
    return np.array(centres).reshape(-1, 3)


def _half_axes(inside: np.ndarray, voxel: np.ndarray) -> np.ndarray:
    """(3,) half axes, mm, of the ellipsoid with a region's second moments, ascending."""
    points = np.argwhere(inside) * voxel
    spread = np.cov(points, rowvar=False, ddof=0) + np.diag(voxel**2 / 12.0)
    return np.sqrt(5.0 * np.linalg.eigvalsh(spread))


def _centroid(image: np.ndarray, start: np.ndarray, reach: float, voxel: np.ndarray) -> np.ndarray:
    """(3,) centroid of the brightness in a round window that follows it, mm from the first voxel."""
    centre = start
    for _ in range(_WINDOWS):
        low = np.maximum(np.ceil((centre - reach) / voxel).astype(int), 0)
        high = np.minimum(np.floor((centre + reach) / voxel).astype(int) + 1, image.shape)
        part = image[tuple(slice(a, b) for a, b in zip(low, high, strict=True))]
        grid = np.meshgrid(
            *(voxel[a] * np.arange(low[a], high[a]) - centre[a] for a in range(3)), indexing="ij", sparse=True
        )
        distance = np.sqrt(grid[0] ** 2 + grid[1] ** 2 + grid[2] ** 2)
        # A soft edge, one voxel wide, so that the centroid does not jump as voxels come and go.
        weight = part * np.clip((reach - distance) / voxel.max() + 0.5, 0.0, 1.0)
        centre = centre + np.array([(weight * axis).sum() for axis in grid]) / weight.sum()
    return centre


def localisation_error(
    voxel_mm: ArrayLike,
    radius_mm: float = 2.5,
    noise: float = 50.0,
    n: int = 200,
    rng: object = None,
    *,
    blur_mm: float = 0.2,
    contrast: float = 3000.0,
    noise_length_mm: float = 0.3,
) -> float:
    """Root mean squared 3-D error, mm, of centres found in rendered images of single balls.

    Parameters
    ----------
    voxel_mm : float or (3,) array
        Edges of a voxel.
    radius_mm, noise, blur_mm, contrast, noise_length_mm
        See `render_spheres`.
    n : int
        Balls, each elsewhere between voxels.
    rng : anything `numpy.random.default_rng` takes

    Raises
    ------
    InputError
        If an argument is not what it should be, or noise hides the balls.
    """
    if isinstance(n, bool) or int(n) != n or n < 1:
        raise InputError(f"n: expected a positive whole number of balls, got {n!r}")
    rng = np.random.default_rng(rng)
    voxel = _voxel(voxel_mm)
    half = np.ceil((_number("radius_mm", radius_mm, above=True) + 5.0 * blur_mm) / voxel) + 3
    shape = tuple((2 * half + 1).astype(int).tolist())
    off = np.empty((n, 3))
    for row in range(n):
        true = voxel * (half + rng.uniform(-0.5, 0.5, 3))
        image = render_spheres(
            true[None],
            radius_mm,
            shape,
            voxel,
            blur_mm=blur_mm,
            contrast=contrast,
            noise=noise,
            noise_length_mm=noise_length_mm,
            rng=rng,
        )
        off[row] = detect_spheres(image, radius_mm, voxel, count=1, blur_mm=blur_mm)[0] - true
    return float(np.sqrt((off**2).sum(axis=1).mean()))
