"""Rendered streets and halls: their boxes, in the picture and in space."""

import cv2
import numpy as np
import pytest
from support.blocks import clear

from eldenet.simulation.street_views import render_street


def test_the_pixels_of_an_object_lie_in_its_boxes(views):
    """Every pixel lies in the 3D box, and the 2D box is tight."""
    for view in (*views, render_street("val", 2, (96, 320), detail=True)):
        rows, columns = np.indices(view.depth.shape)
        points = view.camera.back_project(columns, rows, view.depth)
        for number in clear(view)[:6]:
            mine = points[view.instance == number]
            box = view.boxes[int(number)]
            turn = np.array(
                [[np.cos(box.yaw), 0, -np.sin(box.yaw)], [np.sin(box.yaw), 0, np.cos(box.yaw)], [0, 1, 0]]
            )
            inside = np.abs((mine - box.center) @ turn.T) - box.size / 2
            # boxes stand upright in a camera frame that is tilted by up to a degree
            assert inside.max() < 0.02 + 0.018 * box.size.max()
            xyxy = view.detections.xyxy[number]
            row, column = np.nonzero(view.instance == number)
            wanted = [column.min() - 0.5, row.min() - 0.5, column.max() + 0.5, row.max() + 0.5]
            np.testing.assert_allclose(xyxy, wanted)


@pytest.mark.parametrize("kind", ["street", "hall"])
def test_another_lens_shows_the_same_scene(kind):
    """Boxes in space stay, wherever both lenses see an object; each scene draws a lens of its own."""
    size = (96, 160)
    wide, tele = (render_street("val", 3, size, kind, focal=(lens, lens)) for lens in (0.4, 2.0))
    assert wide.camera.intrinsics[0, 0] == pytest.approx(0.4 * 160)
    assert tele.camera.intrinsics[1, 1] == pytest.approx(2 * 160)
    assert not np.array_equal(wide.image, tele.image)
    pairs = [
        (one, other)
        for one in wide.boxes.center
        for other in tele.boxes.center
        if np.linalg.norm(one - other) < 1e-6
    ]
    assert pairs
    # what the wide lens sees in the middle is where the tele lens, five times as sharp, sees it
    rows, columns = np.mgrid[40:54, 66:94]
    depth = wide.depth[rows, columns]
    known = depth > 0
    pixels = np.rint(tele.camera.project(wide.camera.back_project(columns, rows, depth)[known])).astype(int)
    seen = tele.depth[pixels[:, 1], pixels[:, 0]]
    assert np.median(np.abs(seen / depth[known] - 1)) < 0.02
    lenses = {
        render_street("val", i, (24, 40), kind, focal=(0.4, 2.0)).camera.intrinsics[0, 0] for i in range(4)
    }
    assert len(lenses) == 4
    assert all(0.4 * 40 <= lens <= 2 * 40 for lens in lenses)


def neighbors(view, number: int) -> set[int]:
    """Nearer objects that touch the pixels of an object."""
    mine = view.instance == number
    beside = cv2.dilate(mine.astype(np.uint8), np.ones((5, 5), np.uint8)).astype(bool) & (view.instance >= 0)
    near = view.depth < np.median(view.depth[mine])
    return set(view.instance[beside & near & ~mine].tolist())


def test_unoccluded_objects_have_a_visibility_near_one():
    free, hidden, touching, inside = [], [], [], []
    for index in range(6):
        view = render_street("val", index, (120, 160), "hall")
        for number in range(len(view.boxes)):
            rows, columns = np.nonzero(view.instance == number)
            if len(rows) < 300:  # visibility counts every 16th pixel
                continue
            at_border = bool(
                rows.min() == 0 or columns.min() == 0 or rows.max() == 119 or columns.max() == 159
            )
            alone = not neighbors(view, number)
            if alone:
                (touching if at_border else inside).append(view.truncated[number])
            if not view.truncated[number]:
                (free if alone else hidden).append(view.visible[number])
    assert min(len(free), len(inside), len(touching)) > 3
    assert min(free) > 0.85
    assert max(free) <= 1
    assert min(hidden) < 0.6
    assert np.mean(touching) > 0.8
    assert not any(inside)


def test_the_2d_box_of_a_block_is_the_projection_of_its_3d_box():
    """On average, the rendered pixels neither stick out of the projection nor fall short of it.

    A camera tilt of a degree leaves about a pixel for each block, which averages out.
    """
    excess = []
    for index in range(8):
        view = render_street("train", index, (240, 320), "hall")
        blocks = np.isin(view.boxes.classes, ("box", "pillar")) & (view.visible > 0.97) & ~view.truncated
        projected = view.boxes.project(view.camera, view.depth.shape)
        gap = (view.detections.xyxy - projected) * [-1, -1, 1, 1]
        excess.append(gap[blocks])
    gaps = np.concatenate(excess)
    assert len(gaps) > 8
    assert abs(np.median(gaps)) < 0.2


def test_a_crossing_has_people_and_cyclists_whose_pixels_lie_in_their_boxes():
    found = []
    for index in range(2):
        view = render_street("val", index, (128, 416), "crossing")
        rows, columns = np.indices(view.depth.shape)
        points = view.camera.back_project(columns, rows, view.depth)
        for number, name in enumerate(view.boxes.classes):
            if name in ("person", "cyclist"):
                found.append(name)
                box = view.boxes[number]
                offset = points[view.instance == number] - box.center
                assert np.abs(offset[:, 1]).max() < box.size[2] / 2 + 0.05
                assert np.hypot(offset[:, 0], offset[:, 2]).max() < np.hypot(*box.size[:2]) / 2 + 0.05
    assert min(found.count("person"), found.count("cyclist")) >= 2
