"""Image-guided bone surgery planning: planners, margins, guidance and virtual fixtures.

The rooms of the package import one way only::

    volumes <- specimens
    volumes <- collision <- planners <- robots
    published, tables, rendering, plots: what a notebook shows

Lengths are millimetres, angles radians (degrees only in names that say so), points ``(n, 3)``
float64 arrays in the volume's mm frame (LPS: +x left, +y posterior, +z superior).
"""

__version__ = "0.1.0"
