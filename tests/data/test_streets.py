"""Rendered streets as a data set: their own lens and range, and the depth of the street behind each frame."""

import numpy as np
import pytest

from eldenet.compose import compose
from eldenet.data.streets import Streets
from eldenet.evaluation.splits import chosen_protocol, open_split
from eldenet.simulation.street_views import FOCAL, STREETS_VERSION, render_street
from eldenet.train import TrainSettings

SIZE = (24, 80)


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return tmp_path_factory.mktemp("streets")


def test_a_frame_is_its_street_to_a_millimeter(root):
    frame, street = (
        Streets("val", 8, size=SIZE, root=root, workers=0).load_frame(3),
        render_street("val", 3, SIZE),
    )
    np.testing.assert_array_equal(frame.image, street.image)
    within = street.depth < 131  # farther depth does not fit into a stored frame
    np.testing.assert_allclose(frame.depth[within], street.depth[within], atol=0.0011)
    assert (frame.depth[~within] == 0).all()
    assert frame.depth.max() > 40
    assert (frame.depth == 0).any()  # the sky


def test_stored_frames_are_named_by_the_version_of_the_streets():
    assert Streets.generator.version == STREETS_VERSION


def test_the_mask_leaves_out_what_is_beyond_80_meters(root):
    sample = Streets("val", 8, size=SIZE, root=root, workers=0)[0]
    assert 0.5 < sample["mask"].float().mean() < 1
    assert sample["depth"][sample["mask"]].min() >= 1
    assert sample["depth"][sample["mask"]].max() <= 80
    with pytest.raises(ValueError, match=r"max_depth=200.*131 \[m\]"):
        Streets("val", 8, size=SIZE, root=root, workers=0, max_depth=200)


def test_lenses_have_folders_of_their_own(root):
    own = Streets("val", 8, size=SIZE, root=root, workers=0)
    wide = Streets("val", 8, size=SIZE, root=root, workers=0, focal=[0.4, 0.5])
    assert own.load_frame(0).intrinsics[0, 0] == pytest.approx(FOCAL["street"] * SIZE[1])
    assert {0.4 <= wide.load_frame(i).intrinsics[0, 0] / SIZE[1] <= 0.5 for i in range(8)} == {True}
    assert own.folder != wide.folder


def test_the_yaml_scores_streets_by_their_own_protocol(root):
    config = compose(
        TrainSettings,
        ["data=streets", f"data.root={root}", "data.size=[24,80]", "data.frames.val=8", "output=b"],
    )
    protocol = chosen_protocol(config.data, config.protocol)
    frames = open_split(config.data, "val", protocol)
    assert (protocol.name, protocol.max_depth, len(frames)) == ("streets", 80.0, 8)
