"""What a training says of its frames before it begins."""

from functools import partial

from support.synthetic import SyntheticDepth

from eldenet.data.base import DepthDataset
from eldenet.data.mix import Mix
from eldenet.training.notes import out_of_range


class Kilometers(SyntheticDepth):
    """Depth in millimeters that was read as if it were in meters."""

    def load_frame(self, index: int):
        frame = super().load_frame(index)
        return frame._replace(depth=1000 * frame.depth)


def warnings(frames: DepthDataset) -> list[str]:
    return list(out_of_range(frames))


def test_depth_that_is_mostly_out_of_range_is_named_with_its_unit_in_question() -> None:
    assert warnings(SyntheticDepth(12)) == []
    (line,) = warnings(Kilometers(12))
    assert line.startswith("warning: of the depth in frames such as synthetic/0 (median ")
    assert "100% is outside 0.1 to 10 m and not used: is the unit right?" in line


def test_every_source_in_meters_is_looked_at() -> None:
    for relative in (False, True):  # depth up to a factor has no unit
        wrong = {"data": partial(Kilometers, 2), "weight": 1.0, "relative": relative}
        mix = Mix({"right": {"data": partial(SyntheticDepth, 2)}, "wrong": wrong}, 4)
        assert len(warnings(mix)) == (not relative)
