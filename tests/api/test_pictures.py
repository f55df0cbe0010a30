"""Pictures, replays and progress: shown in a notebook, written by ``save``, and silent elsewhere."""

from __future__ import annotations

import base64
import contextlib
import html
import importlib.util
import io
import re
import sys
import types

import pytest

import prbench
from prbench.api import pictures as progress_module
from tests.browser import browser, page  # noqa: F401 - fixtures
from tests.fakes import fake_info


def test_a_picture_shows_and_saves_itself(synthetic, tmp_path):
    sequence = synthetic[0]
    picture = sequence.plot()
    assert isinstance(picture, prbench.Picture)
    assert picture._repr_png_().startswith(b"\x89PNG\r\n")
    assert picture.save(tmp_path / "sequence.png") == tmp_path / "sequence.png"
    assert (tmp_path / "sequence.png").read_bytes() == picture.png
    assert sequence.object_name in repr(picture)


def test_a_picture_is_the_one_of_the_command(synthetic, tmp_path, capsys):
    from prbench.cli import main

    name = synthetic[0].sequence_id
    out = tmp_path / "view.png"
    assert main(["view", "--data", str(synthetic.folder), "--sequence", name, "--out", str(out)]) == 0
    assert synthetic.sequence(name).plot().png == out.read_bytes()


def test_a_replay_shows_and_saves_itself(synthetic, tmp_path):
    sequence = min(synthetic, key=lambda one: one.n_frames)
    replay = sequence.replay()
    assert isinstance(replay, prbench.Replay)
    shown = replay._repr_html_()
    frame = re.search(r'<iframe sandbox="([^"]*)" srcdoc="([^"]*)"', shown)
    assert frame is not None
    assert "allow-same-origin" not in frame[1]  # else its scripts could reach the notebook
    assert html.unescape(frame[2]) == replay.page
    assert sequence.sequence_id in replay.page
    saved = replay.save(str(tmp_path / "replay.html")).read_text(encoding="utf-8")
    assert saved.count("<html") == replay.page.count("<html") == 1


def test_where_frames_are_taken_out_the_picture_of_a_replay_is_left(synthetic):
    replay = synthetic[0].replay()
    without = re.sub(r"<iframe.*?</iframe>", "", replay._repr_html_(), flags=re.DOTALL)
    source = re.search(r'<img [^>]*src="data:image/png;base64,([^"]+)"', without)
    assert source is not None
    assert base64.b64decode(source[1]) == replay.png == synthetic[0].plot().png


def test_a_replay_in_a_notebook_plays_and_cannot_reach_it(synthetic, page):  # noqa: F811
    sequence = min(synthetic, key=lambda one: one.n_frames)
    page.set_content(f"<body>{sequence.replay()._repr_html_()}</body>")
    frame = page.frames[-1]
    assert frame.evaluate("prbench.documents[0].load().then((read) => read.n_frames)") == sequence.n_frames
    assert (
        frame.evaluate("(() => { try { return parent.document.title; } catch { return 'kept out'; } })()") == "kept out"
    )


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("imageio_ffmpeg") is None, reason="needs the extra view")
def test_a_replay_becomes_a_film(synthetic, tmp_path):
    sequence = min(synthetic, key=lambda one: one.n_frames)
    film = sequence.plot().save(tmp_path / "film.mp4")
    assert film.read_bytes()[4:8] == b"ftyp"


def test_without_the_extra_a_film_says_what_to_install_and_a_page_needs_none(synthetic, monkeypatch, tmp_path):
    monkeypatch.setattr("prbench.viewing.view.find_spec", lambda name: None)
    with pytest.raises(prbench.PrbenchError, match=r"pip install 'prbench\[view\]'"):
        synthetic[0].replay().save(tmp_path / "film.mp4")
    assert synthetic[0].replay().save(tmp_path / "page.html").is_file()


