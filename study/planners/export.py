"""Plans for other programs: 3D Slicer markups curves and VTK polylines."""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyvista as pv

from study.files import written_whole

if TYPE_CHECKING:
    from study.planners.plan import Plan


def corner_points(points: np.ndarray) -> np.ndarray:
    """Rows of (n, 3) points at which a path starts, ends or turns; the straight ones between are left out."""
    keep = [0]
    moves = np.flatnonzero(np.linalg.norm(np.diff(points, axis=0), axis=1) > 0) + 1
    for here, after in itertools.pairwise(moves):
        a, b = points[here] - points[keep[-1]], points[after] - points[here]
        across = np.linalg.norm(np.cross(a, b))
        if across > 1e-9 * np.linalg.norm(a) * np.linalg.norm(b) or a @ b < 0:
            keep.append(int(here))
    if len(moves):
        keep.append(int(moves[-1]))
    return np.array(keep)


def write_markups(plan: Plan, path: str | Path, name: str) -> None:
    """Write a plan as a markups curve that 3D Slicer opens: the path's corners, LPS mm, straight between."""
    corners = corner_points(plan.points)
    document = {
        "@schema": (
            "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/"
            "Resources/Schema/markups-schema-v1.0.3.json#"
        ),
        "markups": [
            {
                "type": "Curve",
                "coordinateSystem": "LPS",
                "coordinateUnits": "mm",
                "locked": True,
                "labelFormat": "%N-%d",
                "lastUsedControlPointNumber": len(corners),
                "controlPoints": [
                    {
                        "id": str(number + 1),
                        "label": f"{name} {number + 1}",
                        "position": [float(x) for x in plan.points[row]],
                        "selected": True,
                        "locked": True,
                        "visibility": False,
                        "positionStatus": "defined",
                    }
                    for number, row in enumerate(corners)
                ],
                "measurements": [{"name": "length", "enabled": True, "value": plan.length_mm, "units": "mm"}],
                "display": {"visibility": True, "lineThickness": 0.2, "curveType": "linear"},
            }
        ],
    }
    with written_whole(path) as temporary:
        temporary.write_text(json.dumps(document, indent=1))


def write_polyline(plan: Plan, path: str | Path) -> None:
    """Write a plan as one VTK polyline (.vtp) with axis and removed_mm3 on its points."""
    n = len(plan.points)
    line = pv.PolyData(np.array(plan.points), lines=np.concatenate([[n], np.arange(n)]))
    line["axis"] = np.array(plan.axes)
    line["removed_mm3"] = np.array(plan.removed)
    with written_whole(path) as temporary:
        line.save(temporary)
