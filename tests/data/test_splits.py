"""Held-out scenes: the same on every machine and in every layout, whole, and about 5 %."""

import random

import pytest

from eldenet.data.splits import hold_out, scene_of

SCENES = [f"{kind}_{number:04d}" for kind in ("kitchen", "office", "bedroom", "bath") for number in range(70)]
NUMBERS = {"bath": [23], "bedroom": [13, 55, 56], "kitchen": [1, 6, 31, 41, 44, 59], "office": [6]}
FROZEN = [f"{kind}_{number:04d}" for kind, numbers in NUMBERS.items() for number in numbers]


def frames(scenes: list[str]) -> list[str]:
    return [f"{scene}{letter}/rgb_{i:05d}" for scene in scenes for letter in ("", "a", "b") for i in range(3)]


@pytest.mark.parametrize(
    "name",
    [
        "kitchen_0001/rgb_00000",
        "kitchen_0001a/rgb_00000",
        "kitchen_0001_out/1",
        "kitchen_0001b_out/1",
        "train/kitchen_0001/00001",
    ],
)
def test_names_give_their_scene(name: str) -> None:
    assert scene_of(name) == "kitchen_0001"


def test_whole_scenes_and_every_frame_once() -> None:
    names = frames(SCENES)
    train, val = hold_out(names, "train"), hold_out(names, "val")
    assert sorted(train + val) == list(range(len(names)))
    assert not {scene_of(names[i]) for i in train} & {scene_of(names[i]) for i in val}
    assert 0.02 < len(val) / len(names) < 0.08


def test_a_scenes_side_depends_on_its_name_alone() -> None:
    names = frames(SCENES)
    val = {names[i] for i in hold_out(names, "val")}
    shuffled = random.Random(0).sample(names, len(names))
    assert {shuffled[i] for i in hold_out(shuffled, "val")} == val
    half = names[: len(names) // 2]
    assert {half[i] for i in hold_out(half, "val")} == val & set(half)
    # Frozen: another set of scenes would make old and new results incomparable without anyone noticing.
    assert sorted({scene_of(name) for name in val}) == FROZEN


def test_layouts_hold_out_the_same_scenes() -> None:
    other = [f"train/{scene}/00001" for scene in SCENES]
    names = frames(SCENES)
    assert {scene_of(other[i]) for i in hold_out(other, "val")} == {
        scene_of(names[i]) for i in hold_out(names, "val")
    }


def test_few_scenes_leave_no_side_empty() -> None:
    assert hold_out(["office_0002/1", "bedroom_0003/1"], "val") == [1]
    assert hold_out(["office_0002/1", "bedroom_0003/1"], "train") == [0]
    assert len(hold_out([f"{scene}/1" for scene in FROZEN[:2]], "train")) == 1
    with pytest.raises(ValueError, match="all 2 frames come from the scene 'office_0002'"):
        hold_out(["office_0002a/1", "office_0002b/1"], "val")
    assert hold_out([], "val") == []