def test_a_table_is_drawn_as_by_the_command(synthetic, empty, tmp_path):
    from prbench.sequences import SequenceTable
    from prbench.sequences.table import table_statistics
    from prbench.viewing.distributions import draw_table_one

    draw_table_one([table_statistics(SequenceTable.open(synthetic.folder))], tmp_path / "stats.png")
    assert synthetic.plot().png == (tmp_path / "stats.png").read_bytes()
    with pytest.raises(prbench.PrbenchError, match="holds no sequences"):
        empty.plot()


def test_a_story_is_a_picture_alone(synthetic, tmp_path):
    story = synthetic.explain(synthetic.events[0].event_id)
    with pytest.raises(prbench.PrbenchError, match=r"written as \.png, \.svg or \.pdf, not as '\.html'"):
        story.save(tmp_path / "story.html")


def test_recorded_motion_is_kept_where_the_licence_keeps_it(tmp_path, monkeypatch):
    import msgspec

    from tests import fakes

    private = msgspec.structs.replace(fake_info(sequences=2), redistribution="none")
    monkeypatch.setattr(fakes, "fake_info", lambda *_: private)
    fakes.fake_dataset(tmp_path / "table", 2)
    sequence = prbench.open_table(tmp_path / "table")[0]
    for show in (sequence.plot, sequence.replay):
        with pytest.raises(prbench.PrbenchError, match="does not let recorded motion and goal poses be passed on"):
            show()
    assert sequence.plot(permission="synthetic-adt").png
    story = prbench.open_table(tmp_path / "table").explain(sequence.sequence_id)
    assert story._story.motion is None


class _Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def _work() -> None:
    with progress_module.progress("working") as show:
        for done in range(1, 4):
            show(done, 3, f"step {done}")


def test_progress_says_nothing_in_a_script(capsys):
    _work()
    captured = capsys.readouterr()
    assert captured.out == captured.err == ""


def test_progress_is_a_bar_on_a_terminal(monkeypatch, capsys):
    terminal = _Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    _work()
    assert "working" in terminal.getvalue()
    assert capsys.readouterr().out == ""


def test_progress_is_a_bar_below_a_cell_and_goes_away(monkeypatch, capsys):
    shown = []

    class _Handle:
        def update(self, content):
            shown.append(content)

    def _display(content, display_id):
        shown.append(content)
        return _Handle()

    kernel = types.ModuleType("IPython")
    kernel.get_ipython = lambda: types.SimpleNamespace(kernel=object())
    module = types.ModuleType("IPython.display")
    module.HTML = str
    module.display = _display
    monkeypatch.setitem(sys.modules, "IPython", kernel)
    monkeypatch.setitem(sys.modules, "IPython.display", module)
    monkeypatch.setattr(progress_module, "_SECONDS_BETWEEN_UPDATES", 0.0)
    with contextlib.suppress(ZeroDivisionError), progress_module.progress("working <on it>") as show:
        show(1, 3, "<one>")
        raise ZeroDivisionError
    assert "<progress" in shown[0]
    assert "working &lt;on it&gt;" in shown[0]
    assert '<progress value="1" max="3">' in shown[1]
    assert "&lt;one&gt;" in shown[1]
    assert shown[-1] == ""
    assert capsys.readouterr().out == ""


def test_a_terminal_shell_of_ipython_is_no_notebook(monkeypatch, capsys):
    shell = types.ModuleType("IPython")
    shell.get_ipython = lambda: types.SimpleNamespace()
    monkeypatch.setitem(sys.modules, "IPython", shell)
    _work()
    assert capsys.readouterr().err == ""


def test_nothing_is_printed(table, tmp_path, capsys):
    run = prbench.run("ground-truth", data=table, limit=2, out=tmp_path / "run")
    motions = {name: run.motion(name) for name in run.to_pandas().sequence_id.unique()}
    prbench.score(motions, table, limit=2)
    prbench.compare(run, run)
    run.plot(limit=1).save(tmp_path / "run.png")
    captured = capsys.readouterr()
    assert captured.out == captured.err == ""
