"""A planned hole for 3D Slicer: a markups line from entry to target."""

from __future__ import annotations

import json
import os
from typing import TYPE_CHECKING

from study.files import written_whole

if TYPE_CHECKING:
    from study.guidance.access.planning import AccessPlan

_SCHEMA = (
    "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/"
    "Resources/Schema/markups-schema-v1.0.3.json#"
)


def write_line(plan: AccessPlan, path: str | os.PathLike[str]) -> None:
    """Write entry and target as a markups line that 3D Slicer opens, LPS mm."""
    points = [
        {
            "id": str(number),
            "label": label,
            "position": [float(x) for x in position],
            "selected": True,
            "locked": True,
            "visibility": True,
            "positionStatus": "defined",
        }
        for number, (label, position) in enumerate((("entry", plan.entry), ("target", plan.target)), start=1)
    ]
    line = {
        "type": "Line",
        "coordinateSystem": "LPS",
        "coordinateUnits": "mm",
        "locked": True,
        "labelFormat": "%N-%d",
        "lastUsedControlPointNumber": len(points),
        "controlPoints": points,
        "measurements": [{"name": "length", "enabled": True, "value": plan.length_mm, "units": "mm"}],
        "display": {"visibility": True, "lineDiameter": plan.settings.drill_diameter},
    }
    with written_whole(path) as temporary:
        temporary.write_text(json.dumps({"@schema": _SCHEMA, "markups": [line]}, indent=1))
