"""Which of NYU's labeled training frames are of one scene, and which part of them each is in."""

import re

# Our validation part of the 795 official training frames: first and last frame numbers (1-based, of the
# labeled .mat), 130 frames. Frames of a scene follow each other in the .mat, and the official split never
# cuts a scene, so the training frames between two test frames are whole scenes. The blocks below are such
# runs, spread over every kind of room that occurs several times (office, classroom, study, bath, kitchen,
# bedroom, living and dining room ...). Checked on the pictures: no pair across the border has more than 12
# SIFT inliers, which is chance; within the runs hundreds have more.
VAL_FRAMES: tuple[tuple[int, int], ...] = (
    *((22, 27), (80, 83), (120, 124), (203, 206), (265, 270), (303, 309), (391, 394), (436, 440)),
    *((584, 590), (614, 616), (639, 643), (665, 667), (719, 723), (805, 809), (824, 832), (909, 916)),
    *((1005, 1009), (1110, 1116), (1185, 1191), (1221, 1225), (1266, 1274), (1341, 1346), (1402, 1406)),
)

# 112 of the other training frames, whole scenes again: recipes are chosen on these and scored on those above.
DEV_FRAMES: tuple[tuple[int, int], ...] = (
    *((3, 8), (286, 295), (527, 530), (534, 536), (608, 611), (652, 655), (682, 685), (700, 705), (735, 742)),
    *((863, 868), (929, 931), (948, 958), (1024, 1031), (1040, 1047), (1132, 1134), (1137, 1143)),
    *((1213, 1215), (1251, 1253), (1415, 1420), (1425, 1429)),
)


def labeled_part(number: int) -> str:
    """Return "val", "dev" or "fit": the part of the labeled training frame ``number`` (1-based)."""
    for name, blocks in (("val", VAL_FRAMES), ("dev", DEV_FRAMES)):
        if any(first <= number <= last for first, last in blocks):
            return name
    return "fit"


def labeled_scene(name: str) -> str | None:
    """Return the scene of a labeled frame such as ``labeled_out/0022``, None for another frame.

    The scenes of ``fit`` are not known, so each of its frames is its own.
    """
    found = re.fullmatch(r"(?:.*/)?labeled_out/(\d{4})", name)
    if found is None:
        return None
    number = int(found[1])
    blocks = (first for first, last in (*VAL_FRAMES, *DEV_FRAMES) if first <= number <= last)
    return f"labeled {next(blocks, number)}"
