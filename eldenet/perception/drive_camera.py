"""Lens and mount of a drive's camera: what is not given is found, what is given is checked."""

import math
from dataclasses import replace

import numpy as np

from eldenet.data.bags import Bag
from eldenet.data.depth_from_motion import MotionDepth
from eldenet.data.drive_clock import find_delay, moved_pairs
from eldenet.data.drive_poses import DrivePoses
from eldenet.data.self_calibration import CameraFit, find_pairs, fit_camera, floor_below
from eldenet.deploy.prediction import Source
from eldenet.geometry import check_intrinsics, four_numbers, intrinsic_matrix, level_rotation, pinhole
from eldenet.perception.drive_labels import place_frames
from eldenet.results.run_log import RunLog

#: What is given is refused if the drive tells another value: focal length and height by this factor (or one
#: over it), pitch and yaw by this angle [degrees], the place ahead by this distance [m].
WRONG_FOCAL, WRONG_HEIGHT, WRONG_ANGLE, WRONG_AHEAD = 1.08, 1.1, 3.0, 0.1
LEAST_DELAY = 0.03  # of the poses behind the pictures [s]: a smaller one is left alone
TELLS = "drive on in curves, among things with texture"


def settle_camera(
    source: Source | Bag,
    poses: DrivePoses,
    intrinsics: object,
    *,
    pitch: float | None,
    ahead: float | None,
    log: RunLog,
) -> tuple[np.ndarray, DrivePoses]:
    """Return intrinsics ``(3, 3)`` [px] and poses of the camera, by how its pictures move along a drive.

    Args:
        source: pictures in the order of time, a video, or a bag of ROS.
        poses: with the mount as far as it was given.
        intrinsics: of the source's pictures [px]; None: found, with the principal point in the middle.
        pitch: that was given for a mounted camera [degrees]; None: found.
        ahead: that was given [m]; None: found if the drive tells, else that of ``poses``.
        log: says what was found.

    Raises:
        ValueError: the drive does not tell what was not given, or contradicts what was.
    """
    _, picture, _, _ = next(place_frames(source, poses))
    size = height, width = picture.shape[:2]
    if intrinsics is None:
        assumed = pinhole(width, width, (width - 1) / 2, (height - 1) / 2)
    else:
        assumed = intrinsic_matrix(intrinsics)  # type: ignore[arg-type]
    check_intrinsics(assumed, size)
    depth = MotionDepth(assumed, size)
    frames = (frame for frame in place_frames(source, poses) if frame[1].shape == picture.shape)
    pairs = find_pairs(depth.view(*frame) for frame in frames)
    forward = None if poses.mount is None else level_rotation(poses.mount.pitch).T[:, 2]
    delay = find_delay(pairs, poses, depth.seen_intrinsics, forward)
    if delay is not None and poses.seconds is not None and abs(delay) > LEAST_DELAY:
        log.say(f"by the drive, the poses are {delay:+.2f} s late for the pictures: corrected")
        poses = replace(poses, seconds=poses.seconds - delay)
        pairs = moved_pairs(pairs, poses, 0.0)
    fit = fit_camera(pairs, depth.seen_intrinsics, forward)
    found = assumed * np.array([[fit.focal or 1.0, 1, 1], [1, fit.focal or 1.0, 1], [1, 1, 1]])
    mounted = _mounted(poses, fit, pitch, ahead, log)
    if intrinsics is not None:
        if fit.focal is not None and not 1 / WRONG_FOCAL < fit.focal < WRONG_FOCAL:
            raise ValueError(
                f"intrinsics say fx={assumed[0, 0]:.0f}, but along the poses the pictures, {width} x "
                f"{height}, move as with fx={found[0, 0]:.0f}: give intrinsics={_setting(found)}, or null, "
                "or mend the heading"
            )
        found = assumed
    elif fit.focal is None:
        raise ValueError(
            "the drive does not tell the lens: check heading (counter-clockwise) and clock, give "
            f"intrinsics=[fx,fy,cx,cy] [px], or {TELLS}"
        )
    else:
        log.say(f"by the drive, intrinsics={_setting(found)}: give them to other commands, too")
    if mounted.mount is None:
        return found, mounted
    moved = np.linalg.inv(poses.cameras[0]) @ mounted.cameras[0]
    motions = [pair._replace(motion=np.linalg.inv(moved) @ pair.motion @ moved) for pair in pairs]
    seen = MotionDepth(found, size).seen_intrinsics
    return found, _above_floor(mounted, floor_below(motions, seen, mounted.mount.pitch), log)


