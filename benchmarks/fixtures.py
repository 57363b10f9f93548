"""How long a virtual fixture takes: building its index, asking it, deciding a step.

``python benchmarks/fixtures.py`` makes a surface of about a million triangles from the real temporal bone
RT143 (or, without it, from a synthetic one), and prints each figure beside what was aimed at and beside what
other libraries take for the same question. Times of steps are of one thread's processor time, so that they
hold what is computed; what the operating system adds to a step is printed after them.
"""

from __future__ import annotations

import argparse
import gc
import os
import resource
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh
import vtk
from scipy.spatial.transform import Rotation
from vtk.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray

from study.fixtures import Controller, MeshFixture, ShaftTool, SphereTool, checked_mesh, moved, warm
from study.fixtures.index import TriangleIndex
from study.fixtures.mesh import FixtureMesh, mesh_from_volume
from study.fixtures.optimisation import nearest_motion
from study.specimens import specimen
from study.volumes import read_volume

REAL = Path(os.environ.get("STUDY_REAL_DATA", Path(__file__).resolve().parents[2] / "shared" / "real"))


def bone(pitch_mm: float) -> tuple[str, FixtureMesh]:
    """The surface of a temporal bone, on a grid as fine as said."""
    path = REAL / "temporal_bone/RT143/labels_0p38.nrrd"
    if path.is_file():
        volume = read_volume(path)
        name = next(name for name, label in volume.names.items() if label == 1)
        return "RT143", mesh_from_volume(volume, name, smooth_mm=0.2, pitch_mm=pitch_mm)
    return "CH01", mesh_from_volume(specimen("CH01").anatomy, "bone", smooth_mm=0.2, pitch_mm=pitch_mm)


def row(what: str, measured: str, aim: str = "") -> None:
    """Print one line of the table."""
    print(f"  {what:52s} {measured:>34s}   {aim}", flush=True)


def seconds(work: Callable[[], object], rounds: int = 3) -> float:
    """Least of a few processor times, s."""
    times = []
    for _ in range(rounds):
        begun = time.process_time()
        work()
        times.append(time.process_time() - begun)
    return min(times)


def building(mesh: FixtureMesh) -> None:
    """Both trees."""
    for kind in ("pd", "aabb"):
        took = seconds(lambda kind=kind: TriangleIndex.of(mesh, kind))
        row(f"build, {kind}", f"{took:.2f} s", "aim 3 s")
    row("adjacency (only Algorithm 1 asks for it)", f"{seconds(lambda: mesh.adjacency.closed, 1):.2f} s")


def vtk_closest(mesh: FixtureMesh) -> Callable[[np.ndarray], float]:
    """Closest point by VTK."""
    points, cells, body = vtk.vtkPoints(), vtk.vtkCellArray(), vtk.vtkPolyData()
    points.SetDataTypeToDouble()
    points.SetData(numpy_to_vtk(mesh.vertices, deep=True))
    cells.SetData(3, numpy_to_vtkIdTypeArray(mesh.faces.astype(np.int64).ravel(), deep=True))
    body.SetPoints(points)
    body.SetPolys(cells)
    locator = vtk.vtkStaticCellLocator()
    locator.SetDataSet(body)
    locator.BuildLocator()
    closest, cell = [0.0] * 3, vtk.vtkGenericCell()

    def ask(point: np.ndarray) -> float:
        number, part, squared = vtk.reference(0), vtk.reference(0), vtk.reference(0.0)
        locator.FindClosestPoint(point, closest, cell, number, part, squared)
        return float(squared) ** 0.5

    return ask


