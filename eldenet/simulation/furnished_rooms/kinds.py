"""Kinds of rooms: frequency, size and furniture."""

from typing import NamedTuple

from eldenet.simulation.furnished_rooms import furniture as f
from eldenet.simulation.furnished_rooms import household as h

Range = tuple[float, float]


class Item(NamedTuple):
    """Furniture: maker, ranges of its footprint [m], usual height [m], whether it hides the wall."""

    maker: f.Maker
    width: Range
    depth: Range
    height: float
    tall: bool = False


class Kind(NamedTuple):
    """A kind of room."""

    share: int  # weight among all rooms
    side: Range  # range of both sides [m]
    height: Range  # range of the ceiling [m]
    along: tuple[Item, ...]  # items along the walls
    middle: tuple[Item, ...]  # items in the open
    groups: tuple[int, int]  # range of the number of those, and large rooms have more


TABLE = Item(f.table, (0.8, 1.8), (0.6, 1.0), 0.75)
ROUND = Item(f.round_table, (0.6, 1.3), (0.6, 1.3), 0.7)
COFFEE = Item(f.coffee_table, (0.6, 1.2), (0.4, 0.7), 0.45)
CHAIR = Item(f.chair, (0.4, 0.52), (0.4, 0.52), 0.9)
SWIVEL = Item(f.office_chair, (0.45, 0.55), (0.45, 0.55), 1.0)
STOOL = Item(f.stool, (0.32, 0.45), (0.32, 0.45), 0.6)
SOFA = Item(f.sofa, (1.4, 2.4), (0.8, 1.0), 0.85)
ARMCHAIR = Item(f.sofa, (0.8, 1.0), (0.75, 0.95), 0.85)
BED = Item(f.bed, (1.4, 2.0), (1.95, 2.2), 0.7)
SINGLE = Item(f.bed, (0.85, 1.1), (1.9, 2.1), 0.7)
CHEST = Item(f.cabinet, (0.7, 1.6), (0.38, 0.6), 1.0)
NIGHT = Item(f.cabinet, (0.38, 0.55), (0.35, 0.5), 0.6)
CLOSET = Item(f.wardrobe, (0.6, 2.0), (0.5, 0.7), 2.0, True)
SHELF = Item(f.shelf, (0.6, 1.3), (0.25, 0.4), 1.9, True)
COUNTER = Item(h.counter, (1.4, 3.4), (0.58, 0.68), 1.0, True)
SINK = Item(h.sink, (0.5, 1.3), (0.42, 0.58), 1.0, True)
TOILET = Item(h.toilet, (0.38, 0.42), (0.62, 0.72), 0.8)
TUB = Item(h.bathtub, (1.4, 1.75), (0.7, 0.8), 0.6)
CRIB = Item(f.crib, (0.9, 1.4), (0.5, 0.75), 1.0)
DESK = Item(f.desk, (1.0, 1.8), (0.6, 0.8), 1.1)
TV = Item(h.tv_stand, (1.0, 1.8), (0.38, 0.5), 1.1, True)
LAMP = Item(h.lamp, (0.35, 0.45), (0.35, 0.45), 1.6)
PLANT = Item(h.plant, (0.4, 0.7), (0.4, 0.7), 1.0)
BASKET = Item(h.basket, (0.25, 0.5), (0.25, 0.45), 0.5)
RACK = Item(h.rack, (0.8, 1.6), (0.4, 0.55), 1.5)

KINDS: dict[str, Kind] = {
    "bedroom": Kind(
        5,
        (2.7, 4.8),
        (2.3, 2.8),
        (BED, BED, SINGLE, CRIB, NIGHT, NIGHT, CHEST, CLOSET, DESK, CHAIR, LAMP, BASKET, SHELF),
        (BED, CHAIR, BASKET, RACK),
        (0, 1),
    ),
    "living": Kind(
        6,
        (3.2, 8.0),
        (2.3, 3.0),
        (SOFA, SOFA, ARMCHAIR, TV, SHELF, CHEST, LAMP, PLANT, CHAIR, SHELF),
        (COFFEE, SOFA, ARMCHAIR, TABLE, STOOL, CRIB),
        (1, 3),
    ),
    "kitchen": Kind(
        5,
        (2.3, 4.5),
        (2.3, 2.8),
        (COUNTER, COUNTER, COUNTER, CLOSET, CHEST, BASKET, STOOL),
        (TABLE, ROUND, STOOL, COUNTER),
        (0, 2),
    ),
    "bathroom": Kind(
        3, (1.7, 3.2), (2.2, 2.6), (SINK, SINK, TOILET, TUB, CHEST, BASKET, CLOSET), (STOOL, BASKET), (0, 1)
    ),
    "office": Kind(
        5,
        (2.6, 7.0),
        (2.4, 3.2),
        (DESK, DESK, SHELF, SHELF, CHEST, CLOSET, CHAIR, PLANT, BASKET),
        (SWIVEL, SWIVEL, DESK, TABLE),
        (1, 3),
    ),
    "dining": Kind(
        3, (3.0, 7.0), (2.4, 3.0), (CHEST, SHELF, CHAIR, PLANT, CLOSET, LAMP), (TABLE, ROUND, TABLE), (1, 2)
    ),
    "classroom": Kind(
        3,
        (5.0, 10.0),
        (2.6, 3.6),
        (SHELF, CHEST, CHAIR, CLOSET, DESK, TABLE),
        (TABLE, TABLE, CHAIR, ROUND, DESK),
        (4, 8),
    ),
    "store": Kind(
        3,
        (5.0, 12.0),
        (2.6, 4.0),
        (SHELF, SHELF, RACK, CHEST, BASKET),
        (SHELF, SHELF, RACK, TABLE, COUNTER),
        (4, 9),
    ),
    "hall": Kind(
        2,
        (1.5, 7.0),
        (2.3, 3.2),
        (CHEST, CHAIR, PLANT, SHELF, RACK, STOOL, CRIB),
        (CHAIR, BASKET, CRIB),
        (0, 1),
    ),
}
