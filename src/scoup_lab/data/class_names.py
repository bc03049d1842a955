"""Names of the classes that labelled points have, in the order of their numbers.

``NYU40`` is read from OpenGaussian's ``scripts/eval_scannet.py``; the others, the classes of SceneSplat-Bench, from the
label files of the benchmark's code (zenghjian/SceneSplat, ``pointcept/datasets/preprocessing``:
``scannet/meta_data/scannet20_labels.txt`` and ``scannet200_labels.txt``,
``scannetpp/metadata/semantic_benchmark/top100.txt``, ``matterport3d/meta_data/matterport_labels_21.txt``).
"""

from __future__ import annotations


def _listed(text: str) -> tuple[str, ...]:
    """Return names between commas, over any number of lines."""
    return tuple(" ".join(name.split()) for name in text.split(","))


NYU40 = _listed("""
    unlabeled, wall, floor, cabinet, bed, chair, sofa, table, door, window, bookshelf, picture, counter, blinds,
    desk, shelves, curtain, dresser, pillow, mirror, floormat, clothes, ceiling, books, refrigerator,
    television, paper, towel, showercurtain, box, whiteboard, person, nightstand, toilet, sink, lamp, bathtub,
    bag, otherstructure, otherfurniture, otherprop
""")
"""The 40 classes of NYU and what has none, as that script spells them; numbers of ScanNet's labels."""

SCANNET20 = _listed("""
    wall, floor, cabinet, bed, chair, sofa, table, door, window, bookshelf, picture, counter, desk, curtain,
    refrigerator, shower curtain, toilet, sink, bathtub, other furniture
""")
"""The 20 classes of ScanNet's benchmark."""

MATTERPORT21 = (*SCANNET20, "ceiling")
"""The 21 classes of Matterport3D."""

SCANNET200 = _listed("""
    wall, chair, floor, table, door, couch, cabinet, shelf, desk, office chair, bed, pillow, sink, picture,
    window, toilet, bookshelf, monitor, curtain, book, armchair, coffee table, box, refrigerator, lamp, kitchen
    cabinet, towel, clothes, tv, nightstand, counter, dresser, stool, cushion, plant, ceiling, bathtub, end
    table, dining table, keyboard, bag, backpack, toilet paper, printer, tv stand, whiteboard, blanket, shower
    curtain, trash can, closet, stairs, microwave, stove, shoe, computer tower, bottle, bin, ottoman, bench,
    board, washing machine, mirror, copier, basket, sofa chair, file cabinet, fan, laptop, shower, paper,
    person, paper towel dispenser, oven, blinds, rack, plate, blackboard, piano, suitcase, rail, radiator,
    recycling bin, container, wardrobe, soap dispenser, telephone, bucket, clock, stand, light, laundry basket,
    pipe, clothes dryer, guitar, toilet paper holder, seat, speaker, column, bicycle, ladder, bathroom stall,
    shower wall, cup, jacket, storage bin, coffee maker, dishwasher, paper towel roll, machine, mat, windowsill,
    bar, toaster, bulletin board, ironing board, fireplace, soap dish, kitchen counter, doorframe, toilet paper
    dispenser, mini fridge, fire extinguisher, ball, hat, shower curtain rod, water cooler, paper cutter, tray,
    shower door, pillar, ledge, toaster oven, mouse, toilet seat cover dispenser, furniture, cart, storage
    container, scale, tissue box, light switch, crate, power outlet, decoration, sign, projector, closet door,
    vacuum cleaner, candle, plunger, stuffed animal, headphones, dish rack, broom, guitar case, range hood,
    dustpan, hair dryer, water bottle, handicap bar, purse, vent, shower floor, water pitcher, mailbox, bowl,
    paper bag, alarm clock, music stand, projector screen, divider, laundry detergent, bathroom counter, object,
    bathroom vanity, closet wall, laundry hamper, bathroom stall door, ceiling light, trash bin, dumbbell, stair
    rail, tube, bathroom cabinet, cd case, closet rod, coffee kettle, structure, shower head, keyboard piano,
    case of water bottles, coat rack, storage organizer, folded chair, fire alarm, power strip, calendar,
    poster, potted plant, luggage, mattress
""")
"""The 200 classes of ScanNet200."""

SCANNETPP100 = _listed("""
    wall, ceiling, floor, table, door, ceiling lamp, cabinet, blinds, curtain, chair, storage cabinet, office
    chair, bookshelf, whiteboard, window, box, window frame, monitor, shelf, doorframe, pipe, heater, kitchen
    cabinet, sofa, windowsill, bed, shower wall, trash can, book, plant, blanket, tv, computer tower, kitchen
    counter, refrigerator, jacket, electrical duct, sink, bag, picture, pillow, towel, suitcase, backpack,
    crate, keyboard, rack, toilet, paper, printer, poster, painting, microwave, board, shoes, socket, bottle,
    bucket, cushion, basket, shoe rack, telephone, file folder, cloth, blind rail, laptop, plant pot, exhaust
    fan, cup, coat hanger, light switch, speaker, table lamp, air vent, clothes hanger, kettle, smoke detector,
    container, power strip, slippers, paper bag, mouse, cutting board, toilet paper, paper towel, pot, clock,
    pan, tap, jar, soap dispenser, binder, bowl, tissue box, whiteboard eraser, toilet brush, spray bottle,
    headphones, stapler, marker
""")
"""The 100 most frequent classes of ScanNet++."""
