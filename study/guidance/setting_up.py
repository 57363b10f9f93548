"""What is done before the first hole: the drill is calibrated, the patient registered (Baron, 4.2, 4.3).

Both through the same distorted tracker that will guide the drill, so that what its errors share cancels
here as it does in the room.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from study.guidance.arm_motion import built_arm, nominal_angles
from study.guidance.calibration import T_tool_tcp_from, calibrate_bits, calibrate_hand_eye, calibrate_pivot
from study.guidance.frames import inverse, moved, rigid
from study.guidance.scene import Phantom, Scene, facing_orientation
from study.guidance.systems import GuidedSystem
from study.guidance.tracker import Tracker, TrackerSettings, facing_pose, touch
from study.registration import RigidFit, register_points
from study.robots.arms import SixAxisArm

#: Length of the two calibration bits and of the drill, from the end of the holder, mm.
_SHORT_BIT, _LONG_BIT = 30.0, 80.0
#: From the pointer's marker to its tip, in the marker's frame, mm.
_POINTER_TIP = (0.0, -120.0, 0.0)


@dataclass(frozen=True, eq=False)
class SetUp:
    """A system that is ready to drill, with what it believes and what is true.

    Attributes
    ----------
    system : GuidedSystem
    phantom : Phantom
    scene : Scene
    tracker : Tracker
        The one of this experiment, with its distortion.
    built : SixAxisArm
        The arm as it was built.
    T_tool_tcp : (4, 4) array
        Believed; the truth is the scene's.
    T_ee_tool, T_base_rob : (4, 4) arrays
        Of the marker on the arm, and of the robot's base in the frame of its marker; believed.
    T_pat_img : (4, 4) array
        Believed, by registration.
    registration : RigidFit
        From the image to the patient's marker.
    imaged_spheres : (n, 3) array
        Where the image, or the calliper, says the spheres are, mm.
    """

    system: GuidedSystem
    phantom: Phantom
    scene: Scene
    tracker: Tracker
    built: SixAxisArm
    T_tool_tcp: np.ndarray
    T_ee_tool: np.ndarray
    T_base_rob: np.ndarray
    T_pat_img: np.ndarray
    registration: RigidFit
    imaged_spheres: np.ndarray

    @property
    def true_T_pat_img(self) -> np.ndarray:
        """(4, 4) the registration without error."""
        return inverse(self.scene.T_rob_pat) @ self.phantom.T_rob_img

    @property
    def calibration_error(self) -> np.ndarray:
        """(3,) believed minus true tip in the tool marker's frame, mm."""
        return self.T_tool_tcp[:3, 3] - self.scene.T_tool_tcp[:3, 3]

    def registration_error(self, points: np.ndarray) -> np.ndarray:
        """(n, 3) where image points are believed minus where they are, mm, in the image's axes."""
        there = inverse(self.true_T_pat_img) @ self.T_pat_img
        return moved(there, points) - points


def tracker_of(system: GuidedSystem, rng: np.random.Generator) -> Tracker:
    """The optical tracker of a system, with a distortion of its own."""
    settings = TrackerSettings(
        system.tracker_cycle_s,
        system.tracker_delay_s,
        system.tracker_jitter_xyz_mm,
        system.tracker_distortion_mm,
        system.tracker_distortion_length_mm,
        system.tracker_quantum_mm,
    )
    return Tracker(settings, rng)


def scene_of(system: GuidedSystem) -> Scene:
    """The room with the markers and the mount of a system."""
    return Scene(marker_size_mm=system.marker_size_mm, tip_lever_mm=system.tip_lever_mm)