def _above_floor(poses: DrivePoses, floor: float | None, log: RunLog) -> DrivePoses:
    """Poses of the camera at its height, where that was not given; ``floor`` [m] is how far below it lies."""
    mount = poses.mount
    if mount is None or (floor is None and mount.height is not None):
        return poses
    if floor is None:
        raise ValueError(
            "the drive does not tell how high the camera is: give camera_height= [m], or drive on where the "
            "floor is in view and has texture"
        )
    if mount.height is None:
        log.say(f"by the drive, camera_height={floor:.3f}")
        cameras = poses.cameras.copy()
        cameras[:, 2, 3] += floor
        return replace(poses, cameras=cameras, mount=mount._replace(height=floor))
    if not 1 / WRONG_HEIGHT < floor / mount.height < WRONG_HEIGHT:
        raise ValueError(
            f"camera_height={mount.height:.3g}, but along the poses the floor lies {floor:.2f} m below the "
            "camera: give that, or null, or mend the meters of the poses"
        )
    return poses


def _mounted(
    poses: DrivePoses, fit: CameraFit, pitch: float | None, ahead: float | None, log: RunLog
) -> DrivePoses:
    """Poses of the camera with the mount that was found, where it was not given."""
    told = poses.mount
    if told is None:
        return poses
    off, aside = (None if angle is None else math.degrees(angle) for angle in (fit.pitch, fit.yaw))
    if aside is not None and abs(aside) > WRONG_ANGLE:
        side = "left" if aside > 0 else "right"
        raise ValueError(
            f"the camera looks {abs(aside):.1f} degrees to the {side} of the way: "
            "mount it straight ahead, or mend the heading in the poses"
        )
    if pitch is not None and off is not None and abs(off) > WRONG_ANGLE:
        raise ValueError(
            f"camera_pitch={pitch:.3g}, but along the poses the pictures move as with a camera "
            f"{pitch + off:.1f} degrees below the horizon: give that, or null"
        )
    if ahead is not None and fit.ahead is not None and abs(fit.ahead) > WRONG_AHEAD:
        raise ValueError(
            f"camera_ahead={ahead:.3g}, but along the poses the pictures move as with a camera "
            f"{ahead + fit.ahead:.2f} m before the axle: give that, or null"
        )
    if pitch is None and fit.pitch is None:
        raise ValueError(
            "the drive does not tell the pitch: check heading (counter-clockwise), clock and intrinsics, "
            f"give camera_pitch= [degrees], or {TELLS}"
        )
    lower = fit.pitch if pitch is None and fit.pitch is not None else 0.0
    farther = fit.ahead if ahead is None and fit.ahead is not None else 0.0
    mount = told._replace(pitch=told.pitch + lower, ahead=told.ahead + farther)
    if pitch is None:
        log.say(
            f"by the drive, camera_pitch={math.degrees(mount.pitch):.1f} (for a driver {mount.pitch:.3f} rad)"
        )
    if farther:
        log.say(f"by the drive, camera_ahead={mount.ahead:.2f}")
    moved = np.eye(4)
    moved[:3, :3], moved[:3, 3] = level_rotation(lower), farther * level_rotation(told.pitch).T[:, 2]
    return replace(poses, cameras=poses.cameras @ moved, mount=mount)


def _setting(matrix: np.ndarray) -> str:
    return "[" + ",".join(f"{number:.1f}" for number in four_numbers(matrix)) + "]"
