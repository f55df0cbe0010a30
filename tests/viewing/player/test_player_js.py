"""The player's scripts in a real browser, with documents made by hand.

Every test shares one page: the browser computes its 3D pictures, so that making them anew is what takes time.
"""

from __future__ import annotations

import base64
import hashlib
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

import prbench.viewing.player
from prbench.viewing.player import document
from prbench.viewing.player.page import write_page
from tests.browser import browser as browser
from tests.fakes import STANDING

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

PLAYER = Path(prbench.viewing.player.__file__).parent
N = 61


def motion(label: str, speed: float, good: bool, sliding: list[list[int]]) -> document.PlayerMotion:
    """A body that slides ahead without moving a limb."""
    shift = np.linspace(0, speed, N)
    wrist = np.abs(1.5 - shift)
    return document.PlayerMotion(
        label=label,
        kind="recorded" if label == "ground truth" else "method",
        colour="#303030" if label == "ground truth" else "#0072b2",
        joints=document.packed(STANDING + shift[:, None, None] * [0, 0, 1]),
        head_ray=document.packed(np.tile([0, -6.0, 8.0], (N, 1))),
        gaze=document.packed(np.tile([0, 1.6, 0.1, 0, -6, 8], (N, 1))),
        wrist=document.packed(wrist),
        head=document.packed(wrist / 2),
        on_target=[[20, 40]] if good else [],
        within_reach=[[50, 60]] if good else [],
        sliding=sliding,
        scores=[
            document.Score(title="Prime Success", text="yes" if good else "no", good=good),
            document.Score(title="nearest wrist", text=f"{100 * wrist.min():.0f} cm", good=None),
        ],
    )


def sequence(number: int, *, good: bool, speed: float) -> document.PlayerSequence:
    box = [[x, y, z] for z in (1.4, 1.6) for y in (0.8, 1.0) for x in (-0.1, 0.1)]
    path = document.packed(np.linspace([0, 0, 0], [0.5, 0, 0], N))
    corners = document.packed(np.array([(-1.0, 0, -1), (-1, 0, 1), (1, 0, 1)]))
    return document.PlayerSequence(
        sequence_id=f"made/take {number}/cup",
        dataset="made",
        title=f"pick cup {number}",
        action="pick",
        fps=20,
        n_frames=N,
        prime_time=1.5,
        event_time=3.0,
        notice="Made by hand.",
        goal=document.PlayerGoal(location=[0, 0.9, 1.5], box=box),
        limits=document.PlayerLimits(prime_distance=0.25, reach_distance=0.1, window=[10, 50]),
        objects=[document.PlayerObject(name="table", box=box, path=path)],
        mesh=document.PlayerMesh(vertices=corners, triangles=np.arange(3, dtype="<u4").tobytes()),
        motions=[motion("ground truth", 1.0, True, []), motion("<b>glide</b>", speed, good, [[30, 44]])],
    )


