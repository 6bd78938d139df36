"""Point clouds as PLY files, which MeshLab, CloudCompare, Blender and Open3D open."""

from pathlib import Path

import numpy as np

_VERTEX = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1")])
_PLY_NAMES = {"<f4": "float", "|u1": "uchar"}


def write_ply(path: Path, points: np.ndarray, colors: np.ndarray) -> int:
    """Write colored points as binary little-endian PLY, all at once; returns how many were written.

    Args:
        path: of the file; its folder is made if need be.
        points: ``(..., 3)`` camera coordinates [m]: x right, y down, z forward. Those that are not finite, or
            not in front of the camera, are left out.
        colors: ``(..., 3)`` uint8 RGB, one per point.

    Raises:
        ValueError: as many colors as points are needed.
    """
    if points.shape != colors.shape:
        raise ValueError(f"points {points.shape} and colors {colors.shape} must have one shape, (..., 3)")
    points, colors = points.reshape(-1, 3), colors.reshape(-1, 3)
    seen = np.isfinite(points).all(1) & (points[:, 2] > 0)
    vertices = np.empty(int(seen.sum()), _VERTEX)
    for column, name in enumerate(("x", "y", "z")):
        vertices[name] = points[seen, column]
    for column, name in enumerate(("red", "green", "blue")):
        vertices[name] = colors[seen, column]
    properties = "".join(
        f"property {_PLY_NAMES[kind]} {name}\n" for name, kind in (d[:2] for d in _VERTEX.descr)
    )
    header = (
        f"ply\nformat binary_little_endian 1.0\ncomment camera frame, meters: x right, y down, z forward\n"
        f"element vertex {len(vertices)}\n{properties}end_header\n"
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(header.encode("ascii") + vertices.tobytes())
    return len(vertices)
