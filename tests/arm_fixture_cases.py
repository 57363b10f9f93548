"""What the tests of a tool on an arm share: arms that hold one, exact poses and distances."""

import coal
import numpy as np

from study.fixtures import Controller, MeshFixture
from study.fixtures.arm import ArmController
from study.robots.arms import guided_arm
from study.transforms import inverse, rigid

UR5 = guided_arm("UR5")
#: The tool stands 15 cm beyond the flange, off its axis and tilted; its shaft points back to the arm.
T_EE_TOOL = rigid([[0.96, 0, 0.28], [0, -1, 0], [0.28, 0, -0.96]], [20.0, -10.0, 150.0])


def holding(mesh, tool, T_mesh_tool, q=None, arm=UR5, clearance=0.0, slack=None, **options):
    """An arm whose foot is where the joints q bring the tool to a pose, and q."""
    q = arm.ready if q is None else np.asarray(q, dtype=float)
    T_mesh_rob = T_mesh_tool @ inverse(arm.forward(q) @ T_EE_TOOL)
    fixture = MeshFixture(mesh, clearance_mm=clearance, slack=slack)
    return ArmController(arm, Controller([fixture], tool), T_mesh_rob, T_EE_TOOL, **options), q.copy()


def tool_at(hold, q):
    """(4, 4) T_mesh_tool where the joints stand at q, from the arm's forward kinematics alone."""
    return hold.held.T_mesh_rob @ hold.arm.forward(q) @ T_EE_TOOL


class CoalDistance:
    """Least distance between a tool's capsules and a mesh by coal, less their radii, mm."""

    def __init__(self, mesh, tool):
        vertices, faces = mesh
        self.body = coal.BVHModelOBBRSS()
        self.body.beginModel(len(faces), len(vertices))
        self.body.addVertices(np.asarray(vertices, dtype=float))
        self.body.addTriangles(np.asarray(faces, dtype=np.int64))
        self.body.endModel()
        self.parts = []
        for row in tool.bodies:
            start, end, radius = row[:3], row[3:6], row[6]
            length = np.linalg.norm(end - start)
            # a segment, so that what is left of the radius is seen where the tool is inside too
            shape = coal.Capsule(1e-9, length) if length else coal.Sphere(1e-9)
            self.parts.append((shape, 0.5 * (start + end), radius - 1e-9))

    def __call__(self, T):
        least = np.inf
        for shape, middle, radius in self.parts:
            place = coal.Transform3s(T[:3, :3], T[:3, :3] @ middle + T[:3, 3])
            result = coal.DistanceResult()
            coal.distance(self.body, coal.Transform3s(), shape, place, coal.DistanceRequest(), result)
            least = min(least, result.min_distance - radius)
        return least