def calibrated_drill(
    system: GuidedSystem,
    scene: Scene,
    tracker: Tracker,
    press: np.ndarray,
    pointer_error: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:
    """(4, 4) T_tool_tcp as the system's own way of calibration finds it (Baron, section 4.3).

    Parameters
    ----------
    system, scene, tracker
    press : (3,) array
        Unit vector in the robot's frame along which ``calibration_force_n`` bends the pivoted drill; how a
        pointer presses on a calibration bit is drawn.
    pointer_error : (3,) array
        Of the pointer's own calibration, in its marker's frame, mm: the same all day.
    rng : numpy.random.Generator
    """
    T_rob_tool = calibration_pose(scene) @ inverse(scene.T_tool_tcp)
    R_tool_rob = T_rob_tool[:3, :3].T
    if system.calibration == "bits":
        around = rng.uniform(0.0, 2.0 * np.pi)
        press = np.array([np.cos(around), np.sin(around), 0.0])
    bent = R_tool_rob @ press * system.calibration_force_n / system.bit_stiffness_n_mm
    true_axis, true_tip = scene.T_tool_tcp[:3, 2], scene.T_tool_tcp[:3, 3]
    T_cam_tool = scene.T_cam_rob @ T_rob_tool
    if system.calibration == "bits":
        holder = true_tip - system.bit_length_mm * true_axis
        lengths = np.array([_SHORT_BIT, _LONG_BIT])
        balls = holder + lengths[:, None] * true_axis
        # A bit bends with the cube of its length.
        balls = balls + (lengths[:, None] / system.bit_length_mm) ** 3 * bent
        touched = _touched(system, scene, tracker, moved(T_cam_tool, balls), T_cam_tool, pointer_error, rng)
        known = np.array([*lengths, system.bit_length_mm])
        known += system.bit_length_error_mm * rng.standard_normal(3)
        alone = system.pointer_seating_mm if system.touches == 1 else None  # one touch tells no scatter
        return calibrate_bits(*touched, *known, tolerance_mm=np.inf, touch_std_mm=alone).T_tool_tcp
    turns = _cone(system.pivot_poses, np.deg2rad(system.pivot_cone_deg), rng)
    tip = moved(T_cam_tool, true_tip + bent)
    base = facing_pose(tip)[:3, :3]
    T_cam_ref = rigid(base @ turns.as_matrix(), tip)
    seen_ref = tracker.measured(scene.marker, T_cam_ref, rng)
    seen_tool = tracker.measured(scene.marker, np.repeat(T_cam_tool[None], len(T_cam_ref), axis=0), rng)
    pivot = calibrate_pivot(inverse(seen_ref) @ seen_tool)
    tilt = Rotation.from_rotvec(system.tool_axis_error_mrad * 1e-3 * rng.standard_normal(3))
    return T_tool_tcp_from(pivot.tip_tool, tilt.apply(true_axis))


def calibration_pose(scene: Scene) -> np.ndarray:
    """(4, 4) T_rob_tcp at which the drill is calibrated: pointing down, its marker turned to the camera."""
    down, place = np.array([0.0, 0.0, -1.0]), scene.calibration_place
    return rigid(facing_orientation(down, scene.camera - place, scene.T_tool_tcp), place)


def calibrated_mount(
    system: GuidedSystem, scene: Scene, tracker: Tracker, built: SixAxisArm, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """T_ee_tool, and T_base_rob, from rotations that the arm believes it makes (Baron, section 4.3).

    Parameters
    ----------
    system, scene, tracker
    built : SixAxisArm
        Where the arm truly goes.
    rng : numpy.random.Generator

    Returns
    -------
    T_ee_tool, T_base_rob : (4, 4) arrays
    """
    T_ee_tool = scene.T_ee_tcp @ inverse(scene.T_tool_tcp)
    # The same programme of rotations on every day.
    programme = np.random.default_rng(0).uniform(-1.0, 1.0, (system.hand_eye_poses, 3))
    turns = Rotation.from_rotvec(np.deg2rad(system.hand_eye_turn_deg) * programme).as_matrix()
    home = calibration_pose(scene) @ inverse(scene.T_ee_tcp)
    told = rigid(turns @ home[:3, :3], home[:3, 3])
    made = built.forward(np.stack([nominal_angles(system.arm, pose) for pose in told]))
    seen = tracker.measured(
        scene.marker, scene.T_cam_rob @ made @ T_ee_tool, rng, samples=system.touch_frames
    )
    found = calibrate_hand_eye(told, seen)
    T_cam_base = (scene.T_cam_rob @ scene.T_rob_base)[None]
    base = tracker.measured(scene.marker, T_cam_base, rng, samples=system.touch_frames)[0]
    return found.T_ee_tool, inverse(found.T_rob_cam @ base)


def registered(
    system: GuidedSystem,
    phantom: Phantom,
    scene: Scene,
    tracker: Tracker,
    pointer_error: np.ndarray,
    rng: np.random.Generator,
    imaged: bool,
) -> tuple[RigidFit, np.ndarray]:
    """The registration to the patient's marker by touched spheres, and where the image says they are (4.2).

    Parameters
    ----------
    system, phantom, scene, tracker, pointer_error, rng
        See `calibrated_drill`.
    imaged : bool
        Whether the spheres' places come from an image; else from a calliper.
    """
    std = system.image_fle_mm if imaged else system.sphere_position_mm
    known = phantom.spheres + std * rng.standard_normal(phantom.spheres.shape)
    T_cam_pat = scene.T_cam_rob @ scene.T_rob_pat
    spheres = moved(scene.T_cam_rob @ phantom.T_rob_img, phantom.spheres)
    touched = _touched(system, scene, tracker, spheres, T_cam_pat, pointer_error, rng).mean(axis=1)
    return register_points(known, touched), known


def set_up(
    system: GuidedSystem,
    phantom: Phantom,
    rng: object = None,
    imaged: bool = False,
    scene: Scene | None = None,
) -> SetUp:
    """Calibrate the drill and register the patient, once: a day in the laboratory begins.

    Parameters
    ----------
    system : GuidedSystem
    phantom : Phantom
    rng : anything `numpy.random.default_rng` takes
    imaged : bool
        Whether the spheres were found in an image; else measured with a calliper.
    scene : Scene, optional

    Returns
    -------
    SetUp
    """
    rng = np.random.default_rng(rng)
    scene = scene or scene_of(system)
    tracker = tracker_of(system, rng)
    press = -phantom.T_rob_img[:3, 0]
    pointer_error = system.pointer_tip_error_mm * rng.standard_normal(3)
    T_tool_tcp = calibrated_drill(system, scene, tracker, press, pointer_error, rng)
    built = built_arm(system, rng)
    T_ee_tool, T_base_rob = calibrated_mount(system, scene, tracker, built, rng)
    fit, known = registered(system, phantom, scene, tracker, pointer_error, rng, imaged)
    return SetUp(
        system, phantom, scene, tracker, built, T_tool_tcp, T_ee_tool, T_base_rob, fit.transform, fit, known
    )


def _touched(
    system: GuidedSystem,
    scene: Scene,
    tracker: Tracker,
    points: np.ndarray,
    T_cam_ref: np.ndarray,
    pointer_error: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:
    """(n, touches, 3) points of the camera's frame, touched often, in the reference marker's frame."""
    found = touch(
        tracker,
        scene.marker,
        rigid(translation=_POINTER_TIP),
        np.repeat(points, system.touches, axis=0),
        T_cam_ref,
        seating_std_mm=system.pointer_seating_mm,
        samples=system.touch_frames,
        rng=rng,
        tip_error_mm=pointer_error,
        reference=scene.marker,
    )
    return found.reshape(len(points), system.touches, 3)


def _cone(count: int, half: float, rng: np.random.Generator) -> Rotation:
    """Turns by up to `half` about axes all around, and by up to as much about the facing direction."""
    share = np.sqrt(rng.uniform(size=count)) * half
    around = rng.uniform(0.0, 2.0 * np.pi, count)
    tilt = np.column_stack([share * np.cos(around), share * np.sin(around), np.zeros(count)])
    spin = np.column_stack([np.zeros((count, 2)), rng.uniform(-half, half, count)])
    return Rotation.from_rotvec(tilt) * Rotation.from_rotvec(spin)
