"""An image-guided robot, simulated from first causes: frames, tracker, calibration, filters, fusion, control.

After Baron: what the paper measured on two real systems follows here from what such systems are made of.

| module | what it holds |
|---|---|
| `systems` | the two systems as their causes: values, units, plausible ranges |
| `frames` | frames, transforms, quaternions; equations 1, 2, 5 and 6 |
| `tracker`, `calibration`, `spheres` | what is measured, and what follows from it |
| `filters`, `fusion`, `control`, `safety` | the control circuit |
| `scene`, `setting_up` | the room; calibration and registration before the first hole |
| `loop`, `drilling`, `faults` | a hole drilled tick by tick, and what can go wrong |
| `blocks`, `repeated` | the two phantoms of the text, drilled once or a thousand times |
| `access` | one straight hole to the cochlea, and what it may touch |
"""

from study.guidance.blocks import (
    AbsoluteResult,
    LateralResult,
    absolute_experiment,
    acrylic_block,
    aluminium_block,
    lateral_experiment,
)
from study.guidance.drilling import drill_holes
from study.guidance.faults import Faults
from study.guidance.frames import FrameGraph
from study.guidance.loop import DrilledHole, HoleRun, LoopSettings
from study.guidance.repeated import Repeated, on_the_table, repeat_absolute, repeat_lateral, tip_errors
from study.guidance.safety import SafetySettings, Status
from study.guidance.scene import Phantom, Scene
from study.guidance.setting_up import SetUp, set_up
from study.guidance.spheres import register_spheres
from study.guidance.systems import SYSTEMS, GuidedSystem, causes, system

__all__ = [
    "SYSTEMS",
    "AbsoluteResult",
    "DrilledHole",
    "Faults",
    "FrameGraph",
    "GuidedSystem",
    "HoleRun",
    "LateralResult",
    "LoopSettings",
    "Phantom",
    "Repeated",
    "SafetySettings",
    "Scene",
    "SetUp",
    "Status",
    "absolute_experiment",
    "acrylic_block",
    "aluminium_block",
    "causes",
    "drill_holes",
    "lateral_experiment",
    "on_the_table",
    "register_spheres",
    "repeat_absolute",
    "repeat_lateral",
    "set_up",
    "system",
    "tip_errors",
]