def asking(mesh: FixtureMesh, count: int) -> None:
    """Triangles near a point, and the closest point, side by side."""
    rng = np.random.default_rng(0)
    centres = mesh.vertices[mesh.faces].mean(axis=1)
    points = centres[rng.integers(len(centres), size=count)] + 0.7 * rng.normal(size=(count, 3))
    found = {}
    for kind in ("pd", "aabb"):
        index = TriangleIndex.of(mesh, kind)
        index.within(points[0], 1.0)
        sizes = [len(index.within(point, 1.25).faces) for point in points[:200]]
        took = seconds(lambda index=index: [index.within(point, 1.25) for point in points]) / count
        row(f"all triangles within 1.25 mm, {kind} (median {np.median(sizes):.0f})", f"{1e6 * took:.1f} us")
        index.nearest(points[:1])
        took = seconds(lambda index=index: [index.nearest(point[None]) for point in points]) / count
        many = seconds(lambda index=index: index.nearest(points)) / count
        row(f"closest point, {kind}", f"{1e6 * took:.1f} us; {1e6 * many:.1f} us in a batch")
        found[kind] = index.nearest(points).distances
    ask = vtk_closest(mesh)
    found["VTK"] = np.array([ask(point) for point in points])
    row(
        "closest point, VTK static locator",
        f"{1e6 * seconds(lambda: [ask(point) for point in points]) / count:.1f} us",
    )
    few = points[: max(count // 100, 1)]
    body = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    begun = time.process_time()
    body.triangles_tree  # noqa: B018 - built on demand
    row("trimesh: build of its R-tree", f"{time.process_time() - begun:.1f} s")
    took = seconds(lambda: [trimesh.proximity.closest_point(body, point[None]) for point in few], 1) / len(
        few
    )
    many = seconds(lambda: trimesh.proximity.closest_point(body, few), 1) / len(few)
    row("closest point, trimesh", f"{1e6 * took:.0f} us; {1e6 * many:.0f} us in a batch")
    found["trimesh"] = np.r_[trimesh.proximity.closest_point(body, few)[1], found["VTK"][len(few) :]]
    try:
        import open3d
    except (ImportError, OSError) as error:
        row("closest point, Open3D", f"not here ({type(error).__name__})")
    else:
        begun = time.process_time()
        scene = open3d.t.geometry.RaycastingScene(nthreads=1)
        scene.add_triangles(
            open3d.core.Tensor(mesh.vertices.astype(np.float32)),
            open3d.core.Tensor(mesh.faces.astype(np.uint32)),
        )
        queries = points.astype(np.float32)
        scene.compute_distance(open3d.core.Tensor(queries[:1]))
        row("Open3D: build", f"{time.process_time() - begun:.1f} s")
        took = seconds(
            lambda: [scene.compute_distance(open3d.core.Tensor(q[None]), nthreads=1) for q in queries]
        )
        many = seconds(lambda: scene.compute_distance(open3d.core.Tensor(queries), nthreads=1)) / count
        row(
            "closest point, Open3D (single precision)",
            f"{1e6 * took / count:.1f} us; {1e6 * many:.1f} us in a batch",
        )
    worst = max(np.abs(found[name] - found["pd"]).max() for name in found)
    row("largest difference between their answers", f"{worst:.1e} mm")


def pushes(fixture: MeshFixture, control: Controller, count: int, length: float, turn: float) -> list[list]:
    """Poses and desired motions of a hand that pushes towards the surface; a list for each course."""
    rng = np.random.default_rng(1)
    tool, vertices = control.tool, fixture.mesh.vertices[fixture.mesh.faces[:, 0]]
    six = tool.freedoms == 6
    courses = []
    while sum(len(course) for course in courses) < count:
        x = vertices[rng.integers(len(vertices))] + rng.normal(size=3) * (tool.radius + 0.3)
        pose = np.r_[x, Rotation.random(random_state=rng).as_rotvec()] if six else x
        if control.step(pose, np.zeros(len(pose))).stopped:
            continue
        course = []
        for k in range(200):
            if k % 40 == 0:
                lever = np.zeros(3)
                if six:
                    lever = rng.uniform(0, 20) * Rotation.from_rotvec(pose[3:]).apply([0, 0, 1])
                towards = fixture.index.nearest((pose[:3] + lever)[None]).points[0] - pose[:3] - lever
                push = towards / np.linalg.norm(towards) + 0.4 * rng.normal(size=3)
                push *= length / np.linalg.norm(push)
                spin = np.cross(lever, push)
                spin *= turn / max(np.linalg.norm(spin), 1e-9)
            desired = push + 0.5 * length * rng.normal(size=3)
            desired = np.r_[desired, spin] if six else desired
            course.append((pose, desired))
            pose = moved(pose, control.step(pose, desired).motion)
        courses.append(course)
    return courses


def stepping(
    fixture: MeshFixture, tool: SphereTool | ShaftTool, count: int, what: str, aim: str, **hand: float
) -> None:
    """Percentiles of the time of a step, the least of three for each, in courses that push on the surface."""
    courses = pushes(fixture, Controller([fixture], tool), count, **hand)
    best = [np.full(len(course), np.inf) for course in courses]
    wall, touched = [], 0
    before = resource.getrusage(resource.RUSAGE_SELF)
    gc.disable()
    for _ in range(3):
        control = Controller([fixture], tool)  # a new one, which remembers nothing of the round before
        for course, least in zip(courses, best, strict=True):
            control.step(course[0][0], 0 * course[0][1])  # where the course begins is found out here
            for k, (pose, desired) in enumerate(course):
                begun, ran = time.perf_counter_ns(), time.thread_time_ns()
                step = control.step(pose, desired)
                ran, begun = time.thread_time_ns() - ran, time.perf_counter_ns() - begun
                least[k] = min(least[k], ran)
                wall.append(begun - ran)
                touched += step.status == "constrained"
    gc.enable()
    switches = resource.getrusage(resource.RUSAGE_SELF).ru_nivcsw - before.ru_nivcsw
    middle, tail, far = np.percentile(np.concatenate(best), [50, 99, 99.9]) / 1e3
    row(what, f"p50 {middle:.0f}, p99 {tail:.0f}, p99.9 {far:.0f} us", aim)
    row(
        f"  {100 * touched / len(wall):.0f} % constrained; beside computing",
        f"p99.9 {np.percentile(wall, 99.9) / 1e3:.0f} us, {switches} switches",
    )


def programmes() -> None:
    """The quadratic programme of a step, by each solver."""
    rng = np.random.default_rng(2)
    cases = [
        (rng.normal(size=(12, 3)), -rng.uniform(0, 0.1, 12), 0.2 * rng.normal(size=3)) for _ in range(300)
    ]
    for method in ("compiled", "quadprog", "nnls"):
        try:
            nearest_motion(*cases[0], method)
        except ImportError:
            row(f"programme with 12 rows, {method}", "not here")
            continue
        took = seconds(lambda method=method: [nearest_motion(*case, method) for case in cases]) / len(cases)
        row(f"programme with 12 rows, {method} (with checks)", f"{1e6 * took:.0f} us")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--pitch", type=float, default=0.245, help="mm, of the grid that the surface is made on"
    )
    parser.add_argument("--steps", type=int, default=4000)
    asked = parser.parse_args()
    warm()
    name, mesh = bone(asked.pitch)
    print(f"{name}: {len(mesh.faces)} triangles")
    building(checked_mesh((mesh.vertices, mesh.faces)))
    asking(mesh, 2000)
    fixture = MeshFixture(mesh)
    for radius in (0.0, 0.5, 1.0, 2.5):
        stepping(
            fixture,
            SphereTool(radius),
            asked.steps,
            f"step, tip of {radius:g} mm",
            "aim 20 and 60 us",
            length=0.1,
            turn=0.0,
        )
    for tool in (ShaftTool(1.0, 0.5, 40.0), ShaftTool(2.5, 1.2, 60.0), ShaftTool.from_drill()):
        what = (
            f"step, tip {tool.radius:g} mm, {len(tool.bodies) - 1} cylinders to {tool.cylinders[-1][2]:g} mm"
        )
        stepping(fixture, tool, asked.steps, what, "aim 100 and 250 us", length=0.05, turn=2e-4)
    programmes()


if __name__ == "__main__":
    main()
