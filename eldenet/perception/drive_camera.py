"""Lens and mount of a drive's camera: what is not given is found, what is given is checked."""

import math
from dataclasses import replace

import numpy as np

from eldenet.data.bags import Bag
from eldenet.data.depth_from_motion import MotionDepth
from eldenet.data.drive_poses import DrivePoses
from eldenet.data.self_calibration import CameraFit, find_pairs, fit_camera, from_told
from eldenet.deploy.prediction import Source
from eldenet.geometry import check_intrinsics, intrinsic_matrix, pinhole
from eldenet.perception.drive_labels import place_frames
from eldenet.results.run_log import RunLog

WRONG_FOCAL, WRONG_ANGLE = 1.08, 3.0  # that is refused: a factor (or one over it), [degrees]
TELLS = "drive on in curves, among things with texture"


def settle_camera(
    source: Source | Bag, poses: DrivePoses, intrinsics: object, *, find_pitch: bool, log: RunLog
) -> tuple[np.ndarray, DrivePoses]:
    """Return intrinsics ``(3, 3)`` [px] and poses of the camera, by how its pictures move along a drive.

    Args:
        source: pictures in the order of time, a video, or a bag of ROS.
        poses: of the camera during the drive.
        intrinsics: of the source's pictures [px]; None: found, with the principal point in the middle.
        find_pitch: whether the pitch of a mounted camera is found; the poses then have one of 0.
        log: says what was found.

    Raises:
        ValueError: the drive does not tell what was not given, or contradicts what was.
    """
    _, picture, _ = next(place_frames(source, poses))
    size = height, width = picture.shape[:2]
    if intrinsics is None:
        told = pinhole(width, width, (width - 1) / 2, (height - 1) / 2)
    else:
        told = intrinsic_matrix(intrinsics)  # type: ignore[arg-type]
    check_intrinsics(told, size)
    depth = MotionDepth(told, size)
    frames = (frame for frame in place_frames(source, poses) if frame[1].shape == picture.shape)
    pairs = find_pairs(depth.view(*frame) for frame in frames)
    fit = fit_camera(pairs, depth.seen_intrinsics, mounted=poses.mount is not None)
    found = told * np.array([[fit.focal or 1.0, 1, 1], [1, fit.focal or 1.0, 1], [1, 1, 1]])
    if intrinsics is not None:
        if fit.focal is not None and not 1 / WRONG_FOCAL < fit.focal < WRONG_FOCAL:
            raise ValueError(
                f"intrinsics say fx={told[0, 0]:.0f}, but along the poses the pictures, {width} x {height}, "
                f"move as with fx={found[0, 0]:.0f}: give intrinsics={_said(found)}, or null, or mend the "
                "heading"
            )
        return told, _mounted(poses, fit, find_pitch, log)
    if fit.focal is None:
        raise ValueError(f"the drive does not tell the lens: give intrinsics=[fx,fy,cx,cy] [px], or {TELLS}")
    log.say(f"by the drive, intrinsics={_said(found)}: give them to other commands, too")
    return found, _mounted(poses, fit, find_pitch, log)


def _mounted(poses: DrivePoses, fit: CameraFit, find_pitch: bool, log: RunLog) -> DrivePoses:
    """Poses of a mounted camera with the pitch that was found; others as they are."""
    if poses.mount is None:
        return poses
    pitch, yaw = (None if angle is None else math.degrees(angle) for angle in (fit.pitch, fit.yaw))
    if yaw is not None and abs(yaw) > WRONG_ANGLE:
        raise ValueError(
            f"the camera looks {abs(yaw):.1f} degrees to the {'left' if yaw > 0 else 'right'} of the way: "
            "mount it straight ahead, or mend the heading in the poses"
        )
    if not find_pitch:
        if pitch is not None and abs(pitch) > WRONG_ANGLE:
            given = math.degrees(poses.mount.pitch)
            raise ValueError(
                f"camera_pitch={given:.3g}, but along the poses the pictures move as with a camera "
                f"{given + pitch:.1f} degrees below the horizon: give that, or null"
            )
        return poses
    if fit.pitch is None:
        raise ValueError(f"the drive does not tell the pitch: give camera_pitch= [degrees], or {TELLS}")
    log.say(f"by the drive, camera_pitch={pitch:.1f}")
    turn = np.eye(4)
    turn[:3, :3] = from_told(fit.pitch).T
    return replace(poses, cameras=poses.cameras @ turn, mount=poses.mount._replace(pitch=fit.pitch))


def _said(matrix: np.ndarray) -> str:
    return "[" + ",".join(f"{matrix[at]:.1f}" for at in ((0, 0), (1, 1), (0, 2), (1, 2))) + "]"
