"""Two small recordings of Tabletop, with events and tracks: `python make_example.py FOLDER`."""

import sys
from pathlib import Path

import numpy as np
from prbench_tabletop.reader import BOX, GAZE, JOINTS, POSITION, ROTATION

LEFT = [
    (80, 870, 0),
    (90, 480, 10),
    (90, 70, 0),
    (100, 20, 130),
    (80, 1380, 0),
    (180, 1400, 0),
    (210, 1130, 0),
    (220, 870, 40),
]
MIDDLE = [(0, 950, 0), (0, 1070, 0), (0, 1200, 0), (0, 1260, 0), (0, 1470, -10), (0, 1560, 50)]
hip, knee, ankle, foot, collar, shoulder, elbow, wrist = np.array(LEFT)
pelvis, spine1, spine2, spine3, neck, head = np.array(MIDDLE)
other = np.array([-1, 1, 1])
trunk_and_legs = [pelvis, hip, hip * other, spine1, knee, knee * other, spine2, ankle, ankle * other, spine3]
arms_and_head = [neck, collar, collar * other, head, shoulder, shoulder * other, elbow, elbow * other]
ends = [foot, foot * other], [wrist, wrist * other]
# Millimetres, Y up, facing +Z.
standing = np.array([*trunk_and_legs, *ends[0], *arms_and_head, *ends[1]])


def z_up(points):
    return np.stack([points[..., 0], -points[..., 2], points[..., 1]], axis=-1)


def write(path, columns, rows):
    lines = [",".join(columns), *(",".join(map(str, row)) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


for seed, name in enumerate(("P1_office", "P2_kitchen")):
    folder = Path(sys.argv[1]) / name
    folder.mkdir(parents=True)
    time_us = np.arange(0, 14_000_000, 16_667)
    walked = np.outer(time_us * 1e-6 * 100, (1, 0, 0))  # millimetres: 10 cm a second to the side
    cup = np.array([1400 + 50 * seed, 1000, 600])
    shelf = cup + np.array([-300, 0, 0])
    eyes = head + walked
    seconds = time_us[:, None] * 1e-6
    # Looks at the cup after 7 s, and after 10.5 s at the place to which it carries the cup from 10 s to 12 s.
    looks_at = np.where(seconds < 10.5, cup, shelf)
    gaze = np.where(seconds > 7, looks_at - eyes, np.array([-0.5, 0.0, 1.0]))
    cup_at = cup + (shelf - cup) * np.clip((seconds - 10) / 2, 0, 1)
    reached = np.clip(seconds - 9, 0, 1) - np.clip(seconds - 12.5, 0, 1)
    hand = standing[-1] + walked
    hand = hand + reached * (cup_at + np.array([0, 60, 0]) - hand)  # a finger's breadth above the cup
    upright = np.tile((np.sqrt(0.5), np.sqrt(0.5), 0, 0), (len(time_us), 1))  # y up in the glasses, Z up in the world
    glasses = np.column_stack([z_up(eyes), upright, gaze])
    body = z_up(standing + walked[:, None]).reshape(len(time_us), -1)
    write(folder / "glasses.csv", ("time_us", *POSITION, *ROTATION, *GAZE), zip(time_us, *glasses.T))
    write(folder / "body.csv", ("time_us", *JOINTS), zip(time_us, *body.T))
    events = [(10_000_000, "pick", "cup", *z_up(cup), 50)]
    pose = np.column_stack([z_up(cup_at), upright])
    write(folder / "cup.csv", ("time_us", *POSITION, *ROTATION), zip(time_us, *pose.T))
    write(folder / "hand.csv", ("time_us", *POSITION), zip(time_us, *z_up(hand).T))
    write(folder / "events.csv", ("time_us", "action", "object", *BOX), events)