@pytest.fixture(scope="module")
def html(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page with three sequences, of which the second is the worst; their documents come when they are chosen."""
    path = tmp_path_factory.mktemp("player") / "page.html"
    made = [(True, 0.6), (False, 0.1), (False, 0.5)]
    write_page([sequence(number, good=good, speed=speed) for number, (good, speed) in enumerate(made)], path)
    return path


@pytest.fixture(scope="module")
def opened(browser: Browser, html: Path) -> Iterator[Page]:
    size = {"width": 920, "height": 600}
    # Playwright waits with eval, which the page itself forbids.
    context = browser.new_context(viewport=size, accept_downloads=True, reduced_motion="reduce", bypass_csp=True)
    page = context.new_page()
    problems: list[str] = []
    page.on("console", lambda said: problems.append(said.text) if said.type in ("error", "warning") else None)
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.on("request", lambda request: problems.append(request.url) if request.url.startswith("http") else None)
    page.goto(html.as_uri())
    page.evaluate("window.handle = prbench.handle; 0")
    yield page
    context.close()
    assert [problem for problem in problems if "GPU stall" not in problem] == []


@pytest.fixture
def player(opened: Page) -> Page:
    """The page at the first frame of the first sequence, nothing focused."""
    opened.evaluate(
        "async () => { document.activeElement.blur(); handle.player.labels = null;"
        " await handle.show('made/take 0/cup', 0); }"
    )
    return opened


def time_of(page: Page) -> float:
    return float(page.get_by_role("slider", name="Time").get_attribute("aria-valuenow") or "nan")


def test_vendored_three_is_the_file_that_its_record_names_and_leaves_room_for_the_player() -> None:
    folder = PLAYER / "vendor" / "three"
    record = tomllib.loads((folder / "vendored.toml").read_text("utf-8"))
    script = (folder / "three.js").read_bytes()
    assert hashlib.sha256(script).hexdigest() == record["sha256"]
    own = sum(len(path.read_bytes()) for path in PLAYER.glob("*.js"))
    assert len(script) + own <= 700_000


@pytest.mark.parametrize(
    ("keys", "time"),
    [
        (["ArrowRight"], 0.05),
        (["Shift+ArrowRight", "ArrowLeft"], 0.45),
        (["p"], 1.5),
        (["e"], 3.0),
        (["End", "Home"], 0.0),
        (["n"], 1.0),  # the ray is on target from frame 20
        (["n", "n", "b"], 1.0),
    ],
)
def test_keys_move_the_time(player: Page, keys: list[str], time: float) -> None:
    for key in keys:
        player.keyboard.press(key)
    assert time_of(player) == pytest.approx(time, abs=0.006)


def test_play_runs_to_the_event_and_then_nothing_is_drawn_any_more(player: Page) -> None:
    player.evaluate("handle.seek(2)")
    player.keyboard.press("Space")
    assert player.evaluate("handle.player.playing")
    player.wait_for_function("!handle.player.playing")
    assert time_of(player) == 3.0
    drawn = [0, 1]
    while drawn[-1] != drawn[-2] and len(drawn) < 12:  # a busy machine draws the last frame late
        player.wait_for_timeout(200)
        drawn.append(player.evaluate("handle.player.stage.renderer.info.render.frame"))
    assert drawn[-1] == drawn[-2]


def test_the_slider_tells_time_and_phase_and_is_dragged(player: Page) -> None:
    slider = player.get_by_role("slider", name="Time")
    box = slider.bounding_box()
    assert box is not None
    player.mouse.click(box["x"] + box["width"] - 2, box["y"] + 60)
    assert time_of(player) == 3.0
    assert slider.get_attribute("aria-valuetext") == "3.00 seconds of 3.00, pick"


def test_spans_are_drawn_where_they_are_and_named_when_reached(player: Page) -> None:
    assert player.locator("[data-span='onTarget 0']").count() == 1
    assert player.locator("[data-span^='sliding']").count() == 1
    player.keyboard.press("n")
    player.keyboard.press("n")
    assert time_of(player) == 1.5
    told = player.get_by_text("prime; <b>glide</b>: foot slides from 1.50 to 2.20 s. 1.50 seconds, prime.")
    told.wait_for(state="attached", timeout=2000)


def test_joints_of_the_body_stand_where_the_document_says(player: Page) -> None:
    player.evaluate("handle.seek(3)")
    error = player.evaluate(
        """() => {
          const {PIECES} = prbench.playerParts.body; const actor = handle.player.stage.actors[0];
          const bones = actor.body.mesh.skeleton.bones; let worst = 0;
          PIECES.forEach(([name, first, last], n) => { if (last === null) return;
            const turned = bones[n].matrixWorld, carrier = prbench.playerParts.body.restOf(n);
            carrier.forEach((end, which) => { const at = new THREE.Vector3(...end).applyMatrix4(turned);
              const joint = new THREE.Vector3(...actor.joints[which ? last : first]);
              worst = Math.max(worst, at.distanceTo(joint)); }); });
          return worst; }"""
    )
    assert error < 1e-5


def test_two_motions_split_where_there_is_a_room_then_in_lanes_overlaid_and_one_alone(player: Page) -> None:
    places = "() => handle.player.stage.shown.map((actor) => actor.group.position.length())"
    labels = player.evaluate("handle.player.stage.labels(800, 400)")
    assert [(label["label"], label["x"]) for label in labels[:2]] == [("ground truth", 200), ("<b>glide</b>", 600)]
    assert [label["label"] for label in labels[2:]] == ["table"]  # the object's name, once
    player.keyboard.press("l")
    assert player.evaluate(places)[1] > 0.8
    player.keyboard.press("l")
    assert player.evaluate(places) == [0, 0]
    assert player.evaluate("() => handle.player.stage.shown[1].body.material.transparent") is True
    player.get_by_role("checkbox", name="show ground truth").click()
    assert player.evaluate("() => handle.player.stage.shown.map((actor) => actor.motion.label)") == ["<b>glide</b>"]
    assert "motions=" in player.evaluate("location.hash")
    player.get_by_role("checkbox", name="show ground truth").click()


def test_mouse_wheel_and_keys_move_the_camera(player: Page) -> None:
    place = (
        "() => { const {camera, target} = handle.player.stage; return camera.position.clone().sub(target).toArray(); }"
    )
    before = np.array(player.evaluate(place))
    player.locator(".prp-stage canvas").hover()
    player.mouse.down()
    player.mouse.move(500, 100)
    player.mouse.up()
    turned = np.array(player.evaluate(place))
    player.mouse.wheel(0, -100)
    nearer = np.array(player.evaluate(place))
    player.keyboard.press("o")
    assert np.linalg.norm(turned) == pytest.approx(np.linalg.norm(before))
    assert np.linalg.norm(turned - before) > 0.5
    assert np.linalg.norm(nearer) < 0.95 * np.linalg.norm(turned)
    assert np.linalg.norm(player.evaluate(place)) > np.linalg.norm(nearer)


def test_search_filter_and_worst_first(player: Page) -> None:
    titles = player.locator(".prp-item-title")
    assert titles.all_inner_texts() == ["pick cup 0", "pick cup 1", "pick cup 2"]
    player.keyboard.press("/")
    player.keyboard.type("cup 2")
    assert titles.all_inner_texts() == ["pick cup 2"]
    player.keyboard.press("Control+a")
    player.keyboard.press("Delete")
    player.get_by_label("Failed").select_option("Prime Success")
    assert titles.all_inner_texts() == ["pick cup 1", "pick cup 2"]  # the farther wrist first
    player.get_by_label("Search").press("ArrowDown")
    player.keyboard.press("Enter")
    assert player.get_by_role("heading", name="pick cup 1").is_visible()
    player.get_by_label("Failed").select_option("")
    player.get_by_label("Order").select_option("given")


def test_a_link_leads_to_its_sequence_motions_and_moment(player: Page, html: Path) -> None:
    player.keyboard.press("j")
    player.keyboard.press("p")
    player.wait_for_function("location.hash.includes('t=1.50')")
    link = player.url
    assert "sequence=made%2Ftake%201%2Fcup" in link
    player.evaluate("handle.show('made/take 2/cup', 0)")
    player.goto(f"{html.as_uri()}#{link.split('#')[1]}&motions=ground%20truth")
    player.get_by_role("heading", name="pick cup 1").wait_for()
    assert time_of(player) == 1.5
    assert player.evaluate("() => handle.player.chosen") == ["ground truth"]


def test_unknown_sequence_and_damaged_document_are_told_in_words(player: Page) -> None:
    player.evaluate("handle.show('made/none')")
    assert "no sequence 'made/none'" in player.locator(".prp-status").inner_text()
    player.evaluate(
        "const cut = async () => ({...await prbench.documents[0].load(), n_frames: 60});"
        "handle.player.entries.push({sequence_id: 'short', load: cut})"
    )
    player.evaluate("handle.show('short')")
    assert re.search(r"object 'table': expected 180 numbers, found 183", player.locator(".prp-status").inner_text())
    player.evaluate("handle.player.entries.pop()")


PIXELS = """async (background) => {
  const blob = await handle.player.picture(background);
  const bitmap = await createImageBitmap(blob);
  const context = new OffscreenCanvas(bitmap.width, bitmap.height).getContext("2d");
  context.drawImage(bitmap, 0, 0);
  const data = context.getImageData(0, 0, bitmap.width, bitmap.height).data;
  let clear = 0, dark = 0;
  for (let i = 0; i < data.length; i += 4) {
    clear += data[i + 3] < 8;
    dark += data[i + 3] > 250 && data[i] < 128;
  }
  const start = new Uint8Array(await blob.slice(0, 8).arrayBuffer());
  const scale = bitmap.width / handle.player.place.clientWidth;
  return [Array.from(start), scale, 4 * clear / data.length, 4 * dark / data.length]; }"""


@pytest.mark.parametrize(("background", "least_clear", "most_clear"), [("#ffffff", 0, 0), (None, 0.2, 0.99)])
def test_pictures_are_png_white_or_transparent_and_twice_as_large(
    player: Page, background: str | None, least_clear: float, most_clear: float
) -> None:
    start, scale, clear, dark = player.evaluate(PIXELS, background)
    assert bytes(start) == b"\x89PNG\r\n\x1a\n"
    assert scale == pytest.approx(2, abs=0.01)
    assert least_clear <= clear <= most_clear
    assert dark > 0.003  # bodies


def test_a_film_is_recorded_and_can_be_cancelled(player: Page) -> None:
    player.set_viewport_size({"width": 400, "height": 400})
    player.evaluate("handle.player.stage.choose(['ground truth']); handle.player._togglePanel(handle.player.savePanel)")
    player.evaluate("handle.player.speed = 6")
    with player.expect_download() as download:
        player.get_by_role("button", name="Film").click()
    assert download.value.suggested_filename == "made-take-0-cup.webm"
    film = base64.b64encode(Path(download.value.path()).read_bytes()).decode()
    lasts = """async (film) => {
      const video = Object.assign(document.createElement("video"), {src: `data:video/webm;base64,${film}`});
      await new Promise((ready, failed) => Object.assign(video, {onloadedmetadata: ready, onerror: failed}));
      return [video.duration, video.videoWidth]; }"""
    duration, width = player.evaluate(lasts, film)
    assert 0.9 < duration < 60  # half a second of motion, half a second of its end
    assert width > 500
    player.evaluate("handle.player.speed = 0.1")
    player.get_by_role("button", name="Film").click()
    player.get_by_role("button", name="Cancel").click()
    player.get_by_text("Film cancelled.").wait_for()
    player.evaluate("handle.player.speed = 1; handle.player.savePanel.open = false")
    player.set_viewport_size({"width": 920, "height": 600})


def test_switching_sequences_frees_what_the_last_one_held(player: Page) -> None:
    count = "() => ({...handle.player.stage.renderer.info.memory})"
    held = []
    for number in (1, 2, 0, 1, 2, 0):
        player.evaluate(
            f"async () => {{ await handle.show('made/take {number}/cup', 1); handle.player.stage.draw(); }}"
        )
        held.append(player.evaluate(count))
    assert held[2] == held[5]


@pytest.mark.parametrize(("width", "theme"), [(920, "light"), (380, "dark")])
def test_axe_finds_nothing_and_nothing_is_wider_than_the_page(player: Page, width: int, theme: str) -> None:
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe-playwright-python is not installed")
    player.set_viewport_size({"width": width, "height": 760})
    player.evaluate(f"document.documentElement.dataset.theme = '{theme}'")
    if width < 900:
        player.get_by_role("button", name=re.compile("Sequences")).click()
    assert player.evaluate("document.documentElement.scrollWidth") <= width
    found = axe.Axe().run(player)
    player.evaluate("document.documentElement.dataset.theme = 'light'")
    player.set_viewport_size({"width": 920, "height": 600})
    assert found.violations_count == 0, found.generate_report()


def test_help_opens_with_its_key_and_closes_with_escape(player: Page) -> None:
    player.keyboard.press("?")
    assert player.get_by_role("dialog", name="Keys and help").is_visible()
    player.keyboard.press("Escape")
    assert not player.get_by_role("dialog").is_visible()


def test_without_webgl_the_player_says_so_and_times_and_scores_stay(browser: Browser, html: Path) -> None:
    page = browser.new_page()
    page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    page.goto(html.as_uri())
    assert "offers no WebGL" in page.get_by_role("note").inner_text()
    page.keyboard.press("p")
    assert time_of(page) == 1.5
    assert page.get_by_role("row", name=re.compile("glide")).get_by_text("✓ yes").is_visible()
    page.close()


def test_destroying_the_player_leaves_an_empty_element(browser: Browser, html: Path) -> None:
    page = browser.new_page()
    page.goto(html.as_uri())
    page.evaluate("prbench.handle.destroy()")
    page.keyboard.press("Space")
    assert page.locator("#player").evaluate("(element) => [element.childNodes.length, element.className]") == [0, ""]
    page.close()
