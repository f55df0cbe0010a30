"""Time three tasks in the player, in rerun and in viser with the same motions (docs/viewing.md#beside-rerun-and-viser).

``python docs/looking.py tasks motions.html`` does them in the player, in a headless Chromium, and checks each answer;
``python docs/looking.py rerun motions.html FOLDER`` and ``… viser motions.html out.viser`` write the same motions,
distances, spans and scores for the others.
"""

from __future__ import annotations

import base64
import importlib
import json
import re
import shutil
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from prbench.geometry.skeleton import BONES

_BONES = np.array(BONES)


def documents(page: Path) -> list[dict[str, Any]]:
    """Return the sequences of a page that `prbench view` wrote, in its order: the worst first."""
    found = re.findall(r'class="sequence">(.*?)</script>', page.read_text(encoding="utf-8"), flags=re.DOTALL)
    return list(map(json.loads, found))


def numbers(text: str, scale: float = 1000.0) -> np.ndarray:
    """Return an array of a document."""
    return np.frombuffer(base64.b64decode(text), "<i2") / scale


def time_tasks(page: Path) -> list[tuple[str, int, float, str]]:
    """Do the three tasks with the keyboard and return what each took: actions, seconds of the machine, the answer.

    Raises:
        SystemExit: if an answer is wrong.
    """
    from playwright.sync_api import sync_playwright

    first = documents(page)[0]
    method = first["motions"][-1]
    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))))
    rows = []
    with sync_playwright() as playwright:
        arguments = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
        browser = playwright.chromium.launch(executable_path=program, args=arguments)
        shown = browser.new_page(viewport={"width": 1400, "height": 900})
        begun = time.perf_counter()
        shown.goto(page.absolute().as_uri())
        shown.wait_for_selector(".prp-stage canvas")
        rows.append(("open the page", 0, time.perf_counter() - begun, f"{len(documents(page))} sequences"))

        # The worst sequence stands first in the list.
        begun = time.perf_counter()
        worst = shown.locator(".prp-subtitle").inner_text()
        require(first["sequence_id"] in worst, worst)
        rows.append(("find the worst sequence", 0, time.perf_counter() - begun, first["title"]))

        # N goes from mark to mark, and the player says which.
        begun = time.perf_counter()
        presses = 0
        told = shown.locator("[aria-live]").last
        said = told.inner_text()
        while f"{method['label']}: ray on target" not in said and presses < 50:
            shown.keyboard.press("n")
            presses += 1
            while told.inner_text() == said:  # it is said a moment later, when nothing else is pressed
                shown.wait_for_timeout(10)
            said = told.inner_text()
        frame = method["on_target"][0][0]
        shown.locator(".prp-clock").filter(has_text=f"frame {frame + 1} of").wait_for(timeout=3000)
        rows.append(("find when the head reaches the goal", presses, time.perf_counter() - begun, f"frame {frame}"))

        # One row of the timeline shows a lane a motion.
        begun = time.perf_counter()
        sliding = [motion["label"] for motion in first["motions"] if motion["sliding"]]
        lanes = shown.locator("svg").filter(has_text="foot slides").count()
        require(lanes > 0, "no row of sliding feet")
        rows.append(("say which of two motions slides", 0, time.perf_counter() - begun, ", ".join(sliding)))
        browser.close()
    return rows


def require(right: bool, found: str) -> None:
    """End with a message if an answer is wrong."""
    if not right:
        raise SystemExit(f"the player showed something else: {found}")


def write_rerun(page: Path, out: Path) -> None:
    """Write a recording a sequence: bodies, goal, distances, sliding feet, and scores as text; needs rerun 0.41."""
    rr: Any = importlib.import_module("rerun")
    out.mkdir(parents=True, exist_ok=True)
    for number, document in enumerate(documents(page)):
        stream = rr.RecordingStream("prbench", recording_id=document["sequence_id"])
        stream.save(out / f"{number:03}.rrd")
        stream.log("/", rr.ViewCoordinates.RIGHT_HAND_Y_UP, static=True)
        stream.log("title", rr.TextDocument(document["title"]), static=True)
        if document["goal"]:
            stream.log("goal", rr.Points3D([document["goal"]["location"]], radii=0.05), static=True)
        for motion in document["motions"]:
            name = motion["label"].replace(" ", "_").replace(",", "")
            said = "\n".join(f"{score['title']}: {score['text']}" for score in motion["scores"])
            stream.log(f"scores/{name}", rr.TextDocument(said), static=True)
            joints = numbers(motion["joints"]).reshape(-1, 22, 3)
            curves = {key: numbers(motion[key]) for key in ("head", "wrist") if motion[key]}
            for frame, pose in enumerate(joints):
                stream.set_time("time", duration=frame / document["fps"])
                stream.log(f"bodies/{name}", rr.LineStrips3D(pose[_BONES]))
                for key, curve in curves.items():
                    stream.log(f"{key}/{name}", rr.Scalars(float(curve[frame])))
                slides = any(first <= frame <= last for first, last in motion["sliding"])
                stream.log(f"sliding/{name}", rr.Scalars(float(slides)))


def write_viser(page: Path, out: Path) -> None:
    """Write the bodies, goals and scores of all sequences as one recording of viser, one after another."""
    viser: Any = importlib.import_module("viser")
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    recording = server.get_scene_serializer()
    for document in documents(page):
        label = server.scene.add_label("/title", "", position=(0.0, 2.4, 0.0))
        for frame in range(document["n_frames"]):
            words = [document["title"], f"{frame / document['fps']:.2f} s"]
            for motion in document["motions"]:
                joints = numbers(motion["joints"]).reshape(-1, 22, 3)[frame]
                server.scene.add_line_segments(f"/{motion['kind']}", joints[_BONES].astype(np.float32), (0, 90, 180))
                words.append(f"{motion['label']}: " + ", ".join(f"{s['title']} {s['text']}" for s in motion["scores"]))
            label.text = "\n".join(words)
            recording.insert_sleep(1 / document["fps"])
    out.write_bytes(recording.serialize())
    server.stop()


if __name__ == "__main__":
    what, given, *target = sys.argv[1:]
    if what == "tasks":
        for task, actions, seconds, answer in time_tasks(Path(given)):
            sys.stdout.write(f"{task}: {actions} actions, {seconds:.2f} s, {answer}\n")
    else:
        {"rerun": write_rerun, "viser": write_viser}[what](Path(given), Path(target[0]))
